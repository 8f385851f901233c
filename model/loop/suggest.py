"""What to drive next: the route that distinguishes confounded effects best, or measures a coefficient best.

Least squares predicts how far a drive would narrow a coefficient: only the columns of the effect, and of what it is
confounded with, matter, and not what will be measured. Simple routes are tried in many places and headings of the map,
and compared by the interval that old and new segments would leave together (D- and c-optimal design: Fedorov 1972).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from joulemap.model.errors import InfeasibleError
from joulemap.model.frames import heading_of, wrap_angle
from joulemap.model.loop.forms import Form
from joulemap.model.robot import Robot
from joulemap.model.runs.describe import planned_features
from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.residuals import Residuals
from joulemap.model.terrain.heightmap import Heightmap

Traction = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

_STEP_M = 0.1
_PLACES = 24
_SLOW = 0.6  # of the cruising speed
_ROOM = 1.25  # times the length that there is time for: more than that a round at every speed may not take


@dataclass(frozen=True)
class Suggestion:
    """A route to drive."""

    points: FloatArray  # (n, 2): Its corners [m]
    kind: str  # Its shape in words
    speeds: tuple[float, ...]  # To drive it at, round by round [m/s]
    shrinkage: float  # Expected width of the coefficient's interval over its width now, 0..1
    length_m: float  # Of one round


def suggest_drive(
    residuals: Residuals,
    effect: Form,
    rivals: Sequence[Form],
    heightmap: Heightmap,
    robot: Robot,
    traction: Traction,
    *,
    length_m: float = 200.0,
    seed: int = 0,
) -> Suggestion:
    """Return the best of a few hundred simple routes for the coefficients of an effect.

    `traction`: (x, y, heading) -> traction [J/m], NaN where driving is not allowed.
    """
    rng = np.random.default_rng(seed)
    count = len(effect.coefficient_names())
    usual = 0.2 * float(np.median(np.abs(residuals.measured[residuals.moving])))
    old = _information(residuals.features, [effect, *rivals], np.maximum(residuals.said, usual))
    now = _spread(old, count)
    best: Suggestion | None = None
    for kind, points in _routes(heightmap, length_m, rng):
        once = _along(points, heightmap, robot, traction, residuals)
        if once is None:
            continue
        for pace, speeds in (("", (robot.speed_mps,)), (", slow and fast", (_SLOW * robot.speed_mps, robot.speed_mps))):
            if len(speeds) * len(once) > _ROOM * length_m:
                continue
            rows = _over_and_over(once, speeds, length_m)
            then = _spread(old + _information(rows, [effect, *rivals], np.maximum(rows.predicted, usual)), count)
            if best is None or then / now < best.shrinkage:
                length = float(np.hypot(*np.diff(points, axis=0).T).sum())
                best = Suggestion(points, kind + pace, speeds, then / now, length)
    if best is None:
        raise InfeasibleError(f"no route of {length_m:g} m fits on the known ground of this map", length_m=length_m)
    return best


def _information(rows: Features, forms: Sequence[Form], scale: FloatArray) -> FloatArray:
    """Normal equations of forms with a scale beside them, per unit of noise variance."""
    level = rows.predicted[:, None]
    x = np.concatenate([*(form.columns(rows) for form in forms), level], axis=1) / scale[:, None]
    return np.asarray(x.T @ x)


def _spread(information: FloatArray, count: int) -> float:
    """Geometric mean of the standard deviations of the first `count` coefficients, all others free."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-12))
    scaled = information / np.outer(size, size) + 1e-9 * np.eye(size.size)
    covariance = np.linalg.inv(scaled)[:count, :count] / np.outer(size[:count], size[:count])
    return float(np.exp(np.linalg.slogdet(covariance)[1] / (2 * count)))


def _routes(heightmap: Heightmap, length_m: float, rng: np.random.Generator) -> Iterator[tuple[str, FloatArray]]:
    """Straight lines there and back, squares, slaloms and circles, at random places and headings (seeded)."""
    west, south, east, north = heightmap.frame.bounds
    side = min(east - west, north - south)
    for _ in range(_PLACES):
        x, y = rng.uniform(west, east), rng.uniform(south, north)
        turn = float(rng.uniform(0.0, 2.0 * math.pi))
        reach = float(rng.uniform(0.15, 0.4)) * min(side, length_m / 4.0)
        radius = float(rng.uniform(0.8, 4.0))
        circle = [(radius * math.cos(a), radius * math.sin(a)) for a in np.linspace(0.0, 2.0 * math.pi, 37)]
        shapes = {
            "a straight line there and back": [(0.0, -reach), (0.0, reach), (0.0, -reach)],
            "a square": [(-reach, -reach), (-reach, reach), (reach, reach), (reach, -reach), (-reach, -reach)],
            "a slalom": [(0.15 * reach * (-1) ** k, reach * (k / 6.0 - 0.5)) for k in range(7)],
            f"circles of {radius:.1f} m radius": circle,
        }
        for kind, corners in shapes.items():
            p = np.asarray(corners)
            px = x + p[:, 0] * math.cos(turn) + p[:, 1] * math.sin(turn)
            py = y - p[:, 0] * math.sin(turn) + p[:, 1] * math.cos(turn)
            if px.min() > west + 1 and px.max() < east - 1 and py.min() > south + 1 and py.max() < north - 1:
                yield kind, np.stack([px, py], axis=1)


def _along(
    points: FloatArray, heightmap: Heightmap, robot: Robot, traction: Traction, residuals: Residuals
) -> Features | None:
    """A route cut into 1 m segments, driven once; None if it is too short or leaves the known ground."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    fine = np.arange(0.0, s[-1], _STEP_M)
    x, y = np.interp(fine, s, points[:, 0]), np.interp(fine, s, points[:, 1])
    every = round(1.0 / _STEP_M)
    count = (fine.size - 1) // every
    if count < 4 or not np.isfinite(heightmap.sample(x, y)).all():
        return None
    heading = heading_of(np.diff(x), np.diff(y))
    steps = np.abs(wrap_angle(np.diff(heading, append=heading[-1])))
    middle = np.arange(count) * every + every // 2
    price = traction(x[middle], y[middle], heading[middle])
    conditions = {k: float(np.nanmean(v)) for k, v in residuals.features.columns.items() if np.isfinite(v).any()}
    plan = planned_features(heightmap, robot, x[middle], y[middle], heading[middle], price, conditions)
    if not (np.isfinite(price).all() and np.isfinite(plan.grade).all()):
        return None
    return replace(plan, turned_abs_rad=steps[: count * every].reshape(count, every).sum(axis=1))


def _over_and_over(once: Features, speeds: tuple[float, ...], length_m: float) -> Features:
    """A route driven again and again for about `length_m`, each round at the next speed."""
    count = len(once)
    rounds = max(len(speeds), round(length_m / count))
    pace = np.repeat([1.0 / speeds[k % len(speeds)] for k in range(rounds)], count)
    again = once.take(np.tile(np.arange(count), rounds))
    metres = np.arange(1.0, pace.size + 1.0)
    return replace(again, duration_s=pace, since_s=np.cumsum(pace), driven_m=metres)
