"""Checks measured runs that were sent, and says to the sender what was read, repaired and left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import InputError, RunsError, TooLargeError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.odometry import Odometry, cut_travel, read_odometry
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.parquet_table import PARQUET_MAGIC
from joulemap.service.storage.store import safe_name


@dataclass(frozen=True)
class RunLimits:
    """How large a measured run may be.

    Attributes
    ----------
    mb : float
        Size of its file [1e6 bytes].
    cells : int
        Rows times columns of its table.
    km : float
        Length that was driven [km].
    """

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
    """Read runs that were sent together and return what each of them contains.

    Parameters
    ----------
    files : sequence of (str, Path)
        Name and file of each.
    limits : RunLimits
        How large each may be.
    ground : mapping or None
        ``crs`` and ``bounds`` of the heightmap that they were driven on; None where it is not known.
    odometry : Odometry, optional
        How runs without positions are read.

    Returns
    -------
    list of dict
        As `read_sent_run` returns it.

    Raises
    ------
    TooLargeError
        If a run is larger than the limits.
    RunsError
        If a run cannot be read, contains no segment, or does not lie on the heightmap.
    InputError
        If two runs have the same name.
    """
    names = [safe_name(name) for name, _ in files]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two runs are called {twice[0]}: send them under different names", name=twice[0])
    found = []
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
        found.append(run)
    return found


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two boxes [west, south, east, north] touch."""
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _box(bounds: Sequence[float]) -> str:
    west, south, east, north = bounds
    return f"x {west:.0f}..{east:.0f}, y {south:.0f}..{north:.0f}"


def read_sent_run(
    path: Path, *, name: str, limits: RunLimits, crs: str | None = None, odometry: Odometry | None = None
) -> dict[str, Any]:
    """Read one run and return what it contains.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        What to call it in messages.
    limits : RunLimits
        How large it may be.
    crs : str, optional
        Coordinate system of the heightmap, for columns ``lat`` and ``lon``.
    odometry : Odometry, optional
        How a run without positions is read.

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


def _cells(path: Path) -> int:
    """Estimate of a table's cells, without parsing it; 0 where it is no table, which the reader will report."""
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
