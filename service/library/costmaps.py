"""The cost map of a Python user: made of a heightmap, or opened from a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.errors import InputError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.on_disk.tiled_table import DEFAULT_MEMORY
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.service.analysis.cost_lattices import make_cost_lattice
from joulemap.service.library.costmap_areas import AreaQuestions
from joulemap.service.library.costmap_output import CostMapOutput
from joulemap.service.library.costmap_routes import RouteQuestions
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.questions.asking import asks
from joulemap.service.questions.costmap import CostmapCells

if TYPE_CHECKING:
    from joulemap.service.library.heightmaps import GroundLike, RobotLike
    from joulemap.service.library.models import ModelLike


class CostMap(RouteQuestions, AreaQuestions, CostMapOutput):
    """What driving costs at every place and in every direction, for one robot on one heightmap.

    Attributes
    ----------
    lattice : CostLattice
        The prices, limits and heights, for the functions of `joulemap.planner`.
    """


@asks(CostmapCells, complete=False)
def costmap(
    ground: GroundLike,
    robot: RobotLike = None,
    *,
    model: ModelLike = DEFAULT_MODEL,
    wanted: dict[str, Any],
    progress: Callable[[float], None] | None = None,
) -> CostMap:
    """Make the cost map of a heightmap for a robot.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap, or its file.
    model : str, Path, Model, callable or object with `predict`, optional
        "default" (the shipped network), "physics", the folder of a trained or calibrated model, or what `train` and
        `calibrate` return. Or a model of your own, which answers traction [J/m] without idle power: a function of the
        slope along, the slope across (rise over run), the roughness [m] and the speed [m/s], arrays (n,); or an object
        whose `predict` takes heights, (n, 32, 32) [m], of the metre ahead and headings, (n,) [rad].

    Returns
    -------
    CostMap
        In memory. For maps that do not fit there is the command `joulemap costmap`, which writes tile by tile.

    Raises
    ------
    HeightmapError, RobotError, ModelError
        If a file cannot be used.
    TooLargeError
        If the map would not fit into memory.

    Examples
    --------
    >>> import numpy as np, joulemap as jm
    >>> slope = np.tile(np.linspace(0.0, 3.0, 60), (40, 1))
    >>> costs = jm.costmap(jm.heightmap(slope, resolution_m=0.5), model="physics")
    >>> costs.plan((3.0, 10.0), (27.0, 10.0)).energy_j > costs.plan((27.0, 10.0), (3.0, 10.0)).energy_j
    True
    >>> mine = lambda along, across, roughness, speed: 30.0 + 400.0 * along + 900.0 * roughness
    >>> jm.costmap(jm.heightmap(slope, resolution_m=0.5), model=mine).plan((3.0, 10.0), (27.0, 10.0)).length_m
    24.0
    """
    # readers load slowly, and a cost map that is there already needs none
    from joulemap.service.library.heightmaps import ground_of, robot_of
    from joulemap.service.library.models import predictor_of

    how = {**wanted, "model": predictor_of(model), "progress": progress}
    return CostMap(make_cost_lattice(ground_of(ground), robot_of(robot), **how))


class StoredCostMap(CostMap):
    """A cost map that stays on disk and may be larger than memory: routes and verdicts, within a given memory.

    What needs all of its cells at once (tours, pictures, exports) is refused.

    Parameters
    ----------
    path : str or Path
        Its folder, usually NAME.zarr.
    memory_gb : float, optional
        Most memory of a search [GB].

    Attributes
    ----------
    lattice : CostLattice
        What was read for the questions so far; blocked as unknown elsewhere.
    """

    def __init__(self, path: str | Path, *, memory_gb: float = DEFAULT_MEMORY / 1e9) -> None:
        if not memory_gb > 0.0:
            raise InputError(f"`memory_gb` is {memory_gb}: give a positive number of gigabytes", memory_gb=memory_gb)
        self._memory_gb = memory_gb
        self.stored = StoredPlanner(path, memory_bytes=int(memory_gb * 1e9))

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the folder again: an open one is no part of a copy."""
        return _opened, (str(self.stored.stored.path), self._memory_gb)

    @property
    def lattice(self) -> CostLattice:  # type: ignore[override]
        """What was read for the questions so far; blocked as unknown elsewhere."""
        return self.stored.lattice

    @property
    def planner(self) -> StoredPlanner:
        """The planner of this map."""
        return self.stored

    @property
    def _whole(self) -> CostLattice:
        raise InputError("this needs the whole cost map in memory: open it without `memory_gb`")

    def _rows(self) -> dict[str, str]:
        west, south, east, north = self.bounds
        return {
            "area": f"x {west:.1f} to {east:.1f}, y {south:.1f} to {north:.1f} m, {self.crs or 'CRS not known'}",
            "robot": f"{self.robot.name}, {self.robot.mass_kg:g} kg, {self.robot.speed_mps:g} m/s",
            "folder": str(self.stored.stored.path),
        }


def _opened(path: str, memory_gb: float) -> StoredCostMap:
    return StoredCostMap(path, memory_gb=memory_gb)


def open_costmap(path: str | Path, *, memory_gb: float | None = None) -> CostMap:
    """Open a cost map that `CostMap.save` or the command `joulemap costmap` wrote.

    Parameters
    ----------
    path : str or Path
        Its folder, usually NAME.zarr.
    memory_gb : float, optional
        Plan on the map from disk, within so much memory [GB]; it may be of any size then. By default it is read as a
        whole.

    Returns
    -------
    CostMap
        The same to the bit; a `StoredCostMap` where `memory_gb` is given.

    Raises
    ------
    InputError
        If the folder is no cost map.
    NotFoundError
        If there is no such folder.
    """
    return CostMap(load_lattice(path)) if memory_gb is None else StoredCostMap(path, memory_gb=memory_gb)
