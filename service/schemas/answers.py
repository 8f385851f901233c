"""Answers to questions: routes and verdicts as the schemas beside this module."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from joulemap.planner.route import Route
from joulemap.planner.verdict.battery_trace import BatteryTrace
from joulemap.planner.verdict.budget import Verdict
from joulemap.planner.verdict.trajectory import Course
from joulemap.service.analysis.route_uncertainty import odds_along, quantiles_of_route
from joulemap.service.schemas.planning import PieceOut, VerdictOut
from joulemap.service.words import verdict_words

BAND = 0.05, 0.95
"""Nine of ten drives end between these quantiles."""


def verdict_out(verdict: Verdict) -> VerdictOut:
    """Return a verdict as an answer."""
    return VerdictOut(message=verdict_words(verdict), **asdict(verdict))


def route_values(route: Route) -> dict[str, Any]:
    """Return the values of a route that `RouteOut` takes."""
    return {
        "energy_j": route.energy_j,
        **quantiles_of_route(route),
        "energy_wh": route.energy_j / 3600.0,
        "length_m": route.length_m,
        "duration_s": route.duration_s,
        "climb_m": route.climb_m,
        "descent_m": route.descent_m,
        "goal_moved_m": route.goal_moved_m,
        "tightest_radius_m": route.tightest_radius_m,
        "path": path_points(route),
    }


def profile_pieces(routes: Sequence[Route]) -> list[Any]:
    """Return the values of `PieceOut` along routes of one lattice that are driven one after another."""
    odds = odds_along(routes)
    profiles = [route.profile for route in routes]
    x, y, z, heading, energy = (
        np.concatenate([getattr(p, name) for p in profiles]) for name in ("x", "y", "z", "heading_rad", "energy_j")
    )
    driven = np.cumsum([0.0, *(route.length_m for route in routes)])
    distance = np.concatenate([p.distance_m + before for p, before in zip(profiles, driven, strict=False)])
    columns = [c.tolist() for c in (distance, x, y, z, np.rad2deg(heading), energy, np.cumsum(energy))]
    if not np.isfinite(z).all():
        columns[3] = [number(height) for height in columns[3]]
    columns += [[None] * energy.size if odds is None else odds.quantile(share).tolist() for share in BAND]
    names = tuple(PieceOut.model_fields)
    return [dict(zip(names, piece, strict=True)) for piece in zip(*columns, strict=True)]


def path_points(route: Route) -> list[list[float | None]]:
    """Return the points of a route, world [x, y, z] [m]; z is None where unknown."""
    if np.isfinite(route.points).all():
        return route.points.tolist()
    return [[number(v) for v in point] for point in route.points.tolist()]


def number(value: float) -> float | None:
    """Return a number as JSON knows it: None where it is not finite."""
    return value if math.isfinite(value) else None


def battery_pieces(course: Course, trace: BatteryTrace) -> list[Any]:
    """Return the values of `BatteryPieceOut` along a way."""
    columns = (course.distance_m, np.cumsum(course.duration_s), trace.charge, trace.voltage_v, trace.power_w)
    return [
        {"distance_m": distance, "time_s": time, "charge": charge, "voltage_v": voltage, "power_w": power}
        for distance, time, charge, voltage, power in zip(*(column.tolist() for column in columns), strict=True)
    ]
