"""Checks measured runs that were sent, and says to the sender what was read, repaired and left out."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.odometry import Odometry, cut_travel, read_odometry
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.table import TableLimits
from joulemap.service.intake.limits import RunLimits
from joulemap.service.intake.maps import Guard


def check_together(runs: Sequence[Mapping[str, Any]], ground: Mapping[str, Any] | None) -> None:
    """Refuse runs that do not lie on their heightmap.

    Parameters
    ----------
    runs : sequence of mapping
        As `read_sent_run` returns them.
    ground : mapping or None
        ``bounds`` of the heightmap that they were driven on; None where it is not known.

    Raises
    ------
    RunsError
        If a run does not lie on the heightmap.
    """
    for run in runs:
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
    crs: str | None = None,
    odometry: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Read one run and return what it contains.

    Parameters
    ----------
    guard : Guard
        Limits of the process.
    path : str
        The file.
    name : str
        What to call it in messages.
    limits_of_run : mapping
        How large it may be: the fields of `RunLimits`.
    crs : str, optional
        Coordinate system of the heightmap, for columns ``lat`` and ``lon``.
    odometry : mapping, optional
        How a run without positions is read: the fields of `Odometry`.

    Returns
    -------
    dict
        JSON-able: rows, seconds, target, further columns, number of 1 m segments, ``repairs`` and ``left_out`` (counts
        by rule), bounds [west, south, east, north] [m] and odometry.

    Raises
    ------
    TooLargeError
        If it is larger than the limits.
    RunsError
        If nothing can be read, or if it contains no segment.
    """
    file, limits = Path(path), RunLimits(**limits_of_run)
    size = file.stat().st_size
    if size > limits.mb * 1e6:
        raise TooLargeError(
            f"run {name} has {size / 1e6:.1f} MB, the limit is {limits.mb:g} MB: split it",
            run=name,
            bytes=size,
            limit_mb=limits.mb,
        )
    with guard.reading(file):
        return _read(file, name, limits, crs, None if odometry is None else Odometry(**odometry))


def _read(file: Path, name: str, limits: RunLimits, crs: str | None, odometry: Odometry | None) -> dict[str, Any]:
    table = TableLimits(limits.rows, limits.columns, limits.cells, limits.text_mb)
    if odometry is not None:
        run = read_odometry(file, odometry, name=name, limits=table)
    else:
        run = parse_run(file.read_bytes(), name=name, crs=crs, limits=table)
    known = np.isfinite(run.x) & np.isfinite(run.y)
    x, y = run.x[known], run.y[known]
    km = float(np.hypot(np.diff(x), np.diff(y)).sum()) / 1000.0
    if km > limits.km:
        raise TooLargeError(
            f"run {name} is {km:.4g} km long, the limit is {limits.km:g} km: are its positions in metres?",
            run=name,
            km=km,
            limit_km=limits.km,
        )
    cut = cut_segments if odometry is None else cut_travel
    segments = cut(run, charge=not run.has_energy)
    if len(segments) == 0:
        raise RunsError(
            f"run {name} contains no segment of 1 m: did the robot move, and is its position recorded?",
            run=name,
            repairs=run.repairs,
            left_out=segments.left_out,
        )
    return {
        "name": name,
        "rows": len(run),
        "seconds": float(run.t[-1] - run.t[0]),
        "target": "energy_j" if run.has_energy else "charge_as",
        "columns": sorted([*run.extras, *run.texts]),
        "segments": len(segments),
        "repairs": run.repairs,
        "left_out": segments.left_out,
        "bounds": [float(v) for v in (x.min(), y.min(), x.max(), y.max())],
        "odometry": None if odometry is None else asdict(odometry),
    }


def load_kernels() -> None:
    """Load, or compile, the kernels that reading a run needs."""
    header = "t,x,y,left_current,right_current,speed_left,speed_right,gps_error"
    rows = [f"{0.1 * k:.1f},{0.05 * k:.2f},{0.01 * k:.2f},2,-2,0.5,0.4,0.01" for k in range(200)]
    rows[50] = "5.0,,,2,-2,0.5,0.4,"
    rows[90] = "9.0,500,500,2,-2,0.5,0.4,0.01"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "warm-up.csv"
        file.write_text("\n".join([header, *rows]), encoding="ascii")
        cut_segments(parse_run(file.read_bytes(), name=file.name), charge=True)
        cut_travel(read_odometry(file, Odometry(1.0)), charge=True)
