"""joulemap: what driving costs a ground robot on uneven terrain, which way takes least energy, and whether the battery
lasts.

    import joulemap as jm

    hill = jm.read_heightmap("hill.tif")
    costmap = jm.costmap(hill, robot="rover.toml")
    route = costmap.plan((366990, 4064310), (367128, 4064400))
    print(route)
    print(costmap.feasibility(route, charge=0.6))

Names are loaded when they are first used: importing joulemap loads neither torch nor numba nor OMPL.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Where colorama is installed numba exchanges sys.stdout while it colours an error, in whatever thread compiles.
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

if TYPE_CHECKING:
    from joulemap.model.battery import Battery
    from joulemap.model.errors import JoulemapError
    from joulemap.model.robot import Robot
    from joulemap.model.terrain.heightmap import Heightmap
    from joulemap.planner.areas.energy_map import EnergyMap
    from joulemap.service.client import Client
    from joulemap.service.library.calibrations import CalibrationResult, calibrate
    from joulemap.service.library.comparison import compare
    from joulemap.service.library.costmaps import CostMap, StoredCostMap, costmap, open_costmap
    from joulemap.service.library.drive import Drive
    from joulemap.service.library.feasibility import Feasibility
    from joulemap.service.library.heightmaps import heightmap, heightmap_from_runs, read_heightmap
    from joulemap.service.library.layers import with_layers
    from joulemap.service.library.models import Evaluation, Model, evaluate, train
    from joulemap.service.library.planned import PlannedRoute, PlannedTour
    from joulemap.service.library.run_files import Runs, read_runs

__all__ = [
    "Battery",
    "CalibrationResult",
    "Client",
    "CostMap",
    "Drive",
    "EnergyMap",
    "Evaluation",
    "Feasibility",
    "Heightmap",
    "JoulemapError",
    "Model",
    "PlannedRoute",
    "PlannedTour",
    "Robot",
    "Runs",
    "StoredCostMap",
    "calibrate",
    "compare",
    "costmap",
    "evaluate",
    "heightmap",
    "heightmap_from_runs",
    "open_costmap",
    "read_heightmap",
    "read_runs",
    "train",
    "with_layers",
]

_HOMES = {
    "joulemap.model.errors": ("JoulemapError",),
    "joulemap.model.battery": ("Battery",),
    "joulemap.model.robot": ("Robot",),
    "joulemap.model.terrain.heightmap": ("Heightmap",),
    "joulemap.planner.areas.energy_map": ("EnergyMap",),
    "joulemap.service.client": ("Client",),
    "joulemap.service.library.calibrations": ("CalibrationResult", "calibrate"),
    "joulemap.service.library.comparison": ("compare",),
    "joulemap.service.library.costmaps": ("CostMap", "StoredCostMap", "costmap", "open_costmap"),
    "joulemap.service.library.feasibility": ("Feasibility",),
    "joulemap.service.library.heightmaps": ("heightmap", "heightmap_from_runs", "read_heightmap"),
    "joulemap.service.library.layers": ("with_layers",),
    "joulemap.service.library.models": ("Evaluation", "Model", "evaluate", "train"),
    "joulemap.service.library.drive": ("Drive",),
    "joulemap.service.library.planned": ("PlannedRoute", "PlannedTour"),
    "joulemap.service.library.run_files": ("Runs", "read_runs"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("joulemap")
    if name in ("model", "planner", "service"):
        return import_module(f"joulemap.{name}")
    for home, names in _HOMES.items():
        if name in names:
            value = globals()[name] = getattr(import_module(home), name)
            return value
    raise AttributeError(f"module 'joulemap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
