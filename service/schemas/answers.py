"""Answers to questions: routes and verdicts as the schemas beside this module."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from joulemap.planner.answers import Plan
from joulemap.planner.route import Route
from joulemap.planner.verdict.battery_trace import BatteryTrace
from joulemap.planner.verdict.budget import Verdict
from joulemap.planner.verdict.trajectory import Course
from joulemap.service.feasibility import Assessment
from joulemap.service.problems import jsonable
from joulemap.service.route_uncertainty import odds_along, quantiles_of_route
from joulemap.service.schemas.planning import (
    PieceOut,
    VerdictOut,
)
from joulemap.service.words import verdict_words

BAND = 0.05, 0.95
"""Nine of ten drives end between these quantiles."""


def verdict_out(verdict: Verdict) -> VerdictOut:
    """Return a verdict as an answer.

    Parameters
    ----------
    verdict : Verdict
        From the planner.

    Returns
    -------
    VerdictOut
        With the verdict in words.
    """
    return VerdictOut(message=verdict_words(verdict), **asdict(verdict))


def route_values(route: Route) -> dict[str, Any]:
    """Return the values of a route that `RouteOut` takes.

    Parameters
    ----------
    route : Route
        From the planner.

    Returns
    -------
    dict
        JSON-able.
    """
    return {
        "energy_j": route.energy_j,
        **quantiles_of_route(route),
        "energy_wh": route.energy_j / 3600.0,
        "length_m": route.length_m,
        "duration_s": route.duration_s,
        "climb_m": route.climb_m,
        "descent_m": route.descent_m,
        "path": path_points(route),
    }


def profile_pieces(routes: Sequence[Route]) -> list[Any]:
    """Return the profile of routes that are driven one after another.

    Parameters
    ----------
    routes : sequence of Route
        In the order of driving, priced on one lattice.

    Returns
    -------
    list of dict
        The values of `PieceOut`.
    """
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
    """Return the points of a route.

    Parameters
    ----------
    route : Route
        From the planner.

    Returns
    -------
    list of [x, y, z]
        World coordinates [m]; z is None where unknown.
    """
    if np.isfinite(route.points).all():
        return route.points.tolist()
    return [[number(v) for v in point] for point in route.points.tolist()]


def number(value: float) -> float | None:
    """Return a number as JSON knows it.

    Parameters
    ----------
    value : float
        Any.

    Returns
    -------
    float or None
        None where it is not finite.
    """
    return value if math.isfinite(value) else None


def path_values(plan: Plan, verdict: Verdict | None, warnings: list[str]) -> dict[str, Any]:
    """Return the answer to the question for a path.

    Parameters
    ----------
    plan : Plan
        From the planner.
    verdict : Verdict or None
        None where none was asked for.
    warnings : list of str
        Of the cost map.

    Returns
    -------
    dict
        The values of `PathOut`, with the shortest path beside, JSON-able; a model of so many numbers takes longer to
        make than to write.
    """
    route, shortest = plan.route, plan.shortest
    return {
        **route_values(route),
        "profile": profile_pieces([route]),
        "shortest": {"energy_j": shortest.energy_j, "length_m": shortest.length_m, "path": path_points(shortest)},
        "alternatives": [route_values(other) for other in plan.others],
        "saving_j": plan.saving_j,
        "saving_percent": _percent(plan.saving_j, shortest.energy_j),
        "battery": verdict_out(verdict).model_dump() if verdict is not None else None,
        "bound_j": plan.bound_j,
        "gap": plan.gap,
        "objective": plan.details.get("objective"),
        "planner": plan.planner,
        "details": jsonable({name: value for name, value in plan.details.items() if name != "objective"}),
        "warnings": [*warnings, *route.notes],
        "crs": route.crs,
    }


def feasibility_values(
    assessment: Assessment, warnings: list[str], *, along: tuple[Course, BatteryTrace] | None = None
) -> dict[str, Any]:
    """Return the answer to the question whether the battery lasts.

    Parameters
    ----------
    assessment : Assessment
        Verdict and routes.
    warnings : list of str
        Of the cost map.
    along : tuple of (Course, BatteryTrace), optional
        The battery piece by piece.

    Returns
    -------
    dict
        The values of `FeasibilityOut`, the verdict with its routes, JSON-able.
    """
    routes = [r for r in (assessment.route_out, assessment.route_back) if r is not None]
    return {
        **verdict_out(assessment.verdict).model_dump(),
        "length_m": sum(r.length_m for r in routes),
        "duration_s": sum(r.duration_s for r in routes),
        "out": route_values(assessment.route_out),
        "back": route_values(routes[1]) if len(routes) == 2 else None,
        "objective": None if assessment.weighed is None else asdict(assessment.weighed),
        "profile": None if along is None else _battery_pieces(*along),
        "warnings": [*warnings, *(note for r in routes for note in r.notes)],
    }


def _battery_pieces(course: Course, trace: BatteryTrace) -> list[Any]:
    columns = (course.distance_m, np.cumsum(course.duration_s), trace.charge, trace.voltage_v, trace.power_w)
    return [
        {"distance_m": distance, "time_s": time, "charge": charge, "voltage_v": voltage, "power_w": power}
        for distance, time, charge, voltage, power in zip(*(column.tolist() for column in columns), strict=True)
    ]


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0 else 0.0
