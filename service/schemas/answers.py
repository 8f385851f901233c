"""Answers to questions: routes and verdicts as the schemas beside this module."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from joulemap.model.battery import Battery
from joulemap.model.robot import Robot
from joulemap.planner.battery_trace import BatteryTrace
from joulemap.planner.budget import Verdict
from joulemap.planner.course import Course
from joulemap.planner.plan import Plan
from joulemap.planner.route import Route
from joulemap.service.problems import jsonable
from joulemap.service.route_uncertainty import quantiles_of_route
from joulemap.service.schemas.planning import (
    BatteryIn,
    FeasibilityOut,
    PathOut,
    RouteOut,
    ShortestOut,
    VerdictOut,
)
from joulemap.service.words import verdict_words
from joulemap.service.workflows import Assessment


def battery_of(request: BatteryIn | None, robot: Robot) -> Battery:
    """Return the battery of a request.

    Parameters
    ----------
    request : BatteryIn or None
        What was sent.
    robot : Robot
        Whose battery it is where the request does not say.

    Returns
    -------
    Battery
        With its capacity [Wh].
    """
    given = request or BatteryIn()
    values = given.model_dump(exclude_none=True)
    return Battery(**{"capacity_wh": robot.battery_wh} | values)


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


def path_out(plan: Plan, verdict: Verdict | None, warnings: list[str]) -> PathOut:
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
    PathOut
        With the shortest path beside.
    """
    route, shortest = plan.route, plan.shortest
    p = route.profile
    columns = (p.distance_m, p.x, p.y, p.z, np.rad2deg(p.heading_rad), p.energy_j, p.cumulative_j)
    pieces: list[Any] = [  # checked all at once below, which takes a third of the time
        {"distance_m": d, "x": x, "y": y, "z": number(z), "heading_deg": h, "energy_j": e, "cumulative_j": c}
        for d, x, y, z, h, e, c in zip(*(column.tolist() for column in columns), strict=True)
    ]
    return PathOut(
        **route_values(route),
        profile=pieces,
        shortest=ShortestOut(energy_j=shortest.energy_j, length_m=shortest.length_m, path=path_points(shortest)),
        alternatives=[RouteOut(**route_values(other)) for other in plan.others],
        saving_j=plan.saving_j,
        saving_percent=_percent(plan.saving_j, shortest.energy_j),
        battery=verdict_out(verdict) if verdict is not None else None,
        bound_j=plan.bound_j,
        gap=plan.gap,
        planner=plan.planner,
        details=jsonable(plan.details),
        warnings=[*warnings, *route.notes],
        crs=route.crs,
    )


def feasibility_out(
    assessment: Assessment, warnings: list[str], *, along: tuple[Course, BatteryTrace] | None = None
) -> FeasibilityOut:
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
    FeasibilityOut
        The verdict with its routes.
    """
    routes = [r for r in (assessment.route_out, assessment.route_back) if r is not None]
    return FeasibilityOut(
        **verdict_out(assessment.verdict).model_dump(),
        length_m=sum(r.length_m for r in routes),
        duration_s=sum(r.duration_s for r in routes),
        out=RouteOut(**route_values(assessment.route_out)),
        back=RouteOut(**route_values(routes[1])) if len(routes) == 2 else None,
        profile=None if along is None else _battery_pieces(*along),
        warnings=[*warnings, *(note for r in routes for note in r.notes)],
    )


def _battery_pieces(course: Course, trace: BatteryTrace) -> list[Any]:
    columns = (course.distance_m, np.cumsum(course.duration_s), trace.charge, trace.voltage_v, trace.power_w)
    return [
        {"distance_m": distance, "time_s": time, "charge": charge, "voltage_v": voltage, "power_w": power}
        for distance, time, charge, voltage, power in zip(*(column.tolist() for column in columns), strict=True)
    ]


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0 else 0.0
