"""Predictor + ground -> cost lattice, tile by tile: into memory, or tile after tile into a folder."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import TooLargeError
from joulemap.model.frames import GridFrame, heading_bins, heading_vector
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers import Layers
from joulemap.model.terrain.windows import Ground, overview
from joulemap.model.traction import TractionSource
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.planner.lattice.limits import ground_limits, noise_warnings, size_warnings
from joulemap.planner.lattice.obstacles import Obstacles, squares_per_cell
from joulemap.planner.lattice.steps import shows_obstacles
from joulemap.planner.lattice.survey_error import with_survey_error
from joulemap.planner.lattice.tiles import MODEL_REACH_M, Tiling, ground_of

DEFAULT_HEADINGS = 16
MAX_LATTICE_VALUES = 400_000_000
"""Largest rows * cols * headings held in memory (1.6 GB of float32); a folder may hold any number."""


def build_tile(
    ground: Ground, robot: Robot, source: TractionSource, tiling: Tiling, rows: slice, cols: slice
) -> CostLattice:
    """Build the lattice of some of the tiling's cells, equal to that part of the whole lattice to float32 rounding.

    Memory is bounded by the cells and the heights around them.

    `source`: the model that predicts traction [J/m]. Result: the cells; its provenance is empty, see `provenance_of`.
    """
    frame = tiling.frame.window(rows.start, rows.stop, cols.start, cols.stop)
    heights = ground_of(ground, frame, robot)
    elevation, gradient, blocked, obstacles, beside = ground_limits(heights, frame, robot)
    traction, std = source.traction_and_std(heights, robot, frame, heading_bins(tiling.headings))
    if beside.any():
        _price_beside_obstacles(traction, std, beside, gradient, robot, source, heights.resolution_m)
    if heights.layers:
        traction, std = _on_layers(traction, std, heights.layers, robot, source, frame)
    silent = np.isnan(traction).any(axis=2) & ((blocked == Blocked.FREE) | (blocked == Blocked.OBSTACLE))
    blocked[silent] = Blocked.UNKNOWN
    return CostLattice(frame, robot, traction, elevation, gradient, blocked, {}, std, obstacles=obstacles)


def _on_layers(
    traction: NDArray[np.float32],
    std: NDArray[np.float32] | None,
    layers: Layers,
    robot: Robot,
    source: TractionSource,
    frame: GridFrame,
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Prices with factors and costs of layers, and their uncertainty with that of kinds that nobody measured."""
    x, y = frame.centres()
    places = x[None, :, None], y[:, None, None]
    if std is not None:
        learned: frozenset[str] = getattr(source, "learned_kinds", frozenset())
        std = np.hypot(std, layers.std_of_kinds(traction, robot, *places, learned)).astype(np.float32)
    return layers.priced(traction, *places, heading_bins(traction.shape[2])).astype(np.float32, copy=False), std


def _price_beside_obstacles(
    traction: NDArray[np.float32],
    std: NDArray[np.float32] | None,
    beside: NDArray[np.bool_],
    gradient: NDArray[np.float32],
    robot: Robot,
    source: TractionSource,
    resolution_m: float,
) -> None:
    """Price cells as level ground and the climb of their plane: a model that read a wall would take it for a slope."""
    headings = heading_bins(traction.shape[2])
    pixels = math.ceil(2.0 * MODEL_REACH_M / resolution_m) + 9
    frame = GridFrame(0.0, pixels * resolution_m, resolution_m, pixels, pixels)
    middle = frame.window(pixels // 2, pixels // 2 + 1, pixels // 2, pixels // 2 + 1)
    level, level_std = source.traction_and_std(
        Heightmap(np.zeros(frame.shape, dtype=np.float32), frame), robot, middle, headings
    )
    east, north = heading_vector(headings)
    climb = gradient[beside, :1] * east + gradient[beside, 1:] * north  # (cells, K)
    traction[beside] = level[0, 0] + robot.weight_n * climb
    if std is not None and level_std is not None:
        std[beside] = level_std[0, 0]


def provenance_of(ground: Ground, robot: Robot, source: TractionSource, tiling: Tiling) -> dict[str, Any]:
    """Return how a lattice is made, with every warning about the map and the robot.

    Result: JSON-able: version and time, heightmap, model, `spacing_m`, `headings`, `warnings`.
    """
    model, doubts = with_survey_error(source.provenance(), ground, robot, source)
    return {
        "joulemap": version("joulemap"),
        "made_at": dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
        "heightmap": {
            "hash": ground.data_hash,
            "source": ground.source,
            "resolution_m": ground.frame.resolution_m,
            "known_share": ground.known_share,
            "noise_m": ground.noise.noise_m,
            "noise_length_m": ground.noise.length_m,
        },
        "model": model,
        "spacing_m": tiling.frame.resolution_m,
        "headings": tiling.headings,
        "warnings": [
            *source.warnings(overview(ground), robot),
            *noise_warnings(ground.noise.noise_m, robot),
            *doubts,
            *size_warnings(ground.frame, robot),
            *ground.layers.warnings(ground.frame),
        ],
        **({"layers": ground.layers.as_list()} if ground.layers else {}),
    }


def build_lattice(
    ground: Ground,
    robot: Robot,
    source: TractionSource,
    *,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    tile_cells: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> CostLattice:
    """Build the cost lattice of a whole heightmap in memory.

    `source`: the model that predicts traction [J/m]; `tile_cells`: side of a tile [cells], chosen from the heightmap's
    resolution where None.
    """
    tiling = Tiling.of(ground.frame, spacing_m=spacing_m, headings=headings, side=tile_cells)
    frame = tiling.frame
    if tiling.values > MAX_LATTICE_VALUES:
        raise TooLargeError(
            f"{frame.rows} x {frame.cols} cells at {headings} headings are {tiling.values:,} values, the limit is "
            f"{MAX_LATTICE_VALUES:,} in memory: choose a larger spacing than {spacing_m:g} m, or write the map "
            "to a folder with the command `joulemap costmap`",
            values=tiling.values,
            limit=MAX_LATTICE_VALUES,
        )
    traction = np.empty((*frame.shape, headings), dtype=np.float32)
    elevation = np.empty(frame.shape, dtype=np.float32)
    gradient = np.empty((*frame.shape, 2), dtype=np.float32)
    blocked = np.empty(frame.shape, dtype=np.uint8)
    std: NDArray[np.float32] | None = None
    obstacles: Obstacles | None = None
    for number, place in enumerate(tiling):
        part = build_tile(ground, robot, source, tiling, *place)
        traction[place], elevation[place] = part.traction_per_m, part.elevation_m
        gradient[place], blocked[place] = part.gradient, part.blocked
        if part.std_j is not None:
            std = np.empty_like(traction) if std is None else std
            std[place] = part.std_j
        if part.obstacles is not None:
            obstacles = Obstacles.none(frame, part.obstacles.per_cell) if obstacles is None else obstacles
            obstacles.place(part.obstacles, *place)
        if progress is not None:
            progress((number + 1) / len(tiling))
    provenance = provenance_of(ground, robot, source, tiling)
    return CostLattice(frame, robot, traction, elevation, gradient, blocked, provenance, std, obstacles=obstacles)


def write_lattice(
    path: str | Path,
    ground: Ground,
    robot: Robot,
    source: TractionSource,
    tiling: Tiling,
    *,
    each: Callable[[CostLattice], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Write a lattice of any size to a folder, whole or not at all, holding two tiles in memory at a time.

    Cut off by an exception, Ctrl-C included, it leaves nothing behind.

    `source`: the model that predicts traction [J/m]. Result: the lattice's provenance, see `provenance_of`.
    """
    folder = LatticeFolder(path)
    # an interruption reaches this thread and not the one that writes: what zarr has begun ends before all is removed
    with folder.whole_or_nothing(), ThreadPoolExecutor(1) as writer:
        try:
            with_std, squares = knows_spread(source, robot), squares_of(tiling, ground, robot)
            lay_out = partial(folder.lay_out, tiling, robot, with_std=with_std, squares=squares)
            writing: Future[None] = writer.submit(lay_out)
            described = writer.submit(provenance_of, ground, robot, source, tiling)
            for number, place in enumerate(tiling):
                part = build_tile(ground, robot, source, tiling, *place)
                writing.result()
                writing = writer.submit(folder.write, part, *place)
                if each is not None:
                    each(part)
                if progress is not None:
                    progress((number + 1) / len(tiling))
            writing.result()
            provenance = described.result()
            writer.submit(folder.finish, provenance).result()
        except BaseException:
            writer.shutdown(cancel_futures=True)
            raise
    return provenance


def squares_of(tiling: Tiling, ground: Ground, robot: Robot) -> int:
    """Return into how many squares cells are cut for obstacles; 0 on a map that is too coarse to show any."""
    resolution_m = ground.frame.resolution_m
    if not (shows_obstacles(resolution_m, robot) or ground.layers.closing):
        return 0
    return squares_per_cell(tiling.frame.resolution_m, min(resolution_m, ground.layers.finest_m))


def knows_spread(source: TractionSource, robot: Robot) -> bool:
    """Return whether a model gives the standard deviation of its predictions, asked on a little flat ground."""
    flat = Heightmap(np.zeros((8, 8), dtype=np.float32), GridFrame(0.0, 8.0, 1.0, 8, 8))
    cell = flat.frame.window(3, 5, 3, 5)
    return source.traction_and_std(flat, robot, cell, heading_bins(4))[1] is not None
