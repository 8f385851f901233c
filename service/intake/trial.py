"""Reads logs on trial in a process of their own, within limits: some that are corrupt end it, or fill the memory.

A command or a notebook reads them in its own process afterwards, and would end with them. Texts need no trial.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from joulemap.model.errors import RunsError, TooLargeError, error_of
from joulemap.model.runs.files import distinct_names
from joulemap.model.runs.logs import format_of, read_log
from joulemap.service.intake.guard import Guard, read
from joulemap.service.intake.limits import ReadLimits

LIMITS = ReadLimits(seconds=300.0, memory_mb=4_000.0)
"""What reading one log may take: as `joulemap import` has it."""


def refuse_deadly(
    files: Sequence[Path], *, mapping: Mapping[str, str] | None = None, limits: ReadLimits = LIMITS
) -> None:
    """Refuse a log that ends the process that reads it, or takes more time or memory than the limits."""
    kinds = [format_of(file, file.name) for file in files]
    named = [each for each in zip(files, distinct_names(files), kinds, strict=True) if not each[2].text]
    if not named:
        return
    asked = {
        "files": [(str(file.resolve()), name) for file, name, _ in named],
        "mapping": dict(mapping or {}),
        "limits": asdict(limits),
    }
    with tempfile.TemporaryDirectory(prefix="joulemap-") as scratch:
        tried = subprocess.run(
            [sys.executable, "-m", __name__],
            input=json.dumps(asked).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"TMPDIR": scratch},
            check=False,
        )
    said = [json.loads(line) for line in tried.stdout.splitlines()]
    for answer in said:
        if "error" in answer:
            raise error_of(**answer["error"])
    if tried.returncode < 0:
        _, name, kind = named[len(said)]
        cause = signal.Signals(-tried.returncode)
        if cause in (signal.SIGALRM, signal.SIGXCPU, signal.SIGKILL):
            raise TooLargeError(
                f"run {name}: it could not be read within {limits.seconds:g} s and {limits.memory_mb:g} MB of memory: "
                "it is corrupt, or much larger inside than outside",
                run=name,
            )
        raise RunsError(f"run {name}: reading it ends the process ({cause.name}): the {kind.name} is corrupt", run=name)


def _main() -> None:
    """Print a line for each file that was read or refused, as `guard.read` answers."""
    asked = json.load(sys.stdin)
    for file, name in asked.pop("files"):
        print(read("trial", json.dumps({"path": file, "name": name, **asked})), flush=True)


def try_run(*, guard: Guard, path: str, name: str, mapping: dict[str, str]) -> dict[str, Any]:
    """Read a log, and keep nothing of it."""
    with guard.reading(Path(path)):
        read_log(Path(path), name, {}, mapping=mapping)
    return {}


if __name__ == "__main__":
    _main()
