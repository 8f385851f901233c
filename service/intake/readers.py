"""The processes that read what is sent: a few, kept for the next file, killed with their file, and replaced.

They are those of `anyio.to_process`, on which the web framework stands already. Each has a pipe of its own, so that the
end of one disturbs no other; a cancelled call kills its process; and all end with the event loop. Pebble and loky keep
threads and shared pipes besides, and loky has no limit for a single call.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import anyio
from anyio import to_process

from joulemap.model.errors import BusyError, InputError, JoulemapError, TooLargeError
from joulemap.service.intake import guard
from joulemap.service.intake.limits import ReadLimits

_RETRY_S = 5.0


class Readers:
    """Reads files in other processes, a few at a time.

    Parameters
    ----------
    processes : int
        Most at a time.
    queue : int
        Most files that wait.
    limits : ReadLimits
        Of each file.

    Attributes
    ----------
    refused : int
        Files that found the queue full.
    """

    def __init__(self, *, processes: int, queue: int, limits: ReadLimits) -> None:
        self._queue = queue
        self._limits = limits
        self._limiter = anyio.CapacityLimiter(processes)
        self.refused = 0

    @property
    def waiting(self) -> int:
        """Number of files that wait."""
        return self._limiter.statistics().tasks_waiting

    @property
    def running(self) -> int:
        """Number of files that are read now."""
        return self._limiter.statistics().borrowed_tokens

    async def read(self, task: str, **arguments: Any) -> dict[str, Any]:
        """Read one file; if the caller is cancelled, the process that reads it is killed.

        Parameters
        ----------
        task : str
            "heightmap" or "run".
        **arguments
            JSON-able, of the task's function; `name` is what messages call the file.

        Returns
        -------
        dict
            What the task's function returns.

        Raises
        ------
        JoulemapError
            What reading the file raises; InputError of some kind where the reader is confused by it.
        TooLargeError
            If it takes more time or memory than the limits.
        BusyError
            If too many files wait.
        """
        if self.waiting >= self._queue:
            self.refused += 1
            raise BusyError(
                f"{self._queue} sent files wait to be read already: send it again later",
                waiting=self._queue,
                limit=self._queue,
                retry_after_s=_RETRY_S,
            )
        text = json.dumps({**arguments, "limits": asdict(self._limits)})
        try:
            answer = await to_process.run_sync(guard.read, task, text, cancellable=True, limiter=self._limiter)
        except anyio.BrokenWorkerProcess as error:
            raise self._ended(str(arguments.get("name", "the file"))) from error
        found = json.loads(answer)
        if "error" in found:
            raise _error_of(**found["error"])
        result: dict[str, Any] = found["result"]
        return result

    def _ended(self, name: str) -> TooLargeError:
        limits = self._limits
        return TooLargeError(
            f"{name} could not be read within {limits.seconds:g} s of processor time (and 1 s for each 5 MB) and "
            f"{limits.memory_mb:g} MB of memory: it is corrupt, or much larger inside than outside",
            name=name,
            limit_s=limits.seconds,
            limit_mb=limits.memory_mb,
        )


def _error_of(code: str, message: str, context: dict[str, Any]) -> JoulemapError:
    """The error that a process told of."""
    kinds = [JoulemapError]
    for kind in kinds:
        kinds += kind.__subclasses__()
    return next((kind for kind in kinds if kind.code == code), InputError)(message, **context)
