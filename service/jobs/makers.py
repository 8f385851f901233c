"""Who makes what: the maker of each kind of job, with a service's or a worker's settings."""

from __future__ import annotations

from collections.abc import Callable

from joulemap.planner.plan import RoutePlanner
from joulemap.service.jobs.calibrations import Calibrator
from joulemap.service.jobs.costmaps import Builder
from joulemap.service.jobs.worker import Maker
from joulemap.service.settings import Settings
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CALIBRATION, COSTMAP


def make_makers(
    store: Store, settings: Settings, *, on_done: Callable[[str, RoutePlanner], None] | None = None
) -> dict[str, Maker]:
    """What does jobs with these settings, by kind."""
    models_dir = settings.resolved_models_dir
    builder = Builder(store, models_dir=models_dir, max_values=settings.max_lattice_values, on_done=on_done)
    return {COSTMAP: builder, CALIBRATION: Calibrator(store, models_dir=models_dir)}
