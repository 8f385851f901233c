"""Work on threads for requests: bounded, fair between cost maps, and ended when nobody waits for it any more."""

from __future__ import annotations

import asyncio
import contextvars
import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import numba

from joulemap.model.errors import BusyError
from joulemap.planner.grid.stopping import Flag, new_flag, stoppable

Result = TypeVar("Result")
Observe = Callable[[str, float, float], None]
"""Is told the name of the queue, and how long a piece of work waited and took [s]."""

_RECENT = 0.1
"""Weight of the latest piece of work in the mean time of one, from which Retry-After is estimated."""


@dataclass(eq=False)
class _Work:
    """A piece of work of one request."""

    group: str
    do: Callable[[], Any]
    answer: asyncio.Future[Any]
    context: contextvars.Context
    stop: Flag = field(default_factory=new_flag)
    asked: float = field(default_factory=time.monotonic)


class WorkQueue:
    """Threads that work for requests, in turn for each group (cost map) that has work.

    All its methods are called on one event loop, so it needs no lock. Work runs under a flag of `planner.stopping`:
    searches look at it, and it is set when the caller is cancelled. Work that waits then is never begun.
    """

    def __init__(
        self,
        name: str,
        *,
        threads: int,
        per_group: int,
        overall: int,
        share_cores: int = 1,
        one_at_a_time: Callable[[str], bool] = lambda _group: False,
        observe: Observe = lambda _name, _waited_s, _took_s: None,
    ) -> None:
        self.name, self.threads = name, threads
        self._per_group, self._overall = per_group, overall
        self._cores = min(share_cores, numba.get_num_threads())
        self._one_at_a_time, self._observe = one_at_a_time, observe
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=name)
        self._waiting: OrderedDict[str, deque[_Work]] = OrderedDict()  # the group whose turn it is comes first
        self._running: dict[_Work, None] = {}
        self._mean_s = 1.0
        self._stopped = False
        self.refused = self.given_up = 0

    @property
    def waiting(self) -> int:
        """Pieces of work that wait."""
        return sum(len(queue) for queue in self._waiting.values())

    @property
    def running(self) -> int:
        """Pieces of work that a thread does."""
        return len(self._running)

    async def do(self, group: str, work: Callable[[], Result]) -> Result:
        """Return the result of some work; if the caller is cancelled, the work ends or is never begun."""
        self._check_room(group)
        made = _Work(group, work, asyncio.get_running_loop().create_future(), contextvars.copy_context())
        self._waiting.setdefault(group, deque()).append(made)
        self._begin()
        try:
            answer: Result = await made.answer
        except asyncio.CancelledError:
            self.given_up += 1
            made.stop[0] = 1
            if made not in self._running:
                self._take_out(made)
            raise
        return answer

    def stop(self) -> None:
        """End all work; what waits gets a BusyError."""
        self._stopped = True
        for made in [work for queue in self._waiting.values() for work in queue]:
            self._take_out(made)
            if not made.answer.done():
                made.answer.set_exception(_stopping())
        for made in self._running:
            made.stop[0] = 1
        self._pool.shutdown(wait=False)

    def _check_room(self, group: str) -> None:
        if self._stopped:
            raise _stopping()
        here, all_ = len(self._waiting.get(group, ())), self.waiting
        if here < self._per_group and all_ < self._overall:
            return
        self.refused += 1
        where, count, limit = (
            ("this cost map", here, self._per_group) if here >= self._per_group else ("all", all_, self._overall)
        )
        raise BusyError(
            f"the queue is full: {self.name} of {where} that wait: {count}, limit: {limit}",
            waiting=count,
            limit=limit,
            retry_after_s=max(1, math.ceil(all_ * self._mean_s / self.threads)),
        )

    def _take_out(self, made: _Work) -> None:
        queue = self._waiting[made.group]
        queue.remove(made)
        if not queue:
            del self._waiting[made.group]

    def _begin(self) -> None:
        """Begin what may begin, one of each group in turn."""
        while len(self._running) < self.threads and not self._stopped:
            busy = {made.group for made in self._running}
            group = next((g for g in self._waiting if g not in busy or not self._one_at_a_time(g)), None)
            if group is None:
                return
            made = self._waiting[group][0]
            self._take_out(made)
            if group in self._waiting:
                self._waiting.move_to_end(group)
            self._running[made] = None
            waited_s = time.monotonic() - made.asked
            inner = max(1, self._cores // len(self._running))
            done = asyncio.get_running_loop().run_in_executor(self._pool, made.context.run, _done, made, inner)
            done.add_done_callback(partial(self._end, made, waited_s))

    def _end(self, made: _Work, waited_s: float, future: asyncio.Future[Any]) -> None:
        took_s = time.monotonic() - made.asked - waited_s
        del self._running[made]
        self._mean_s += _RECENT * (took_s - self._mean_s)
        self._observe(self.name, waited_s, took_s)
        error = future.exception()
        if not made.answer.done():
            if error is not None:
                made.answer.set_exception(_stopping() if made.stop[0] else error)
            else:
                made.answer.set_result(future.result())
        self._begin()


def _done(made: _Work, inner_threads: int) -> Any:
    """Do a piece of work on this thread."""
    numba.set_num_threads(inner_threads)  # of this thread only
    with stoppable(made.stop):
        return made.do()


def _stopping() -> BusyError:
    return BusyError("the service stops: ask again when it is back", retry_after_s=10)
