"""All that is kept: rows in a database, and files in a data folder or an object store."""

from __future__ import annotations

from joulemap.service.storage.jobs import KeptDrives, KeptJobs
from joulemap.service.storage.sent import KeptSent


class Store(KeptSent, KeptJobs, KeptDrives):
    """Heightmaps, cost maps, runs, calibrations and drives that survive a restart; made as `Kept`."""
