"""The queues of a service: one for all that searches or goes over a whole cost map, one for what only prices paths."""

from __future__ import annotations

import os

from joulemap.service.http.open_maps import OpenMaps
from joulemap.service.http.work_queue import Observe, WorkQueue
from joulemap.service.priority import LONG_NICE
from joulemap.service.settings import Settings

PLANS, PRICES = "plans", "prices"
_PRICE_THREADS = 4
"""More than cores: one may be loading its cost map."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def plan_queue(settings: Settings, maps: OpenMaps, observe: Observe) -> WorkQueue:
    """Return the queue of routes, tours, energy fields, pictures and files of cost maps."""
    return WorkQueue(
        PLANS,
        threads=settings.plan_threads or cores(),
        per_group=settings.plan_queue_size,
        overall=4 * settings.plan_queue_size,
        share_cores=cores(),
        nice=LONG_NICE,
        one_at_a_time=lambda costmap_id: not maps.is_open(costmap_id),
        observe=observe,
    )


def price_queue(settings: Settings, maps: OpenMaps, observe: Observe) -> WorkQueue:
    """Return the queue of questions that need no search: verdicts for given paths, prices at a place."""
    return WorkQueue(
        PRICES,
        threads=_PRICE_THREADS,
        per_group=settings.plan_queue_size,
        overall=4 * settings.plan_queue_size,
        one_at_a_time=lambda costmap_id: not maps.is_open(costmap_id),
        observe=observe,
    )
