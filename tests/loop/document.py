"""A table as a document: with the command that made it, the date and the machine."""

from __future__ import annotations

import datetime as dt
import os
import platform
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path


def wrapped(title: str, module: str, text: str, arguments: Sequence[str] | None) -> str:
    """Return a table under a title with how it was made.

    Parameters
    ----------
    title : str
        Heading.
    module : str
        That was run.
    text : str
        The table.
    arguments : sequence of str, optional
        Of the command line; without them, those of this process.

    Returns
    -------
    str
        Markdown. Where results were written or kept is left out of the command.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    for option in ("--write", "--kept", "--jobs"):
        if option in words:
            at = words.index(option)
            del words[at : at + 2]
    command = shlex.join(["python", "-m", module, *words])
    return (
        f"# {title}\n\n`{command}`, {dt.date.today()}, {os.cpu_count()} cores of {_processor()}, "
        f"Python {platform.python_version()}.\n\n{text}\n"
    )


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
