"""The maker of each kind of job, with the settings of a service or a worker."""

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
    """Return what does the steps of jobs, by kind of job.

    Parameters
    ----------
    store : Store
        Open.
    settings : Settings
        Limits, and the folder of trained models.
    on_done : callable, optional
        Is given the id and the planner of every cost map that is done.

    Returns
    -------
    dict of str to Maker
        By kind of job.
    """
    models_dir = settings.resolved_models_dir
    builder = Builder(store, models_dir=models_dir, max_values=settings.max_lattice_values, on_done=on_done)
    return {COSTMAP: builder, CALIBRATION: Calibrator(store, models_dir=models_dir)}
