"""What closes the way between two places: which limit, where, by how much, and what would open it.

The level of a grid move says by how many whole degrees or centimetres a limit must change before it may be driven. The
way whose greatest level is least (a minimax path) is found by one search, and its level opens a way.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import NoRouteError
from joulemap.model.frames import heading_of, heading_vector
from joulemap.model.ranges import ROBOT
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import ANY_ANGLE_NEIGHBOURS
from joulemap.planner.grid.search import joining_legs
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.obstacles import MEETS, meets
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.move_prices import leg_stencils, move_offsets
from joulemap.planner.pricing.polylines import subdivided

_WORDS = {
    "max_grade_deg": "grade along the motion",
    "max_cross_slope_deg": "slope across the motion",
    "clearance_m": "clearance of its outline",
}
_SAMPLES_PER_CELL = 4
_NEVER = np.iinfo(np.uint16).max


def way_is_closed(lattice: CostLattice, start: Points, goal: Points) -> NoRouteError | None:
    """Return the error that says what closes the way from start to goal; None where the limits leave one open.

    `start`, `goal` (2,): fractional (row, col). It names the limit that opens a way over grid moves when it is changed
    by the least share; where none does so alone, the narrowest gap between the places that the start leads to and those
    that lead to the goal. Limits of power play no part.
    """
    shape, flat = lattice.frame.shape, np.array([lattice.frame.cols, 1])
    offsets = move_offsets(ANY_ANGLE_NEIGHBOURS)
    jump = offsets @ flat
    joints = joining_legs(lattice, start, outward=True), joining_legs(lattice, goal, outward=False)
    seeds, targets = (cells[np.isfinite(legs)] @ flat for cells, legs in joints)
    closes, share = None, math.inf
    for limit in _WORDS:  # of each only what changes it by a smaller share
        values = _values(lattice.robot, limit, share)
        ground = _ground(lattice, offsets, limit, values)
        least, came = _spread(ground, values.size, jump, seeds, targets, False)
        cell = targets[np.argmin(least[targets])] if targets.size else -1
        level = int(least[cell]) if targets.size else _NEVER
        if level == 0:
            return None
        if level < _NEVER:
            share = abs(values[level] / values[0] - 1.0)
            while least[cell] == level:
                move = came[cell]
                cell -= jump[move]
            place = np.array(divmod(cell, shape[1]), dtype=np.float64)
            closes = limit, float(values[level]), np.stack([place, place + offsets[move]])
    if closes is None:
        back, _ = _spread(ground, 1, jump, targets, seeds, True)
        words, context = _gap(lattice, (least == 0).reshape(shape), (back == 0).reshape(shape), np.stack([start, goal]))
    else:
        words, context = _opening_words(lattice, *closes)
    reached = int((least == 0).sum())
    return NoRouteError(
        f"no way leads from start to goal within the limits of {lattice.robot.name}: {words}; {reached:,} places can "
        "be reached from the start, and the goal is none of them",
        reached=reached,
        **context,
    )


def _values(robot: Robot, limit: str, share: float) -> NDArray[np.float64]:
    """The robot's limit, and laxer ones by whole degrees or centimetres that differ from it by less than a share."""
    given = getattr(robot, limit)
    if limit == "clearance_m":
        values = np.arange(math.ceil(100.0 * given) - 1, -1, -1) / 100.0
    else:
        values = np.arange(math.floor(given) + 1.0, ROBOT[limit].high + 1.0)
    return np.append(given, values[np.abs(values - given) < share * given])


def _ground(
    lattice: CostLattice, offsets: NDArray[np.int64], limit: str, values: NDArray[np.float64]
) -> tuple[Any, ...]:
    """What `_level` reads: the ground, the moves, and the limits at every value of one of them."""
    at = {name: np.full(values.size, getattr(lattice.robot, name)) for name in _WORDS} | {limit: values}
    grade, cross = (np.tan(np.deg2rad(at[name])) for name in ("max_grade_deg", "max_cross_slope_deg"))
    wider = (at["clearance_m"] - lattice.robot.clearance_m) / lattice.frame.resolution_m
    east, north = (part.astype(np.float32) for part in heading_vector(heading_of(offsets[:, 1], -offsets[:, 0])))
    stencils = leg_stencils(np.hstack([np.zeros(offsets.shape), offsets]))
    return lattice.gradient, lattice.closed, offsets, east, north, *stencils, grade, cross, wider


@njit(cache=True, nogil=True)
def _level(ground, i, j, n):
    """The first of the values at which move n may be driven from a cell; `_NEVER` where at none."""
    gradient, closed, offsets, east, north, cells, shares, grade, cross, wider = ground
    rows, cols = closed.codes.shape
    leg = i, j, i + offsets[n, 0], j + offsets[n, 1]
    if not (0 <= leg[2] < rows and 0 <= leg[3] < cols):
        return _NEVER
    steep = tilted = np.float32(0.0)
    for s in range(shares.shape[1]):
        if shares[n, s] < 0.0:
            break
        a, b = i + cells[n, s, 0], j + cells[n, s, 1]
        along = abs(gradient[a, b, 0] * east[n] + gradient[a, b, 1] * north[n])
        across = abs(gradient[a, b, 0] * north[n] - gradient[a, b, 1] * east[n])
        free = closed.codes[a, b] == 0 or closed.codes[a, b] == MEETS
        if not (free and along <= grade[-1] and across <= cross[-1]):
            return _NEVER
        steep, tilted = max(steep, along), max(tilted, across)
    level = max(np.searchsorted(grade, steep), np.searchsorted(cross, tilted))
    if closed.room.size > 0 and (closed.near.size == 0 or closed.near[i, j]):
        if meets(closed.room, closed.body, *leg, east[n], north[n], wider[-1]):
            return _NEVER
        while meets(closed.room, closed.body, *leg, east[n], north[n], wider[level]):
            level += 1
    return level


@njit(cache=True, nogil=True)
def _spread(ground, count, jump, seeds, targets, backward):
    """The least level of a way from some cells to every other one, and the move that ends it, -1 for none: (cells,).

    All cells of level 0 are known, and those up to the level of the first target. count : of levels.
    """
    rows, cols = ground[1].codes.shape
    least, came = np.full(rows * cols, _NEVER, np.uint16), np.full(rows * cols, -1, np.int8)
    least[seeds] = 0
    queue = np.empty(least.size, dtype=np.int64)
    for level in range(count):
        waiting = taken = 0
        for cell in range(least.size):
            if least[cell] == level:
                queue[waiting] = cell
                waiting += 1
        while taken < waiting:
            cell = queue[taken]
            taken += 1
            for n in range(jump.size):
                other = cell - jump[n] if backward else cell + jump[n]
                if 0 <= other < least.size and least[other] > level:
                    leaves = other if backward else cell
                    needs = max(level, _level(ground, leaves // cols, leaves % cols, n))
                    if needs < least[other]:
                        least[other], came[other] = needs, n
                        if needs == level:
                            queue[waiting] = other
                            waiting += 1
        for cell in targets:
            if least[cell] <= level:
                return least, came
    return least, came


def _opening_words(lattice: CostLattice, limit: str, value: float, move: Points) -> tuple[str, dict[str, Any]]:
    """Where a move, (2, 2) (row, col), closes the way that a value of a limit opens, and by how much."""
    given, found, (down, right) = getattr(lattice.robot, limit), "", move[1] - move[0]
    if limit != "clearance_m":
        cells = np.rint(subdivided(move, 1.0 / _SAMPLES_PER_CELL)).astype(np.int64)
        rises = lattice.gradient[tuple(cells.T)] @ ((right, -down) if limit == "max_grade_deg" else (down, right))
        steepest = math.degrees(math.atan(float(np.abs(rises).max()) / math.hypot(down, right)))
        found = f", up to {steepest:.1f} deg where {given:g} deg are allowed"
    x, y = (float(v) for v in lattice.frame.xy(*move.mean(axis=0)))
    return (
        f"the {_WORDS[limit]} closes it at ({x:.2f}, {y:.2f}){found}; with {limit} {value:g} instead of {given:g} a "
        "route exists"
    ), {"limit": limit, "allowed": given, "opens": value, "place": [x, y]}


def _gap(
    lattice: CostLattice, here: NDArray[np.bool_], there: NDArray[np.bool_], places: Points
) -> tuple[str, dict[str, Any]]:
    """The narrowest gap between cells that the start leads to and those that lead to the goal, and what it holds."""
    from scipy.ndimage import distance_transform_edt  # loads slowly

    for cells, place in zip((here, there), places, strict=True):
        cells[tuple(np.rint(place).astype(np.int64))] = True
    away, nearest = distance_transform_edt(~there, return_indices=True)
    narrowest = np.argwhere(here & (away <= away[here].min()))
    detour = sum(np.hypot(*(narrowest - place).T) for place in places)
    cell = tuple(narrowest[np.argmin(detour)])
    ends = np.array([cell, nearest[(slice(None), *cell)]], dtype=np.float64)
    between = np.rint(subdivided(ends, 1.0 / _SAMPLES_PER_CELL)).astype(np.int64)
    codes = lattice.blocked[tuple(between.T)]
    reason = Blocked(int(codes[np.argmax(codes > 0)]))
    wide_m = float(np.hypot(*np.diff(ends, axis=0)[0])) * lattice.frame.resolution_m
    x, y = (float(v) for v in lattice.frame.xy(*ends.mean(axis=0)))
    return (
        f"{_reason_words(reason, lattice.robot)} closes it at ({x:.2f}, {y:.2f}), the gap is {wide_m:.2g} m wide; "
        "changing only the limit of grade, cross slope or clearance does not help"
    ), {"limit": reason.label, "place": [x, y], "gap_m": wide_m}


def _reason_words(reason: Blocked, robot: Robot) -> str:
    return {
        Blocked.OUTSIDE: "the edge of the map",
        Blocked.UNKNOWN: "ground of unknown height",
        Blocked.STEP: f"a step or a wall that is higher than the wheel radius of {robot.wheel_radius_m:g} m",
        Blocked.AVOID: "an area that is to be avoided",
        Blocked.OBSTACLE: f"an obstacle that its outline of {robot.length_m:g} x {robot.width_m:g} m with "
        f"{robot.clearance_m:g} m of clearance would meet",
    }.get(reason, "steep ground")
