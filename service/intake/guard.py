"""What a child process does: it reads one file within limits that the system enforces, and answers in JSON.

A process that exceeds its time is ended by the system, which needs no help of the code that hangs. Memory beyond the
limit is refused by the system, and what was asked for it raises MemoryError.
"""

from __future__ import annotations

import json
import logging
import math
import resource
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from joulemap.model.errors import HeightmapError, InputError, JoulemapError, TooLargeError
from joulemap.service.intake.limits import ReadLimits

_LOG = logging.getLogger("joulemap.service")
_CELLS_PER_S = 1e7  # a heightmap is compressed at twice this speed


@cache
def prepared(task: str) -> Callable[..., dict[str, Any]]:
    """Return the function of a task, once all is loaded that it needs, so that no file pays for it."""
    if task == "heightmap":
        from joulemap.service.intake import maps

        maps.load_gdal()
        return maps.read_map
    if task == "trial":
        from joulemap.service.intake import trial

        return trial.try_run
    from joulemap.service.intake import runs

    runs.load_kernels()
    return runs.read_sent_run


def read(task: str, arguments: str) -> str:
    """Read one file. Result: JSON object: `result`, or `error` with `code`, `message` and `context`."""
    function = prepared(task)
    given = json.loads(arguments)
    limits = ReadLimits(**given.pop("limits"))
    tempfile.tempdir = given.pop("scratch", None)
    name = str(given.get("name", "the file"))
    try:
        return json.dumps({"result": function(guard=Guard(limits), **given)}, allow_nan=False)
    except MemoryError:
        error: JoulemapError = TooLargeError(
            f"{name} needs more than {limits.memory_mb:g} MB of memory to be read: send a smaller one",
            name=name,
            limit_mb=limits.memory_mb,
        )
    except JoulemapError as found:
        error = found
    except OSError:  # no fault of the content: a full disk, for example
        raise
    except Exception as found:  # a file that confuses a reader is refused; the log has what was missed
        _LOG.exception("reading %s failed", name)
        kind = HeightmapError if task == "heightmap" else InputError
        error = kind(f"{name} cannot be read: {type(found).__name__}: {str(found)[:200]}", name=name)
    return json.dumps({"error": {"code": error.code, "message": error.message, "context": error.context}}, default=str)


class Guard:
    """Limits that hold while a block of code runs."""

    def __init__(self, limits: ReadLimits) -> None:
        self._limits = limits

    @contextmanager
    def reading(self, path: Path) -> Iterator[None]:
        """For reading a file."""
        with limited(self._limits.of_file(path.stat().st_size)):
            yield

    @contextmanager
    def keeping(self, cells: int) -> Iterator[None]:
        """For work on content that was read already: its time is known from its size."""
        with limited(ReadLimits(self._limits.seconds + cells / _CELLS_PER_S, self._limits.memory_mb)):
            yield


@contextmanager
def limited(limits: ReadLimits) -> Iterator[None]:
    """Limit this process while a block of code runs; the system ends it where it takes more time."""
    before = {kind: resource.getrlimit(kind) for kind in (resource.RLIMIT_CPU, resource.RLIMIT_DATA)}
    used = time.process_time()
    _lower(resource.RLIMIT_CPU, math.ceil(used + limits.seconds))
    data = _data_bytes()
    if data is not None:
        _lower(resource.RLIMIT_DATA, data + int(limits.memory_mb * 1e6))
    signal.setitimer(signal.ITIMER_REAL, limits.wall_s)  # nothing handles the signal: it ends the process
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for kind, (soft, hard) in before.items():
            resource.setrlimit(kind, (soft, hard))


def _lower(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    known = [value for value in (limit, hard) if value != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min(known), hard))


def _data_bytes() -> int | None:
    """Memory of this process that counts to RLIMIT_DATA; None where the system does not say."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return None
    line = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmData:"))
    return 1024 * int(line.split()[1])
