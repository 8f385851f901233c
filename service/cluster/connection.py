"""The Dask cluster that does the work: one that this process starts, or the one at a scheduler's address.

Dask takes half a second to load: import this module where it is needed. Whether there are workers is asked of the
scheduler, because a client's own list of them is out of date.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import TYPE_CHECKING

import dask
from distributed import Client, LocalCluster, Security

from joulemap.model.errors import InputError

if TYPE_CHECKING:  # which takes half a second to load
    from distributed import Client


CONNECT_S = 10.0
"""Longest time until a scheduler answers [s]."""
_BLOCK_BYTES = 1 << 20
"""From this size on a block of a worker is mapped and given back; Dask's own setting maps blocks of 128 kB already."""
_CONFIG = {
    "distributed.scheduler.allowed-failures": 10,  # a task may lose its worker so often, through no fault of its own
    "distributed.scheduler.http.routes": [],  # no page, and nothing that tells about the work
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.limit": "1h",  # no warnings where Python is busy elsewhere
    "distributed.admin.tick.interval": "1s",  # of 20 ms, for these warnings: a tenth of a core while nothing is done
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.diagnostics.nvml": False,
    "distributed.nanny.pre-spawn-environ": {  # it is this process's for a while
        "DASK_LOGGING__DISTRIBUTED": "warning",
        "MALLOC_MMAP_THRESHOLD_": str(_BLOCK_BYTES),
    },
}
_ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def _kill(cluster: LocalCluster) -> None:
    """End the workers at once: what they are at is made again, and a tile is written whole or not at all."""
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)


def check_certificates(scheduler: str) -> None:
    """Refuse an address with TLS where Dask's configuration names no certificates."""
    if scheduler.startswith(("tls:", "wss:")) and not Security().get_connection_args("client").get("ssl_context"):
        raise InputError(
            f"{scheduler} wants certificates: name them with DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
            "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT and DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY",
            scheduler=scheduler,
        )


@asynccontextmanager
async def connected(scheduler: str | None, *, workers: int) -> AsyncIterator[Client]:
    """Connect to a cluster in the loop that runs.

    `scheduler`: its address, None for a cluster of this process's own, which ends with it.
    """
    for name in ("", ".scheduler", ".nanny", ".core", ".client"):
        logging.getLogger(f"distributed{name}").setLevel(logging.WARNING)
    with dask.config.set(_CONFIG):
        if scheduler is not None:
            check_certificates(scheduler)
            async with AsyncExitStack() as stack:
                client = Client(scheduler, asynchronous=True, timeout=CONNECT_S, set_as_default=False)
                stack.push_async_exit(client.__aexit__)
                async with asyncio.timeout(CONNECT_S):  # Dask's own limit is of each step, and not of all of them
                    await client
                yield client
            return
        security = Security.temporary()  # the ports are this process's alone: other users of the machine have no key
        async with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                protocol="tls",
                security=security,
                dashboard_address="127.0.0.1:0",
                worker_dashboard_address=None,
                memory_limit=0,
                env=_ONE_THREAD,
                asynchronous=True,
            ) as cluster,
            Client(cluster, asynchronous=True, set_as_default=False) as client,
        ):
            try:
                yield client
            finally:
                _kill(cluster)


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
