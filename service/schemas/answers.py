"""Makes answers of the schemas beside this module from rows, routes and verdicts."""

from __future__ import annotations

import datetime as dt
import logging
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from joulemap.model.battery import Battery
from joulemap.model.errors import ConflictError, JoulemapError
from joulemap.model.robot import Robot
from joulemap.planner.battery_trace import BatteryTrace
from joulemap.planner.budget import Verdict
from joulemap.planner.course import Course
from joulemap.planner.plan import Plan
from joulemap.planner.route import Route
from joulemap.service.problems import jsonable, problem_of
from joulemap.service.route_uncertainty import quantiles_of_route
from joulemap.service.schemas.base import Problem, RobotOut, UnreadableOut
from joulemap.service.schemas.loop import CalibrationOut, RunOut, RunsOut
from joulemap.service.schemas.maps import CostmapOut, HeightmapOut
from joulemap.service.schemas.planning import (
    BatteryIn,
    FeasibilityOut,
    PathOut,
    RouteOut,
    ShortestOut,
    VerdictOut,
)
from joulemap.service.storage.tables import (
    DONE,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    JobRow,
    RunsRow,
    named_test_runs,
)
from joulemap.service.words import verdict_words
from joulemap.service.workflows import Assessment

_LOG = logging.getLogger("joulemap.service")
Row = TypeVar("Row", HeightmapRow, RunsRow, CostmapRow, CalibrationRow)
Answer = TypeVar("Answer", bound=BaseModel)


def shown(row: Row, answer: Callable[[Row], Answer]) -> Answer:
    """Return the answer about a row.

    Parameters
    ----------
    row : HeightmapRow, RunsRow or JobRow
        As it is in the database.
    answer : callable
        Makes the answer.

    Returns
    -------
    BaseModel
        The answer.

    Raises
    ------
    ConflictError
        If an older version stored values in it that are not valid.
    """
    try:
        return answer(row)
    except (ValidationError, JoulemapError, KeyError, TypeError, ValueError) as error:
        _LOG.warning("%s cannot be shown", row.id, exc_info=error)
        raise ConflictError(f"{row.id} is kept, but cannot be shown: {_reason(error)}. Delete it", id=row.id) from error


def listed(rows: Iterable[Row], answer: Callable[[Row], Answer]) -> list[Answer | UnreadableOut]:
    """Return the answers about the rows of a list; one that cannot be shown has a problem in its place.

    Parameters
    ----------
    rows : iterable of HeightmapRow, RunsRow or JobRow
        As they are in the database.
    answer : callable
        Makes the answer about one.

    Returns
    -------
    list of BaseModel
        In the same order.
    """
    found: list[Answer | UnreadableOut] = []
    for row in rows:
        try:
            found.append(shown(row, answer))
        except ConflictError as error:
            problem = Problem(**problem_of(error))
            found.append(UnreadableOut(id=row.id, created_at=_utc(row.created_at), problem=problem))
    return found


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False, include_input=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return f"{type(error).__name__}: {str(error)[:200]}"


def heightmap_out(row: HeightmapRow) -> HeightmapOut:
    """Return the answer about a heightmap.

    Parameters
    ----------
    row : HeightmapRow
        As it is in the database.

    Returns
    -------
    HeightmapOut
        With links.
    """
    links = {"self": f"/v1/heightmaps/{row.id}"}
    return HeightmapOut(id=row.id, name=row.name, created_at=_utc(row.created_at), links=links, **row.stats)


def costmap_out(row: CostmapRow) -> CostmapOut:
    """Return the answer about a cost map, done or not.

    Parameters
    ----------
    row : CostmapRow
        As it is in the database.

    Returns
    -------
    CostmapOut
        With links to what can be asked now.
    """
    base = f"/v1/costmaps/{row.id}"
    summary = row.summary or {}
    links = {"self": base, "heightmap": f"/v1/heightmaps/{row.heightmap_id}"}
    if row.status == DONE:
        links |= {
            "geotiff": f"{base}/data?format=geotiff",
            "npz": f"{base}/data?format=npz",
            "zarr": f"{base}/data?format=zarr",
            "image": f"{base}/image.png",
            "provenance": f"{base}/provenance",
            "at": f"{base}/at",
            "paths": f"{base}/paths",
            "tours": f"{base}/tours",
            "feasibility": f"{base}/feasibility",
        }
    provenance = summary.get("provenance")
    return CostmapOut(
        **_job(row),
        heightmap_id=row.heightmap_id,
        robot=RobotOut(**row.robot),
        model=row.request["model"],
        headings=row.request["headings"],
        spacing_m=row.request["spacing_m"],
        frame=summary.get("frame"),
        energy_per_m=summary.get("energy_per_m"),
        blocked=summary.get("blocked"),
        warnings=(provenance or {}).get("warnings", []),
        provenance=None if provenance is None else {**provenance, "model": _short_model(provenance["model"])},
        links=links,
    )


def _short_model(model: Mapping[str, Any]) -> dict[str, Any]:
    """Which model it is, without how it was trained."""
    short = {key: model[key] for key in ("name", "kind", "version") if key in model}
    parent = model.get("config", {}).get("training", {}).get("parent")
    if parent is not None:
        short["parent"] = parent
    if "base" in model:
        short["base"] = _short_model(model["base"])
    return short


def _job(row: JobRow) -> dict[str, Any]:
    return {
        "id": row.id,
        "status": row.status,
        "progress": row.progress,
        "created_at": _utc(row.created_at),
        "finished_at": _utc(row.finished_at) if row.finished_at else None,
        "problem": row.problem,
    }


def runs_out(row: RunsRow) -> RunsOut:
    """Return the answer about runs that were sent together.

    Parameters
    ----------
    row : RunsRow
        As it is in the database.

    Returns
    -------
    RunsOut
        With links.
    """
    runs = [RunOut(**run) for run in row.stats]
    return RunsOut(id=row.id, created_at=_utc(row.created_at), runs=runs, links={"self": f"/v1/runs/{row.id}"})


def calibration_out(row: CalibrationRow, *, with_report: bool = True) -> CalibrationOut:
    """Return the answer about a calibration, done or not.

    Parameters
    ----------
    row : CalibrationRow
        As it is in the database.
    with_report : bool, optional
        Whether the report is part of the answer; lists leave it out.

    Returns
    -------
    CalibrationOut
        With links.
    """
    base, asked, summary = f"/v1/calibrations/{row.id}", row.request, row.summary or {}
    links = {"self": base}
    if row.heightmap_id is not None:
        links["heightmap"] = f"/v1/heightmaps/{row.heightmap_id}"
    if row.status == DONE:
        links["page"] = f"{base}/report.html"
    baseline, test = asked["base_runs"], named_test_runs(asked)
    return CalibrationOut(
        **_job(row),
        heightmap_id=row.heightmap_id,
        runs=asked["runs"],
        baseline_runs=baseline,
        test_runs=test,
        base_runs=baseline,
        aside_runs=test,
        robot=RobotOut(**asked["robot"]),
        model=asked["model"],
        calibrated_model=summary.get("model"),
        report=summary.get("report") if with_report else None,
        links=links,
    )


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


def _utc(time: dt.datetime) -> dt.datetime:
    """The time with its time zone: the database keeps UTC without one."""
    return time.replace(tzinfo=dt.UTC)


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0 else 0.0
