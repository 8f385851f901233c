"""What every command shares: how it answers, warns, reports progress and fails."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text
from typer.core import TyperGroup

from joulemap.model.errors import JoulemapError
from joulemap.service.commands.arguments import RUNNING, with_option_names

STOPPED = 130
"""Exit code of a command that was stopped by Ctrl-C, as in every shell."""

_WITH_LETTERS = re.compile(r"([+-]?\d+\.?\d*)\s*°?\s*([NSns])\s*,\s*([+-]?\d+\.?\d*)\s*°?\s*([EWew])")

Report = Callable[[float], None]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the whole answer as JSON (-: to stdout).", allow_dash=True),
]


class PlainErrors(TyperGroup):
    """A command group in which an error of the tree is one line on stderr and an exit code, never a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the context names.

        Parameters
        ----------
        ctx : typer.Context
            Of the group.

        Returns
        -------
        object
            Whatever the command returns.

        Raises
        ------
        typer.Exit
            With the exit code of `service.problems`, 1 where a file cannot be read or written, 130 after Ctrl-C.
        """
        try:
            return super().invoke(ctx)
        except JoulemapError as error:
            from joulemap.service.problems import exit_code

            command = self.get_command(ctx, ctx.invoked_subcommand or "")
            options = command.params if command is not None else ()
            fail(with_option_names(error.message, options) + _way_out(error, options))
            raise typer.Exit(exit_code(error)) from error
        except KeyboardInterrupt as stop:
            fail(str(stop), mark="stopped")
            raise typer.Exit(STOPPED) from stop
        except BrokenPipeError:
            raise
        except OSError as error:
            place = f"{error.filename}: " if error.filename is not None else ""
            fail(f"{place}{error.strerror or error}")
            raise typer.Exit(1) from error


def _way_out(error: JoulemapError, options: Iterable[Any]) -> str:
    """An option of the command that helps, of which the library cannot know."""
    if "nearest" in error.context and any("--snap" in option.opts for option in options):
        return "; --snap goes there"
    return ""


def fail(message: str, *, mark: str = "error") -> None:
    """Write one line on stderr.

    Parameters
    ----------
    message : str
        What is wrong; may be empty.
    mark : str
        What the line begins with.
    """
    words = f"[bold red]{mark}{':' if message else ''}[/] {escape(message)}".rstrip()
    Console(stderr=True, soft_wrap=True).print(words, highlight=False)


class Output:
    """Where a command writes: stdout, or stderr while `--json -` claims stdout for the document.

    Parameters
    ----------
    json_file : Path, optional
        The value of `--json`.
    """

    def __init__(self, json_file: Path | None) -> None:
        self.json_file = json_file
        self.to_stdout = json_file is not None and str(json_file) == "-"
        self.console = Console(stderr=self.to_stdout, soft_wrap=True)

    def say(self, line: str = "", *, head: str = "", style: str = "bold") -> None:
        """Write a line.

        Parameters
        ----------
        line : str
            Plain text: names of files and robots may hold brackets.
        head : str
            Stands before it, in a style.
        style : str
            Of rich.
        """
        gap = " " if head and line else ""
        self.console.print(Text.assemble((head, style), gap, line), highlight=False)

    def table(self, rows: Mapping[str, str]) -> None:
        """Write names and values in two columns.

        Parameters
        ----------
        rows : mapping of str to str
            Name -> value, plain text.
        """
        width = max(map(len, rows), default=0)
        for name, value in rows.items():
            self.say(value, head=f"  {name:<{width}} ", style="dim")

    def warn(self, warnings: Iterable[str]) -> None:
        """Write what the user must not overlook, on stderr.

        Parameters
        ----------
        warnings : iterable of str
            Each is a line.
        """
        console = Console(stderr=True, soft_wrap=True)
        for warning in warnings:
            words = with_option_names(warning, RUNNING.get())
            console.print(f"[bold yellow]warning:[/] {escape(words)}", highlight=False)

    def document(self, document: Mapping[str, Any]) -> None:
        """Write the JSON document where `--json` wants it.

        Parameters
        ----------
        document : mapping
            Plain values.

        Raises
        ------
        JoulemapError
            If a number of it is not finite.
        """
        if self.json_file is None:
            return
        text = json_text(document)
        if self.to_stdout:
            sys.stdout.write(text)
        else:
            write_file(self.json_file, text.encode())


def json_text(document: Mapping[str, Any]) -> str:
    """Return a document as JSON that every reader accepts.

    Parameters
    ----------
    document : mapping
        Plain values.

    Returns
    -------
    str
        With a line feed at its end.

    Raises
    ------
    JoulemapError
        If a number of it is not finite: JSON has no NaN.
    """
    try:
        return json.dumps(document, indent=2, allow_nan=False) + "\n"
    except ValueError as error:
        place = _place_of_no_number(document)
        raise JoulemapError(f"the answer cannot be written as JSON: {place} is not a finite number") from error


def _place_of_no_number(value: Any, place: str = "") -> str:
    """Where the first number is that is not finite, like features[0].geometry; empty where there is none."""
    if isinstance(value, float):
        return "" if math.isfinite(value) else place
    inside: Iterable[tuple[str, Any]] = ()
    if isinstance(value, Mapping):
        inside = ((f"{place}.{key}".lstrip("."), item) for key, item in value.items())
    elif isinstance(value, (list, tuple)):
        inside = ((f"{place}[{k}]", item) for k, item in enumerate(value))
    return next((found for name, item in inside if (found := _place_of_no_number(item, name))), "")


def write_file(path: Path, content: bytes) -> None:
    """Write a file, and make its folder where it is missing.

    Parameters
    ----------
    path : Path
        What is there is replaced.
    content : bytes
        All of it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


@contextmanager
def leaves_nothing_behind() -> Iterator[None]:
    """Say so when Ctrl-C stops what is done inside, which removes its own traces."""
    try:
        yield
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt("nothing is left behind") from stop


@contextmanager
def progress_bar(what: str) -> Iterator[Report]:
    """Show a bar on stderr that is gone when the work is done.

    Parameters
    ----------
    what : str
        One word before the bar.

    Yields
    ------
    callable
        Moves the bar; its argument is the share that is done, 0..1.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)


def parse_point(text: str | tuple[float, float] | dict[str, float]) -> tuple[float, float] | dict[str, float]:
    """Return a place that was typed.

    Parameters
    ----------
    text : str
        Like "12.5,40" [m], or "36.72N,4.49W" [degrees]; what was parsed is returned as it is.

    Returns
    -------
    tuple of float or dict
        The two numbers: x, y [m] where they lie on the map, else latitude, longitude. Of degrees with letters, an
        object with `lat` and `lon`.

    Raises
    ------
    typer.BadParameter
        If the text is no point: wrong usage (exit code 2).
    """
    if not isinstance(text, str):
        return text
    if found := _WITH_LETTERS.fullmatch(text.strip()):
        lat, lon = float(found[1]), float(found[3])
        return {"lat": -lat if found[2] in "Ss" else lat, "lon": -lon if found[4] in "Ww" else lon}
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is not X,Y: two numbers of metres with a comma between, or latitude,longitude like 36.72N,4.49W"
        ) from None
    return x, y


def parse_share(text: str | float) -> float:
    """Return a share that was typed.

    Parameters
    ----------
    text : str or float
        Like "0.6".

    Returns
    -------
    float
        0..1.

    Raises
    ------
    typer.BadParameter
        If it is no number of 0..1. For a percentage the message says what to type.
    """
    try:
        share = float(str(text).rstrip("% "))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number of 0..1") from None
    percent = isinstance(text, str) and "%" in text
    if 0.0 <= share <= 1.0 and not percent:
        return share
    if (percent or share > 1.0) and 0.0 <= share <= 100.0:
        raise typer.BadParameter(f"{text} is not a share of 0..1: for {share:g} % write {share / 100.0:g}")
    raise typer.BadParameter(f"{text} is not a share of 0..1")
