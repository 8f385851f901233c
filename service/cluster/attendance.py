"""Whether a cluster has workers, as its scheduler says it now: a client's own list of them is out of date."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # which takes half a second to load
    from distributed import Client

ANSWER_S = 5.0
"""Longest time until a scheduler says it [s]."""
ABSENT_S = 20.0
"""Workers that were there may be gone for so long [s]: one that was killed is there again within ten."""


class Attendance:
    """Looks whether workers are there; a short absence is no trouble.

    `scheduler`: its address, None where the workers are the service's own; `clock`: returns a time that only grows [s].
    """

    def __init__(self, client: Client, scheduler: str | None, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._client, self._scheduler, self._clock = client, scheduler, clock
        self._seen: float | None = None

    async def trouble(self) -> str | None:
        """Ask the scheduler.

        Result: what is wrong, in words; None where workers are there, or were within `ABSENT_S`.
        """
        whose = "the service's own scheduler" if self._scheduler is None else f"the scheduler at {self._scheduler}"
        try:
            there = await asyncio.wait_for(self._client.nthreads(), ANSWER_S)
        except OSError:  # a time limit, or a connection that ended
            found = f"{whose} does not answer within {ANSWER_S:g} s"
        else:
            if there:
                self._seen = self._clock()
                return None
            found = f"{whose} has no workers" + (
                ": they are started again"
                if self._scheduler is None
                else f": start one, `dask worker {self._scheduler}`"
            )
        recent = self._seen is not None and self._clock() - self._seen <= ABSENT_S
        return None if recent else found
