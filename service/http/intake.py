"""What is read of measured runs that were sent, for their sender: counts by rule, and limits before any is parsed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import InputError, RunsError, TooLargeError
from joulemap.model.runs.odometry import Odometry, cut_travel, read_odometry
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.segments import cut_segments
from joulemap.model.runs.table import PARQUET_MAGIC
from joulemap.service.storage.store import safe_name


@dataclass(frozen=True)
class RunLimits:
    """mb : of a file [1e6 bytes]; cells : rows x columns of its table; km : driven."""

    mb: float
    cells: int
    km: float


def read_sent_runs(
    files: Sequence[tuple[str, Path]],
    *,
    limits: RunLimits,
    ground: Mapping[str, Any] | None,
    odometry: Odometry | None = None,
) -> list[dict[str, Any]]:
    """What every run holds, (name, file) each, as `read_sent_run`. ground : `crs` and `bounds` of the heightmap that
    they were driven on, where it is known. Raises TooLargeError, RunsError, and InputError for two of one name.
    """
    names = [safe_name(name) for name, _ in files]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two runs are called {twice[0]}: send them under different names", name=twice[0])
    told = []
    for name, (_, path) in zip(names, files, strict=True):
        crs = ground["crs"] if ground is not None else None
        run = read_sent_run(path, name=name, limits=limits, crs=crs, odometry=odometry)
        if ground is not None and not _overlap(run["bounds"], ground["bounds"]):
            raise RunsError(
                f"run {name} was driven at {_box(run['bounds'])}, the heightmap is {_box(ground['bounds'])}: "
                "they do not belong together",
                run=name,
                bounds=run["bounds"],
                heightmap_bounds=ground["bounds"],
            )
        told.append(run)
    return told


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two boxes [west, south, east, north] touch."""
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _box(bounds: Sequence[float]) -> str:
    west, south, east, north = bounds
    return f"x {west:.0f}..{east:.0f}, y {south:.0f}..{north:.0f}"


def read_sent_run(
    path: Path, *, name: str, limits: RunLimits, crs: str | None = None, odometry: Odometry | None = None
) -> dict[str, Any]:
    """What a run holds, JSON-able: rows and seconds, its target, further columns, its segments of 1 m, `repairs` and
    `left_out` by rule, bounds [west, south, east, north] of its positions, `odometry`. crs : for `lat` and `lon`;
    odometry : of a run without positions.

    Raises TooLargeError, and RunsError where nothing can be read, or not a single segment.
    """
    size = path.stat().st_size
    if size > limits.mb * 1e6:
        raise TooLargeError(
            f"run {name} has {size / 1e6:.1f} MB, the limit is {limits.mb:g} MB: split it",
            run=name,
            bytes=size,
            limit_mb=limits.mb,
        )
    cells = _cells(path)
    if cells > limits.cells:
        raise TooLargeError(
            f"run {name} has {cells:,} cells, the limit is {limits.cells:,}: split it, or leave columns out",
            run=name,
            cells=cells,
            limit=limits.cells,
        )
    if odometry is not None:
        run = read_odometry(path, odometry, name=name)
    else:
        run = parse_run(path.read_bytes(), name=name, crs=crs)
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
    segments = cut(run, charge=run.voltage_v is None)
    if len(segments) == 0:
        raise RunsError(
            f"run {name} holds no segment of 1 m: did the robot move, and is its position recorded?",
            run=name,
            repairs=run.repairs,
            left_out=segments.left_out,
        )
    return {
        "name": name,
        "rows": len(run),
        "seconds": float(run.t[-1] - run.t[0]),
        "target": "charge_as" if run.voltage_v is None else "energy_j",
        "columns": sorted([*run.extras, *run.texts]),
        "segments": len(segments),
        "repairs": run.repairs,
        "left_out": segments.left_out,
        "bounds": [float(v) for v in (x.min(), y.min(), x.max(), y.max())],
        "odometry": None if odometry is None else asdict(odometry),
    }


def _cells(path: Path) -> int:
    """About how many cells a table has, without reading them; 0 where the reader will say that it is none."""
    with path.open("rb") as file:
        if file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC:
            return _parquet_cells(path)
        file.seek(0)
        return sum(part.count(b",") + part.count(b"\n") for part in iter(lambda: file.read(1 << 20), b""))


def _parquet_cells(path: Path) -> int:
    if find_spec("pyarrow") is None:
        return 0
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        about = pq.read_metadata(path)
    except (OSError, pa.ArrowInvalid):
        return 0
    return int(about.num_rows) * int(about.num_columns)
