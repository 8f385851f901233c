"""What every command shares: how it answers, warns, reports progress and fails."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from typer.core import TyperGroup

from joulemap.model.errors import JoulemapError

Report = Callable[[float], None]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the whole answer as JSON (-: to stdout).", allow_dash=True),
]


class PlainErrors(TyperGroup):
    """A command group in which an error of the tree is one line on stderr and an exit code, never a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command. Exit codes are those of `service.problems`; 1 where a file cannot be read or written."""
        try:
            return super().invoke(ctx)
        except JoulemapError as error:
            from joulemap.service.problems import exit_code

            fail(error.message)
            raise typer.Exit(exit_code(error)) from error
        except BrokenPipeError:
            raise
        except OSError as error:
            place = f"{error.filename}: " if error.filename is not None else ""
            fail(f"{place}{error.strerror or error}")
            raise typer.Exit(1) from error


def fail(message: str) -> None:
    """One line on stderr."""
    Console(stderr=True, soft_wrap=True).print(f"[bold red]error:[/] {escape(message)}", highlight=False)


class Answer:
    """Where a command's words go: stdout, or stderr while `--json -` claims stdout for the document."""

    def __init__(self, json_file: Path | None) -> None:
        self.json_file = json_file
        self.to_stdout = json_file is not None and str(json_file) == "-"
        self.console = Console(stderr=self.to_stdout, soft_wrap=True)

    def say(self, line: str = "") -> None:
        """A line in words; rich markup is understood."""
        self.console.print(line, highlight=False)

    def table(self, rows: Mapping[str, str]) -> None:
        """Names and values in two columns."""
        width = max(len(name) for name in rows)
        for name, value in rows.items():
            self.say(f"  [dim]{name:<{width}}[/]  {escape(value)}")

    def warn(self, warnings: Iterable[str]) -> None:
        """What the user must not overlook, on stderr."""
        console = Console(stderr=True, soft_wrap=True)
        for warning in warnings:
            console.print(f"[bold yellow]warning:[/] {escape(warning)}", highlight=False)

    def document(self, document: Mapping[str, Any]) -> None:
        """Write the JSON document where `--json` wants it."""
        if self.json_file is None:
            return
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
        if self.to_stdout:
            sys.stdout.write(text)
        else:
            write_file(self.json_file, text.encode())


def write_file(path: Path, content: bytes) -> None:
    """Write a file, making its folder where it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


@contextmanager
def progress_bar(what: str) -> Iterator[Report]:
    """A bar on stderr that is gone when the work is done; gives the callback (0..1) that moves it."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)


def parse_point(text: str | tuple[float, float]) -> tuple[float, float]:
    """ "X,Y" in metres as a pair; a wrong text is wrong usage (exit code 2)."""
    if isinstance(text, tuple):
        return text
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not X,Y: two numbers of metres with a comma between") from None
    return x, y
