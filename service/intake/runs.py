"""Checks measured runs that were sent, and says to the sender what was read, repaired and left out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.arcs import arc_track, segment_length
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.logs import read_log
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.plausible import doubtful, implausible
from joulemap.model.runs.reader import run_of, run_of_table
from joulemap.model.runs.rolling import cut_travel, rolled_m
from joulemap.model.runs.run import Run
from joulemap.model.runs.table import TableLimits
from joulemap.model.runs.table_columns import Table
from joulemap.model.runs.writers import write_csv
from joulemap.model.terrain.coordinate_systems import utm_zone
from joulemap.service.intake.guard import Guard
from joulemap.service.intake.limits import RunLimits, RunReading

_PLAIN = "CSV text"  # the format in which logs are written
_SHOWN = ("t", "x", "y", "lat", "lon", "z", "distance", "speed", "voltage", "current", "power", "soc")
_ROWS_SHOWN = 5
_POINTS_DRAWN = 2_000


def check_together(runs: Sequence[Mapping[str, Any]], ground: Mapping[str, Any] | None) -> None:
    """Refuse runs that do not lie on their heightmap.

    `ground`: ``bounds`` of the heightmap that they were driven on, None where it is not known.
    """
    for run in runs:
        if ground is not None and not run["placed"]:
            raise RunsError(
                f"run {run['name']} has a distance and no positions, so it lies on no heightmap: send it without "
                "heightmap_id",
                run=run["name"],
            )
        if ground is not None and not _overlap(run["bounds"], ground["bounds"]):
            raise RunsError(
                f"run {run['name']} was driven at {_box(run['bounds'])}, the heightmap is {_box(ground['bounds'])}: "
                "they do not belong together",
                run=run["name"],
                bounds=run["bounds"],
                heightmap_bounds=ground["bounds"],
            )


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two boxes [west, south, east, north] touch."""
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _box(bounds: Sequence[float]) -> str:
    west, south, east, north = bounds
    return f"x {west:.0f}..{east:.0f}, y {south:.0f}..{north:.0f}"


def read_sent_run(
    *,
    guard: Guard,
    path: str,
    name: str,
    limits_of_run: Mapping[str, Any],
    reading: Mapping[str, Any],
    crs: str | None = None,
    out: str | None = None,
    any_place: bool = False,
    always: bool = False,
    picture: bool = False,
) -> dict[str, Any]:
    """Read one run, write it in joulemap's columns where it is in others, and return what it contains.

    `reading`: that of `RunReading.as_dict`. `picture`: whether the answer has the ``track``: x, y [m] and what is drawn
    [W or A], for a drawing. Result: JSON-able: rows, seconds, target, further columns, number of 1 m segments,
    ``repairs`` and ``left_out`` (counts by rule), bounds [west, south, east, north] [m], odometry, format, ``reading``
    (what was taken from where), ``warnings``, metres, median of the energy per metre, and whether `out` was
    ``written``.
    """
    file, limits, asked = Path(path), RunLimits(**limits_of_run), RunReading.from_dict(reading)
    size = file.stat().st_size
    if size > limits.mb * 1e6:
        raise TooLargeError(
            f"run {name} has {size / 1e6:.1f} MB, the limit is {limits.mb:g} MB: split it",
            run=name,
            bytes=size,
            limit_mb=limits.mb,
        )
    with guard.reading(file):
        repairs: dict[str, int] = {}
        table = read_log(file, name, repairs, limits=TableLimits(**limits.table), mapping=asked.mapping)
        if any_place and crs is None and "x" not in table.numbers:
            crs = _zone_of(table)
        try:
            run = run_of_table(table, name=name, crs=crs, repairs=repairs, odometry=asked.odometry)
        except RunsError as error:  # who is asked for a column sees those that were recognised
            error.context["reading"] = table.reading
            raise
        found = _about(run, name, limits, asked)
        found |= {"format": table.format, "reading": table.reading, "written": False}
        found["confidence"] = table.confidence
        found["first_rows"] = _first_rows(table)
        if picture:
            found["track"] = _track(run)
        found["warnings"] = [*run.notes, *found["warnings"]]
        if out is not None and (always or table.reading or table.format != _PLAIN):
            begun = Path(f"{out}.part")
            try:
                write_csv(begun, table)
                os.replace(begun, out)
            finally:
                begun.unlink(missing_ok=True)
            found["written"] = True
        return found


def _first_rows(table: Table) -> dict[str, list[float | None]]:
    """What a run needs, as it was understood."""
    parts = [key for key in table.numbers if key.startswith("current_")]
    shown = [key for key in (*_SHOWN, *parts) if key in table.numbers]
    return {
        key: [None if not np.isfinite(v) else float(v) for v in table.numbers[key][:_ROWS_SHOWN].tolist()]
        for key in shown
    }


def _track(run: Run) -> list[list[float | None]]:
    known = np.flatnonzero(np.isfinite(run.x) & np.isfinite(run.y))
    rows = known[:: max(1, known.size // _POINTS_DRAWN)]
    drawn = np.full(len(run), np.nan) if run.whole_j is not None else run.drawn(charge=not run.has_energy)
    z = run.extras.get("z", np.full(len(run), np.nan))
    columns = (run.x[rows], run.y[rows], drawn[rows], z[rows])
    return [[v if np.isfinite(v) else None for v in values.tolist()] for values in columns]


def _zone_of(table: Table) -> str | None:
    lat, lon = table.numbers.get("lat"), table.numbers.get("lon")
    if lat is None or lon is None or not (np.isfinite(lat) & np.isfinite(lon)).any():
        return None
    middle = float(np.nanmedian(lat))
    polar = "EPSG:32661" if middle > 0 else "EPSG:32761"  # universal polar stereographic
    return utm_zone(float(np.nanmedian(lon)), middle) or polar


def _about(run: Run, name: str, limits: RunLimits, asked: RunReading) -> dict[str, Any]:
    odometry = asked.odometry
    known = np.isfinite(run.x) & np.isfinite(run.y)
    x, y = run.x[known], run.y[known]
    km = float(np.hypot(np.diff(x), np.diff(y)).sum()) / 1000.0
    if odometry is not None:
        km = max(km, rolled_m(run) / 1000.0)
    if km > limits.km:
        raise TooLargeError(
            f"run {name} is {km:.4g} km long, the limit is {limits.km:g} km: are its positions in metres, and its "
            "speeds in m/s?",
            run=name,
            km=km,
            limit_km=limits.km,
        )
    if run.whole_j is not None:
        track = arc_track(run, segment_length(run))
        segments, metres = None, track.arc_m[-1] + track.gap_m
    else:
        cut = cut_segments if odometry is None else cut_travel
        segments = cut(run, charge=not run.has_energy)
        metres = float(segments.driven_m.sum())
    wrong = implausible(run, segments)
    if wrong and not asked.accept_implausible:
        raise RunsError(
            f"run {name} is implausible: {'; '.join(wrong)} Nothing is kept. A mapping says the unit, such as "
            "current=current:mA; `accept_implausible` keeps it as it is",
            run=name,
            implausible=wrong,
        )
    if segments is not None and len(segments) == 0:
        raise RunsError(
            f"run {name} contains no segment of 1 m: "
            + ("; ".join(run.notes) or "did the robot move, and is its position recorded?"),
            run=name,
            repairs=run.repairs,
            left_out=segments.left_out,
        )
    energy, spread = run.energy() if run.has_energy else (None, None)
    return {
        "name": name,
        "rows": len(run),
        "seconds": float(run.t[-1] - run.t[0]),
        "target": "energy_j" if run.has_energy else "charge_as",
        "columns": sorted([*run.extras, *run.texts]),
        "segments": 0 if segments is None else len(segments),
        "repairs": run.repairs,
        "left_out": {} if segments is None else segments.left_out,
        "bounds": [float(v) for v in (x.min(), y.min(), x.max(), y.max())],
        "odometry": None if odometry is None else asdict(odometry),
        "metres": float(metres),
        "per_m": None if segments is None else float(np.median(segments.energy_j / segments.driven_m)),
        "energy_j": energy,
        "energy_std_j": spread,
        "unknown_seconds": run.unknown_s,
        "placed": run.placed and odometry is None,
        "warnings": [*wrong, *doubtful(run, None if odometry is not None else segments)],
    }


def load_kernels() -> None:
    """Load, or compile, the kernels that reading a run needs. No file is read, because Arrow would start threads."""
    k = np.arange(200.0)
    every = {"t": 0.1 * k, "speed_left": 0.0 * k + 0.5, "speed_right": 0.0 * k + 0.4, "gps_error": 0.0 * k + 0.01}
    every |= {"left_current": 0.0 * k + 2.0, "right_current": 0.0 * k - 2.0, "x": 0.05 * k, "y": 0.01 * k}
    every["x"][50], every["x"][90] = np.nan, 500.0
    cut_segments(run_of(dict(every), {}, name="warm-up"), charge=True)
    odometry = {key: values for key, values in every.items() if key not in ("x", "y")}
    cut_travel(run_of_table(Table(odometry, {}), odometry=Odometry(1.0), name="warm-up"), charge=True)
