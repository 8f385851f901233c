"""Waypoints of a mission for an autopilot, with as few corners as the energy allows."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, leg_prices, path_price, world_points
from joulemap.service.exports.track import Line, Track, degrees_of

ENERGY_SHARE = 0.005
"""By which share of a route's energy its mission may differ: half of the promised 1 %; rounding has the other half."""


def corners_to_keep(lattice: CostLattice, points: Points, *, share: float = ENERGY_SHARE) -> NDArray[np.int64]:
    """Return the corners of a path that a mission needs.

    `points` (n, 2): (row, col) polyline. Result (m,): their numbers, in order, the first and the last among them. All
    legs between them may be driven.

    Greedy, from the bottom up, as Visvalingam & Whyatt 1993, with energy instead of area: of all corners the one is
    left out whose absence changes the energy least, until no other may be left out.
    """
    count = len(points)
    whole = path_price(lattice, points)
    if count < 3 or np.isnan(whole) or lattice.robot.min_turning_radius_m > 0.0:  # an arc needs its corners
        return np.arange(count)
    most, changed = share * abs(whole), 0.0
    before, after = np.arange(-1, count - 1), np.arange(1, count + 1)
    version = np.zeros(count, dtype=np.int64)
    there = np.ones(count, dtype=np.bool_)

    def _change(k: int) -> float:
        """Energy that leaving out a corner adds [J]: of the legs next to it, with the turns at their ends."""
        i, j = int(before[k]), int(after[k])
        if np.isnan(leg_prices(lattice, points[[i, j]])).any():
            return np.inf
        around = [n for n in (int(before[i]) if i > 0 else -1, i, j, int(after[j]) if j < count - 1 else -1) if n >= 0]
        at = around.index(j)
        return path_price(lattice, points[around]) - path_price(lattice, points[[*around[:at], k, *around[at:]]])

    changes = {k: _change(k) for k in range(1, count - 1)}
    heap = [(abs(change), k, 0) for k, change in changes.items() if np.isfinite(change)]
    heapq.heapify(heap)
    while heap:
        _, k, made = heapq.heappop(heap)
        if not there[k] or made != version[k] or abs(changed + changes[k]) > most:
            continue
        there[k] = False
        changed += changes[k]
        i, j = int(before[k]), int(after[k])
        after[i], before[j] = j, i
        for near in (i, j, int(before[i]), int(after[j])):  # the turns next to a leg count in four corners' changes
            if 0 < near < count - 1 and there[near]:
                version[near] += 1
                changes[near] = _change(near)
                if np.isfinite(changes[near]):
                    heapq.heappush(heap, (abs(changes[near]), near, int(version[near])))
    return np.flatnonzero(there)


WAYPOINT, CHANGE_SPEED = 16, 178
"""MAV_CMD_NAV_WAYPOINT and MAV_CMD_DO_CHANGE_SPEED."""

GROUND_SPEED, UNCHANGED_THROTTLE = 1, -1
"""First and third parameter of the latter."""

TOUCHING_M = 0.01  # legs of a tour meet but for rounding


@dataclass(frozen=True)
class Mission:
    """What an autopilot is to drive.

    Attributes
    ----------
    waypoints : list of tuple of float
        Longitude, latitude [degrees], in the order of driving, the start first.
    speeds_mps : list of float
        How fast to drive to each of them [m/s].
    height_m : float
        Of the start, 0 where unknown [m].
    energy_j : float or None
        Energy of these straight legs at the robot's own speed [J]; None where it is not known.
    """

    waypoints: list[tuple[float, float]]
    speeds_mps: list[float]
    height_m: float
    energy_j: float | None

    def items(self) -> Iterator[tuple[float | None, tuple[float, float]]]:
        """Return each waypoint, with the speed that is set before it; None where that stays as it is."""
        for before, speed, place in zip([None, *self.speeds_mps], self.speeds_mps, self.waypoints, strict=False):
            yield (None if speed == before else speed), place


def mission_of(track: Track) -> Mission:
    """Return the mission of the lines of a track that are driven.

    Result: its energy differs from that of the track by 1 % at most, and all its legs are on free ground.
    """
    parts: list[NDArray[np.float64]] = []
    speeds: list[float] = []
    total = 0.0
    for points, speed_mps in _stretches(track):
        corners, energy = _simplified(track, points)
        if parts and math.hypot(*(corners[0] - parts[-1][-1])[:2]) <= TOUCHING_M:
            corners = corners[1:]
        parts.append(corners)
        speeds += [speed_mps] * len(corners)
        total += energy
    whole = Line(track.driven[0].kind, np.vstack(parts))
    height = float(whole.points[0, 2])
    return Mission(
        [(float(lon), float(lat)) for lon, lat in degrees_of(track, whole)],
        speeds,
        height if math.isfinite(height) else 0.0,
        total if math.isfinite(total) else None,
    )


def _stretches(track: Track) -> Iterator[tuple[NDArray[np.float64], float]]:
    """The points of what is driven at one speed, (n, 3) [m], and that speed [m/s]."""
    if not track.stretches:
        yield from ((line.points, track.speed_mps) for line in track.driven)
        return
    points, along = track.driven[0].points, track.driven[0].along_m
    begin = 0.0
    for end, speed_mps in track.stretches:
        inside = (along > begin) & (along < end)
        cuts = np.array([begin, *along[inside], min(end, along[-1])])
        yield np.column_stack([np.interp(cuts, along, column) for column in points.T]), speed_mps
        begin = end


def _simplified(track: Track, line: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The corners that a line needs, and the energy of its legs [J]."""
    if track.lattice is None:
        return line, math.nan
    points = world_points(track.lattice, line)
    keep = corners_to_keep(track.lattice, points)
    return line[keep], path_price(track.lattice, points[keep])
