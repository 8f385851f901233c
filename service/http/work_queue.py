"""Work on threads for requests: bounded, fair between owners and cost maps, ended when nobody waits for it any more.

A service has two queues: one for all that searches or goes over a whole cost map, one for what only prices paths.
"""

from __future__ import annotations

import asyncio
import contextvars
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numba

from joulemap.model.errors import BusyError
from joulemap.planner.grid.stopping import Flag, new_flag, stoppable
from joulemap.service.hosting.fair_slots import FairSlots, Owner, Slot
from joulemap.service.hosting.settings import Settings
from joulemap.service.hosting.system import LONG_NICE, be_nice
from joulemap.service.http.open_maps import OpenMaps

Result = TypeVar("Result")
Observe = Callable[[str, float, float], None]
"""Is told the name of the queue, and how long a piece of work waited and took [s]."""


class WorkQueue:
    """Threads that work for requests, in turn for each owner, and of an owner for each group (cost map) that has work.

    All its methods are called on one event loop, so it needs no lock. Work runs under a flag of `planner.stopping`:
    searches look at it, and it is set when the caller is cancelled. Work that waits then is never begun.
    As many threads again are for owners that have no work on a thread, see `FairSlots`.
    """

    def __init__(
        self,
        name: str,
        *,
        threads: int,
        per_group: int,
        overall: int,
        share_cores: int = 1,
        nice: int = 0,
        one_at_a_time: Callable[[str], bool] = lambda _group: False,
        observe: Observe = lambda _name, _waited_s, _took_s: None,
    ) -> None:
        self.name, self.threads = name, threads
        self._cores = min(share_cores, numba.get_num_threads())
        self._observe = observe
        self._slots = FairSlots(
            name, slots=threads, extra=threads, overall=overall, per_group=per_group, one_at_a_time=one_at_a_time
        )
        self._pool = ThreadPoolExecutor(2 * threads, name, initializer=be_nice, initargs=(nice,))
        self._flags: dict[Slot, Flag] = {}
        self._stopped = False
        self.given_up = 0

    @property
    def waiting(self) -> int:
        """Pieces of work that wait."""
        return self._slots.waiting

    @property
    def running(self) -> int:
        """Pieces of work that a thread does."""
        return len(self._slots.taken)

    @property
    def refused(self) -> int:
        """Pieces of work for which there was no room."""
        return self._slots.refused

    def of(self, owner: Owner) -> OwnWork:
        """Return the queue as one owner has it."""
        return OwnWork(self, owner)

    async def do(self, group: str, work: Callable[[], Result], owner: Owner = None) -> Result:
        """Return the result of some work; if the caller is cancelled, the work ends or is never begun."""
        if self._stopped:
            raise _stopping()
        try:
            slot = await self._slots.take(owner, group)
        except asyncio.CancelledError:
            self.given_up += 1
            raise
        if self._stopped:
            self._slots.give_back(slot)
            raise _stopping()
        flag = self._flags[slot] = new_flag()
        inner = max(1, self._cores // self.running)
        run = contextvars.copy_context().run
        future = asyncio.get_running_loop().run_in_executor(self._pool, run, _done, flag, work, inner)
        future.add_done_callback(partial(self._end, slot))
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            self.given_up += 1
            flag[0] = 1
            raise
        except Exception:
            if flag[0]:
                raise _stopping() from None
            raise

    def stop(self) -> None:
        """End all work; what waits gets a BusyError."""
        self._stopped = True
        self._slots.refuse_all(_stopping)
        for flag in self._flags.values():
            flag[0] = 1
        self._pool.shutdown(wait=False)

    def _end(self, slot: Slot, future: asyncio.Future[Any]) -> None:
        future.exception()  # where nobody waits for it any more
        del self._flags[slot]
        self._observe(self.name, slot.waited_s, self._slots.give_back(slot))


@dataclass(frozen=True)
class OwnWork:
    """A queue as one owner has it."""

    queue: WorkQueue
    owner: Owner

    async def do(self, group: str, work: Callable[[], Result]) -> Result:
        """Return the result of some work, in the owner's turn."""
        return await self.queue.do(group, work, self.owner)


def _done(flag: Flag, work: Callable[[], Result], inner_threads: int) -> Result:
    """Do a piece of work on this thread."""
    numba.set_num_threads(inner_threads)  # of this thread only
    with stoppable(flag):
        return work()


def _stopping() -> BusyError:
    return BusyError("the service stops: ask again when it is back", retry_after_s=10)


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
