"""The processes that read what is sent: a few at a time, each for one file, killed with it.

They are forks of a template, see there. Workers that are kept, as those of `anyio.to_process`, Pebble and loky, are
loaded again after each file that ends one and after a quiet time, which takes seconds of a request. The fork server of
`multiprocessing` imports the main module of the service into every fork.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import anyio

from joulemap.model.errors import BusyError, TooLargeError, error_of
from joulemap.service.hosting.fair_slots import FairSlots, Owner
from joulemap.service.intake.limits import ReadLimits

_RETRY_S = 5.0
_LOG = logging.getLogger("joulemap.service")
_BEGUN = b"\n"  # as the template says it
_TRIES = 2  # a template may have been killed
_ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class Readers:
    """Reads files in other processes, a few at a time; `close` it at the end.

    `scratch`: returns the folder for what they write, which is emptied at the next start.
    """

    def __init__(
        self, *, processes: int, queue: int, limits: ReadLimits, scratch: Callable[[], Path | None] = lambda: None
    ) -> None:
        self._limits, self._scratch = limits, scratch
        self._slots = FairSlots("sent files", slots=processes, overall=queue)
        self._template: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None
        self._starting = threading.Lock()

    def start(self) -> None:
        """Begin to load the template, so that the first file does not wait for it."""
        self._current()

    def close(self) -> None:
        """End the template; the files in hand end with their requests."""
        with self._starting:
            self._end()

    def _current(self, broken: subprocess.Popen[bytes] | None = None) -> tuple[subprocess.Popen[bytes], socket.socket]:
        """The template and the socket that brings it files; a new one where there is none, or where it is broken."""
        with self._starting:
            if self._template is not None and (self._template is broken or self._template.poll() is not None):
                self._end()
            if self._template is None or self._control is None:
                self._control, theirs = socket.socketpair()
                with theirs:
                    self._template = subprocess.Popen(
                        [sys.executable, "-m", "joulemap.service.intake.template", str(theirs.fileno())],
                        pass_fds=[theirs.fileno()],
                        stdin=subprocess.DEVNULL,
                        env=os.environ | dict.fromkeys(_ONE_THREAD, "1"),
                    )
            return self._template, self._control

    def _end(self) -> None:
        if self._control is not None:
            self._control.close()
        if self._template is not None:
            self._template.kill()  # it may still be loading, and holds nothing
            self._template.wait()
        self._template = self._control = None

    @property
    def waiting(self) -> int:
        """Number of files that wait."""
        return self._slots.waiting

    @property
    def running(self) -> int:
        """Number of files that are read now."""
        return len(self._slots.taken)

    @property
    def refused(self) -> int:
        """Number of files that found no room to wait."""
        return self._slots.refused

    async def read(self, task: str, *, owner: Owner = None, **arguments: Any) -> dict[str, Any]:
        """Read one file in its owner's turn; if the caller is cancelled, the process that reads it is killed."""
        slot = await self._slots.take(owner)
        try:
            with tempfile.TemporaryDirectory(prefix="joulemap-", dir=self._scratch()) as scratch:
                given = json.dumps({**arguments, "limits": asdict(self._limits), "scratch": scratch})
                answer = await self._answer(json.dumps({"task": task, "arguments": given}).encode())
        finally:
            self._slots.give_back(slot)
        if answer == _BEGUN:
            raise self._ended(str(arguments.get("name", "the file")))
        try:
            found = json.loads(answer)
        except ValueError as error:  # it was killed as it answered
            raise _gone() from error
        if "os_error" in found:
            raise OSError(*found["os_error"])
        if "error" in found:
            raise error_of(**found["error"])
        result: dict[str, Any] = found["result"]
        return result

    async def _answer(self, asked: bytes) -> bytes:
        """What the fork for a file says; `_BEGUN` alone where it was ended."""
        broken = None
        for _ in range(_TRIES):
            try:
                template, control = await anyio.to_thread.run_sync(self._current, broken)
            except OSError as error:  # no process or no memory is left for it
                raise _gone() from error
            said = await _forked(control, asked)
            if said:
                return said
            broken = template
        _LOG.error("the process that reads files ended %d times one after another", _TRIES)
        raise _gone()

    def _ended(self, name: str) -> TooLargeError:
        limits = self._limits
        return TooLargeError(
            f"{name} could not be read within {limits.seconds:g} s of processor time (and 1 s for each 5 MB) and "
            f"{limits.memory_mb:g} MB of memory: it is corrupt, or much larger inside than outside",
            name=name,
            limit_s=limits.seconds,
            limit_mb=limits.memory_mb,
        )


def _gone() -> BusyError:
    return BusyError("the process that reads sent files was ended: send the file again", retry_after_s=_RETRY_S)


async def _forked(control: socket.socket, asked: bytes) -> bytes:
    """What a fork of the template answers; nothing where the template is gone. The fork ends with this call."""
    ours, theirs = socket.socketpair()
    with theirs, suppress(OSError):  # also one that another request has closed by now
        socket.send_fds(control, [b"f"], [theirs.fileno()])
    stream, writer = await asyncio.open_unix_connection(sock=ours)
    try:
        with suppress(BrokenPipeError, ConnectionResetError):
            writer.write(asked)
            writer.write_eof()
            return await stream.read()
        return b""
    finally:
        writer.transport.abort()
