"""All that is kept: rows in a database, and files in a data folder or an object store."""

from __future__ import annotations

from joulemap.service.storage.calibrations import KeptCalibrations
from joulemap.service.storage.costmaps import KeptCostmaps
from joulemap.service.storage.drives import KeptDrives
from joulemap.service.storage.heightmaps import KeptHeightmaps
from joulemap.service.storage.runs import KeptRuns


class Store(KeptHeightmaps, KeptRuns, KeptCostmaps, KeptCalibrations, KeptDrives):
    """Heightmaps, cost maps, runs, calibrations and drives that survive a restart; made as `Kept`."""
