"""Answers about what is kept: rows of the database as the schemas beside this module."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from joulemap.model.errors import ConflictError, JoulemapError, NotFoundError
from joulemap.service.problems import problem_of
from joulemap.service.schemas.base import Problem, RobotOut, UnreadableOut
from joulemap.service.schemas.loop import CalibrationOut, RunOut, RunsOut
from joulemap.service.schemas.maps import CostmapOut, HeightmapOut
from joulemap.service.storage.sent import there
from joulemap.service.storage.tables import (
    DONE,
    NO_TIME,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    JobRow,
    RunsRow,
    Sent,
    named_test_runs,
)

_LOG = logging.getLogger("joulemap.service")
Row = TypeVar("Row", HeightmapRow, RunsRow, CostmapRow, CalibrationRow)
Answer = TypeVar("Answer", bound=BaseModel)


def shown(row: Row, answer: Callable[[Row], Answer]) -> Answer:
    """Return the answer about a row.

    Raises ConflictError if an older version stored values in it that are not valid, NotFoundError if a repair put away
    what was sent.
    """
    try:
        return answer(there(row) if isinstance(row, Sent) else row)
    except NotFoundError:
        raise
    except (ValidationError, JoulemapError, LookupError, TypeError, ValueError, AttributeError) as error:
        _LOG.warning("%s cannot be shown", row.id, exc_info=error)
        raise ConflictError(f"{row.id} is kept, but cannot be shown: {_reason(error)}. Delete it", id=row.id) from error


def listed(rows: Iterable[Row], answer: Callable[[Row], Answer]) -> list[Answer | UnreadableOut]:
    """Return the answers about the rows of a list; one that cannot be shown has a problem in its place."""
    found: list[Answer | UnreadableOut] = []
    for row in rows:
        try:
            found.append(shown(row, answer))
        except (ConflictError, NotFoundError) as error:
            problem = Problem(**problem_of(error))
            found.append(UnreadableOut(id=row.id, created_at=row.created_at.replace(tzinfo=dt.UTC), problem=problem))
    return found


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False, include_input=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return f"{type(error).__name__}: {str(error)[:200]}"


def heightmap_out(row: HeightmapRow) -> HeightmapOut:
    """Return the answer about a heightmap."""
    links = {"self": f"/v1/heightmaps/{row.id}"}
    return HeightmapOut(id=row.id, name=row.name, created_at=_utc(row.created_at), links=links, **row.stats)


def costmap_out(row: CostmapRow) -> CostmapOut:
    """Return the answer about a cost map, done or not."""
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
            "matrix": f"{base}/matrix",
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
    """Return the answer about runs that were sent together."""
    runs = [RunOut(**run) for run in row.stats]
    return RunsOut(id=row.id, created_at=_utc(row.created_at), runs=runs, links={"self": f"/v1/runs/{row.id}"})


def calibration_out(row: CalibrationRow, *, with_report: bool = True) -> CalibrationOut:
    """Return the answer about a calibration, done or not."""
    base, asked, summary = f"/v1/calibrations/{row.id}", row.request, row.summary or {}
    report = summary.get("report")
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
        found=[one["label"] for one in report["effects"]] if report else None,
        report=report if with_report else None,
        links=links,
    )


def _utc(time: dt.datetime) -> dt.datetime:
    """The time with its time zone: the database keeps UTC without one."""
    if time == NO_TIME:
        raise ValueError("its time is damaged")
    return time.replace(tzinfo=dt.UTC)


ANSWERS: dict[Any, Callable[[Any], BaseModel]] = {
    HeightmapRow: heightmap_out,
    RunsRow: runs_out,
    CostmapRow: costmap_out,
    CalibrationRow: calibration_out,
}
"""How a row of each table is answered."""
