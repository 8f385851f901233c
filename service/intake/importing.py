"""Logs on a user's own machine become CSV files in joulemap's columns: all or none, read in guarded processes."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import anyio

from joulemap.model.runs.table import LIMITS
from joulemap.service.intake.limits import ReadLimits, RunLimits, RunReading
from joulemap.service.intake.readers import Readers

_SECONDS = 600.0  # of processor time for a file, and more for a large one
_LONGEST_KM = 100_000.0
_LARGEST_MB = 1e6  # what matters is the memory


def import_logs(
    files: Sequence[tuple[str, Path]],
    out: Path | None,
    *,
    reading: RunReading,
    memory_mb: float = 4_000.0,
    picture: bool = False,
    report: Callable[[float], None] = lambda share: None,
) -> list[dict[str, Any]]:
    """Read logs and write each as a CSV file that `--runs` takes. `out`: folder to write to, None writes nothing."""
    limits = RunLimits(_LARGEST_MB, _LONGEST_KM, asdict(LIMITS))
    asked = {
        "limits_of_run": asdict(limits),
        "reading": reading.as_dict(),
        "any_place": True,
        "always": True,
        "picture": picture,
    }
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".import-") as begun:
        found = anyio.run(_read_all, files, Path(begun), asked, memory_mb, report)
        for (name, _), one in zip(files, found, strict=True):
            one["out"] = None
            if out is not None:
                place = out / f"{name}.csv"
                os.replace(Path(begun) / f"{name}.csv", place)
                one["out"] = str(place)
    return found


async def _read_all(
    files: Sequence[tuple[str, Path]],
    folder: Path,
    asked: dict[str, Any],
    memory_mb: float,
    report: Callable[[float], None],
) -> list[dict[str, Any]]:
    readers = Readers(processes=1, queue=1, limits=ReadLimits(_SECONDS, memory_mb))
    found = []
    try:
        for number, (name, path) in enumerate(files, start=1):
            made = str(folder / f"{name}.csv")
            found.append(await readers.read("run", path=str(path.resolve()), name=path.name, out=made, **asked))
            report(number / len(files))
    finally:
        readers.close()
    return found
