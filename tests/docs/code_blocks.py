"""Fenced code blocks of a page in Markdown, and a machine that runs them in order."""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

ROOT = Path(__file__).resolve().parents[2]
RUN = ("bash", "python")
"""Languages whose blocks are run."""
DATA = ("text", "toml", "json", "csv", "yaml", "console")
"""Languages whose blocks are not run; with a title they are written to the file of that name."""

_FENCE = re.compile(r"^(?P<fence>`{3,})(?P<info>.*)$")
_MARK = re.compile(r"^<!-- (?P<kind>not run|slow): (?P<reason>\S.*) -->$")
_TITLE = re.compile(r'title="([^"]+)"')
_SERVICE = "localhost:8000"
_LONGEST_S = 600.0


@dataclass(frozen=True)
class Block:
    """A fenced block. mark : "not run", "slow", or "" for one that every test run executes; line : of its fence."""

    page: str
    line: int
    language: str
    title: str
    text: str
    mark: str
    reason: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line} ({self.language})"


def pages() -> list[str]:
    """Every page whose blocks are run, relative to the repository."""
    docs = [page.relative_to(ROOT).as_posix() for page in sorted((ROOT / "docs").rglob("*.md"))]
    return ["README.md", "CONTRIBUTING.md", *(page for page in docs if not own_test(page).is_file())]


def own_test(page: str) -> Path:
    """Where the test of a page on adding one more would be; such pages add modules, and are run by it."""
    name = Path(page).stem.replace("-", "_")
    return ROOT / "tests/docs" / (f"test_{name}.py" if name.startswith(("add_a_", "add_an_")) else "none")


def blocks_of(page: str) -> list[Block]:
    """The blocks of a page, in order. Raises ValueError for a fence that is not closed."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    found, k = [], 0
    while k < len(lines):
        opened = _FENCE.match(lines[k])
        if opened is None:
            k += 1
            continue
        end = next((j for j in range(k + 1, len(lines)) if lines[j].rstrip() == opened["fence"]), None)
        if end is None:
            raise ValueError(f"{page}:{k + 1}: the block is not closed")
        language, _, more = opened["info"].strip().partition(" ")
        title, mark = _TITLE.search(more), _MARK.match(lines[k - 1]) if k else None
        found.append(
            Block(
                page,
                k + 1,
                language,
                title[1] if title else "",
                "\n".join(lines[k + 1 : end]) + "\n",
                mark["kind"] if mark else "",
                mark["reason"] if mark else "",
            )
        )
        k = end + 1
    return found


class Machine:
    """A folder in which the blocks of one page run: a shell and a Python namespace that last until the end of it."""

    def __init__(self, folder: Path, *, service: str = "") -> None:
        self.folder, self.service = folder, service
        self.names: dict[str, Any] = {"__name__": "__main__"}
        environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "MPLBACKEND": "Agg",
            "COLUMNS": "120",
        }
        self.shell = subprocess.Popen(
            ["bash"],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def __enter__(self) -> Self:
        self._shell("set -euo pipefail\n")
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.shell.pid, signal.SIGKILL)
        self.shell.wait()

    def run(self, block: Block) -> str:
        """What a block printed. Raises AssertionError where its shell fails, and what its Python raises."""
        if block.title:
            (self.folder / block.title).write_text(block.text, encoding="utf-8")
        if block.language == "bash":
            return self._shell(block.text.replace(_SERVICE, self.service or _SERVICE), name=str(block))
        return self._python(block) if block.language == "python" else ""

    def _python(self, block: Block) -> str:
        printed = io.StringIO()
        code = compile("\n" * block.line + block.text, block.page, "exec")
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(printed):
            exec(code, self.names)
        return printed.getvalue()

    def _shell(self, text: str, *, name: str = "") -> str:
        assert self.shell.stdin is not None
        assert self.shell.stdout is not None
        done = f"__done_{time.monotonic_ns()}__"
        self.shell.stdin.write(f"{{\n{text}\n}} </dev/null\necho {done}\n")
        self.shell.stdin.flush()
        printed = ""
        for line in self._lines():
            if line.endswith(f"{done}\n"):
                return printed + line.removesuffix(f"{done}\n")
            printed += line
        raise AssertionError(f"{name} failed:\n{text}\n--- it printed:\n{printed}")

    def _lines(self) -> Iterator[str]:
        """Lines of the shell until it ends."""
        assert self.shell.stdout is not None
        old = signal.signal(signal.SIGALRM, self._too_long)
        signal.setitimer(signal.ITIMER_REAL, _LONGEST_S)
        try:
            yield from iter(self.shell.stdout.readline, "")
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, old)

    def _too_long(self, *_: object) -> None:
        raise AssertionError(f"a block took longer than {_LONGEST_S:.0f} s")
