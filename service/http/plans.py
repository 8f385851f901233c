"""The queues of a service: one for all that searches or goes over a whole cost map, one for what only prices paths."""

from __future__ import annotations

import os
from typing import Any

from joulemap.service.hosting.priority import LONG_NICE
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.http.work_queue import Observe, WorkQueue

_PRICE_THREADS = 4
"""More than cores: one may be loading its cost map."""


def queues(settings: Settings, maps: OpenMaps, observe: Observe) -> list[WorkQueue]:
    """Return the queue of plans: routes, tours, energy fields, pictures, files of cost maps; and that of prices.

    Prices are questions that need no search: verdicts for given paths, prices at a place.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    how: dict[str, Any] = {
        "per_group": settings.plan_queue_size,
        "overall": 4 * settings.plan_queue_size,
        "one_at_a_time": lambda costmap_id: not maps.is_open(costmap_id),
        "observe": observe,
    }
    plans = WorkQueue("plans", threads=settings.plan_threads or cores, share_cores=cores, nice=LONG_NICE, **how)
    return [plans, WorkQueue("prices", threads=_PRICE_THREADS, **how)]
