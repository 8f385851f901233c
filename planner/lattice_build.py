"""Predictor + heightmap -> cost lattice, strip by strip."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from model.errors import InputError, TooLargeError
from model.frames import heading_bins
from model.robot import Robot
from model.terrain.heightmap import Heightmap
from model.traction import TractionSource
from planner.lattice import Blocked, CostLattice
from planner.limits import ground_limits

DEFAULT_HEADINGS = 16
MAX_LATTICE_VALUES = 400_000_000
"""Largest rows * cols * headings held in memory (1.6 GB of float32)."""


def build_lattice(
    heightmap: Heightmap,
    robot: Robot,
    source: TractionSource,
    *,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    strip_rows: int = 128,
    progress: Callable[[float], None] | None = None,
) -> CostLattice:
    """The cost lattice of a whole heightmap.

    spacing_m : side of a cell [m]; headings : number of bins (4 to 360); strip_rows : cells per strip, which bounds the
    memory of the predictor. Raises InputError on a bad setting, TooLargeError above `MAX_LATTICE_VALUES`.
    """
    if not 4 <= headings <= 360:
        raise InputError(f"headings must lie in 4..360, got {headings}", headings=headings, limit=[4, 360])
    frame = heightmap.frame.respaced(spacing_m)
    values = frame.rows * frame.cols * headings
    if values > MAX_LATTICE_VALUES:
        raise TooLargeError(
            f"{frame.rows} x {frame.cols} cells at {headings} headings are {values:,} values, the limit is "
            f"{MAX_LATTICE_VALUES:,}: choose a larger spacing than {spacing_m:g} m",
            values=values, limit=MAX_LATTICE_VALUES,
        )  # fmt: skip
    angles = heading_bins(headings)
    traction = np.empty((*frame.shape, headings), dtype=np.float32)
    elevation = np.empty(frame.shape, dtype=np.float32)
    gradient = np.empty((*frame.shape, 2), dtype=np.float32)
    blocked = np.empty(frame.shape, dtype=np.uint8)
    std: NDArray[np.float32] | None = None
    for row0 in range(0, frame.rows, strip_rows):
        strip = slice(row0, min(row0 + strip_rows, frame.rows))
        window = frame.window(strip.start, strip.stop)
        elevation[strip], gradient[strip], blocked[strip] = ground_limits(heightmap, window, robot)
        traction[strip], strip_std = source.traction_and_std(heightmap, robot, window, angles)
        if strip_std is not None:
            std = np.empty_like(traction) if std is None else std
            std[strip] = strip_std
        silent = np.isnan(traction[strip]).any(axis=2) & (blocked[strip] == Blocked.FREE)
        blocked[strip][silent] = Blocked.UNKNOWN
        if progress is not None:
            progress(strip.stop / frame.rows)
    provenance = {
        "joulemap": version("joulemap"),
        "made_at": dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
        "heightmap": {
            "hash": heightmap.data_hash,
            "source": heightmap.source,
            "resolution_m": heightmap.resolution_m,
            "known_share": heightmap.known_share,
        },
        "model": source.provenance(),
        "spacing_m": spacing_m,
        "headings": headings,
        "warnings": source.warnings(heightmap, robot),
    }
    return CostLattice(frame, robot, traction, elevation, gradient, blocked, provenance, std)
