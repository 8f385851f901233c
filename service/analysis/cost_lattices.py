"""Joins a predictor to a lattice: HTTP, jobs, command line and Python all make cost maps by this."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import TooLargeError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.windows import Ground
from joulemap.planner.figures import figures_of, joined_figures
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.build import DEFAULT_HEADINGS, build_lattice, knows_spread, write_lattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.service.models import DEFAULT_MODEL, find_predictor, planning_robot


def check_lattice(frame: GridFrame, *, spacing_m: float, headings: int, max_values: int | None = None) -> Tiling:
    """Return the tiles of the cost lattice over a heightmap, without building it."""
    tiling = Tiling.of(frame, spacing_m=spacing_m, headings=headings)
    if max_values is not None and tiling.values > max_values:
        raise TooLargeError(
            f"{tiling.frame.rows} x {tiling.frame.cols} cells at {headings} headings are {tiling.values:,} values, the "
            f"limit is {max_values:,}: choose a larger spacing than {spacing_m:g} m, or fewer headings",
            values=tiling.values,
            limit=max_values,
        )
    return tiling


def prepare_build(
    ground: Ground,
    robot: Robot,
    *,
    model: str | Path | Predictor = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    models_dir: Path | None = None,
) -> tuple[Robot, Predictor, Tiling]:
    """Return what a cost lattice is built from: the robot, the model and the tiles.

    Returns `robot`: with the energy of turning that the model learned, where it learned one; `predictor`: the model;
    `tiling`: the tiles of the lattice.
    """
    tiling = check_lattice(ground.frame, spacing_m=spacing_m, headings=headings)
    predictor = find_predictor(model, models_dir=models_dir) if isinstance(model, str | Path) else model
    return planning_robot(predictor, robot, ground), predictor, tiling


def load_kernels(model: str | Path, robot: Robot) -> None:
    """Load a model's modules and its compiled kernels, which needs no map: a caller may read the map meanwhile."""
    knows_spread(find_predictor(model), robot)


def make_cost_lattice(
    ground: Ground,
    robot: Robot,
    *,
    model: str | Path | Predictor = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    models_dir: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> CostLattice:
    """Return the cost lattice of a heightmap for a robot, in memory.

    Result: prices [J/m] and limits of every cell in every heading.
    """
    robot, predictor, _ = prepare_build(
        ground, robot, model=model, spacing_m=spacing_m, headings=headings, models_dir=models_dir
    )
    return build_lattice(ground, robot, predictor, spacing_m=spacing_m, headings=headings, progress=progress)


@dataclass(frozen=True)
class Written:
    """A cost lattice that was written to disk.

    Attributes
    ----------
    frame : GridFrame
        Where its cells lie.
    robot : Robot
        The robot that it was built for, with the energy of turning that the model learned.
    provenance : dict
        How it was made, JSON-able.
    figures : dict
        As `summarise` returns them.
    """

    frame: GridFrame
    robot: Robot
    provenance: dict[str, Any]
    figures: dict[str, Any]


def write_cost_lattice(
    path: Path,
    ground: Ground,
    robot: Robot,
    *,
    model: str | Path = DEFAULT_MODEL,
    spacing_m: float = 1.0,
    headings: int = DEFAULT_HEADINGS,
    progress: Callable[[float], None] | None = None,
) -> Written:
    """Write a cost lattice of any size into a folder, tile by tile.

    The lattice itself is never held in memory as a whole.
    """
    robot, predictor, tiling = prepare_build(ground, robot, model=model, spacing_m=spacing_m, headings=headings)
    parts: list[dict[str, Any]] = []
    provenance = write_lattice(
        path, ground, robot, predictor, tiling, each=lambda part: parts.append(figures_of(part)), progress=progress
    )
    return Written(tiling.frame, robot, provenance, joined_figures(parts))


def summarise(lattice: CostLattice) -> dict[str, Any]:
    """Return the figures that describe a lattice as a whole.

    Result: ``energy_per_m`` (min, mean and max [J/m], or None where nothing may be driven) and ``blocked`` (share of
    (cell, heading) pairs by reason).
    """
    return joined_figures([figures_of(lattice)])
