"""What a route costs at other speeds: the cheapest one, energy against time, and a speed for each stretch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.learned import Learned
from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, wrap_angle
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.robot import Robot
from joulemap.model.terrain.windows import Ground
from joulemap.planner.grid.stopping import check_stop
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.tiles import ground_of
from joulemap.planner.objectives.speed_profile import SpeedProfile, speed_profile
from joulemap.planner.route import Route
from joulemap.planner.verdict.trajectory import course_of
from joulemap.planner.words import duration_words, energy_words

SPEEDS = 15
"""Speeds of the curve."""
_CLOSER = 9  # speeds that are tried between the two beside the cheapest of the curve
MOST_M = 5_000.0
"""Longest route that is looked at [m]: the model prices every metre at every speed."""
_STRETCH = 256  # metres whose ground is read at a time
_NARROW = 1.05  # a range whose ends differ by less says nothing of speed
_KEY = "speed_mps"


@dataclass(frozen=True)
class AtSpeed:
    """A route at one speed.

    Attributes
    ----------
    speed_mps : float
        Cruising speed [m/s].
    energy_j : float
        Energy of the route, idle power and turns included [J].
    duration_s : float
        Time, turns on the spot not counted [s].
    """

    speed_mps: float
    energy_j: float
    duration_s: float


@dataclass(frozen=True)
class Speeds:
    """Energy against time along one route.

    Attributes
    ----------
    curve : tuple of AtSpeed
        From the slowest to the fastest speed that the model knows.
    cheapest : AtSpeed
        The speed of least energy.
    declared : AtSpeed or None
        The robot's own speed; None where the model does not know it.
    source : str
        Where the range of speeds comes from.
    at_border : str or None
        "slowest" or "fastest" where the cheapest speed is at the border of what the model knows.
    profile : SpeedProfile or None
        A speed for each stretch, where that was asked for; turns included.
    """

    curve: tuple[AtSpeed, ...]
    cheapest: AtSpeed
    declared: AtSpeed | None
    source: str
    at_border: str | None
    profile: SpeedProfile | None = None

    def __str__(self) -> str:
        best = self.cheapest
        words = (
            f"cheapest at {best.speed_mps:.2f} m/s: {energy_words(best.energy_j)}, {duration_words(best.duration_s)}"
        )
        if self.at_border is not None:
            words += f" (the {self.at_border} speed that the model knows: {self.source})"
        if self.declared is not None:
            own = self.declared
            more = own.energy_j / best.energy_j - 1.0 if best.energy_j > 0.0 else 0.0
            words += (
                f"; at the declared {own.speed_mps:.2f} m/s it takes {energy_words(own.energy_j)} ({more:.1%} more) "
                f"and {duration_words(own.duration_s)}"
            )
        if self.profile is None:
            return words
        low, high = min(self.profile.speed_mps), max(self.profile.speed_mps)
        span = f"{low:.2f} m/s" if low == high else f"{low:.2f} to {high:.2f} m/s"
        return (
            f"{words}; with a speed for each stretch, {span}: {energy_words(self.profile.energy_j)}, "
            f"{duration_words(self.profile.duration_s)}"
        )


def known_speeds(predictor: Predictor, robot: Robot) -> tuple[float, float, str]:
    """Return the speeds that a model learned from.

    Returns `low`, `high`: slowest and fastest [m/s]; `source`: where they were driven, in words.
    """
    low, high, source = 0.0, math.inf, ""
    base = predictor.base if isinstance(predictor, CalibratedPredictor) else predictor
    if isinstance(base, Learned):
        low, high = base.domain.robot.get(_KEY, (0.0, 0.0))
        source = "robots that the network learned from"
        if _KEY in base.domain.driven:
            low, high = base.domain.driven[_KEY]
            source = "runs that the network was trained with"
        least, most = base.domain.robot.get("hotel_over_weight", (0.0, math.inf))
        idle = robot.idle_power_w / robot.weight_n
        low, high = max(low, idle / most), min(high, idle / least if least > 0.0 else math.inf)
    if isinstance(predictor, CalibratedPredictor) and "speed" in predictor.correction.ranges:
        driven = predictor.correction.ranges["speed"]
        low, high = max(low, driven[0]), min(high, driven[1])
        source = "runs of the calibration"
    if not source:
        raise InputError(
            f"the model {predictor.name} does not know what speed costs: use the model default, or calibrate this one "
            "with runs at several speeds",
            model=predictor.name,
        )
    if not high > _NARROW * low:
        raise InputError(
            f"the model {predictor.name} knows one speed only, {high:.3g} m/s of the {source}: give it runs at several "
            "speeds",
            model=predictor.name,
            low=low,
            high=high,
        )
    return low, high, source


def speeds_along(
    route: Route,
    lattice: CostLattice,
    ground: Ground,
    predictor: Predictor,
    *,
    by_stretch: bool = False,
    deadline_s: float | None = None,
) -> Speeds:
    """Return what a route costs at the speeds that a model knows.

    `by_stretch`: also find a speed for each stretch, within `deadline_s` [s] where that is given.

    E(v) = sum over the metres of the route of price(traction(v), idle / v), and the turns: what a cost map for a robot
    of this speed would say, but for its interpolation between cells.
    """
    made_of = lattice.provenance.get("heightmap", {}).get("hash")
    if made_of is not None and made_of != ground.data_hash:
        raise InputError("this is not the heightmap that the cost map was made of", expected=made_of)
    made = lattice.provenance.get("layers", [])
    if _layers(made) != (over := _layers(ground.layers.as_list())):
        words = [", ".join(role for role, _ in each) or "no layers" for each in (_layers(made), over)]
        raise InputError(
            f"the cost map was made with {words[0]} over its heightmap, this one has {words[1]}: give the same layers",
            expected=words[0],
        )
    made_by, asked = lattice.provenance.get("model"), predictor.provenance()
    if made_by is not None and any(made_by.get(key) != asked.get(key) for key in ("kind", "version")):
        raise InputError(
            f"the cost map was made with the model {made_by.get('name')} (version {made_by.get('version')}), this is "
            f"{asked['name']} (version {asked['version']}): name the cost map's own `model`",
            expected=made_by.get("name"),
            model=asked["name"],
        )
    if route.length_m == 0.0:
        raise InputError("the route has no length: start and goal are the same place")
    robot = lattice.robot
    low, high, source = known_speeds(predictor, robot)
    if route.length_m > MOST_M:
        raise InputError(
            f"the route is {route.length_m:.0f} m long, at most {MOST_M:.0f} m can be looked at: ask for a part of it",
            length_m=route.length_m,
            limit=MOST_M,
        )
    metres = _Metres(route, lattice, ground, predictor)
    curve = metres.at(np.linspace(low, high, SPEEDS))
    k = int(np.argmin([one.energy_j for one in curve]))
    beside = curve[max(k - 1, 0)].speed_mps, curve[min(k + 1, SPEEDS - 1)].speed_mps
    near = np.linspace(*beside, _CLOSER)[1:-1]
    *closer, own = metres.at(np.append(near, robot.speed_mps))
    best = min([curve[k], *closer], key=lambda one: one.energy_j)
    border = "slowest" if best.speed_mps == curve[0].speed_mps else "fastest"
    at_border = border if best.speed_mps in (curve[0].speed_mps, curve[-1].speed_mps) else None
    declared = own if low <= robot.speed_mps <= high else None
    found = metres.profile(np.linspace(low, high, SPEEDS), deadline_s) if by_stretch or deadline_s is not None else None
    return Speeds(tuple(curve), best, declared, source, at_border, found)


def _layers(of: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """What each layer is of, and the hash of its data."""
    return sorted((layer["role"], str(layer["hash"])) for layer in of)


class _Metres:
    """The pieces of a route, priced by the model at any speeds, in stretches whose ground is read one after another."""

    def __init__(self, route: Route, lattice: CostLattice, ground: Ground, predictor: Predictor) -> None:
        self._lattice, self._ground, self._predictor = lattice, ground, predictor
        course = course_of([route])
        self._ends = np.column_stack([np.append(course.start[0], course.x), np.append(course.start[1], course.y)])
        self._driven, self._heading = course.driven_m, route.profile.heading_rad
        change = np.abs(wrap_angle(np.diff(self._heading)))
        self._turning_j = lattice.robot.turn_j_per_rad * float(change.sum())

    def at(self, speeds_mps: NDArray[np.float64]) -> list[AtSpeed]:
        """The route at each of some speeds."""
        robots = [replace(self._lattice.robot, speed_mps=float(v)) for v in speeds_mps]
        traction, length = self._tractions(robots), float(self._driven.sum())
        price = np.stack([robot.price_per_m(row) for robot, row in zip(robots, traction, strict=True)])
        known = np.isfinite(price)  # at an edge the lattice may know more, between its cells
        energy = np.nansum(price * self._driven, axis=1) / (known @ self._driven) * length + self._turning_j
        return [AtSpeed(float(v), float(e), length / float(v)) for v, e in zip(speeds_mps, energy, strict=True)]

    def profile(self, speeds_mps: NDArray[np.float64], deadline_s: float | None) -> SpeedProfile:
        """A speed for each stretch; pieces that the model does not know cost what those beside them do."""
        robot = self._lattice.robot
        traction = self._tractions([replace(robot, speed_mps=float(v)) for v in speeds_mps])
        at = np.cumsum(self._driven)
        for row in traction:
            row[:] = np.interp(at, at[known := np.isfinite(row)], row[known])
        found = speed_profile(traction, self._driven, speeds_mps, robot, deadline_s=deadline_s)
        return replace(found, energy_j=found.energy_j + self._turning_j)

    def _tractions(self, robots: Sequence[Robot]) -> NDArray[np.float64]:
        """Traction of every piece for every robot, (robots, n) [J/m]; NaN where the model knows nothing."""
        out = np.empty((len(robots), self._driven.size))
        for first in range(0, self._driven.size, _STRETCH):
            check_stop()
            part = slice(first, first + _STRETCH)
            ends = self._ends[first : first + _STRETCH + 1]
            heights = ground_of(self._ground, _window(self._lattice, ends), self._lattice.robot)
            x, y = (0.5 * (ends[1:] + ends[:-1])).T
            for k, robot in enumerate(robots):
                traction = self._predictor.segment_traction(heights, robot, x, y, self._heading[part])
                out[k, part] = heights.layers.priced(traction, x, y, self._heading[part])
        if not np.isfinite(out).any(axis=1).all():
            raise InputError(
                "the model knows nothing of the ground along this route", length_m=float(self._driven.sum())
            )
        return out


def _window(lattice: CostLattice, ends: NDArray[np.float64]) -> GridFrame:
    """The cells around a route."""
    row, col = (np.asarray(v) for v in lattice.frame.rowcol(ends[:, 0], ends[:, 1]))
    rows, cols = lattice.frame.shape
    row0, col0 = max(int(row.min()) - 1, 0), max(int(col.min()) - 1, 0)
    return lattice.frame.window(row0, min(int(row.max()) + 3, rows), col0, min(int(col.max()) + 3, cols))
