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
from pathlib import Path

from joulemap.model.errors import JoulemapError, RunsError, TooLargeError, error_of
from joulemap.model.runs.files import distinct_names
from joulemap.model.runs.logs import format_of, read_log
from joulemap.service.intake.guard import limited
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
        "limits": [limits.seconds, limits.memory_mb],
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
        if answer is not None:
            raise error_of(**answer)
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
    """Print a line for each file that was read or refused: null, or the error."""
    asked = json.load(sys.stdin)
    limits = ReadLimits(*asked["limits"])
    for file, name in asked["files"]:
        print(json.dumps(_trial(Path(file), name, asked["mapping"], limits), default=str), flush=True)


def _trial(file: Path, name: str, mapping: Mapping[str, str], limits: ReadLimits) -> dict[str, object] | None:
    try:
        with limited(limits.of_file(file.stat().st_size)):
            read_log(file, name, {}, mapping=mapping)
    except JoulemapError as error:
        return {"code": error.code, "message": error.message, "context": error.context}
    except MemoryError:
        words = (
            f"run {name} needs more than {limits.memory_mb:g} MB of memory to be read: it is corrupt, or much larger "
        )
        return {"code": TooLargeError.code, "message": f"{words}inside than outside", "context": {"run": name}}
    return None


if __name__ == "__main__":
    _main()
