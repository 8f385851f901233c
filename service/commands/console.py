"""What every command shares: how it is typed, how it answers, warns, reports progress and fails."""

from __future__ import annotations

import json
import math
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from joulemap.model.errors import JoulemapError

RENAMED: Mapping[str, str] = {
    "--base-runs": "--baseline-runs",
    "--keep-aside": "--test-runs",
    "--test": "--test-runs",
}
"""Options of older versions -> their names today. Each is still accepted by the commands that have the new one."""

_NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
_POINT = re.compile(rf"\s*{_NUMBER}\s*[NSns]?\s*,\s*{_NUMBER}\s*[EWew]?\s*")
_NAME = re.compile(r"`([a-z][a-z0-9_]*)`")
_UNITS = ("_m", "_s", "_wh")


TYPED = "joulemap.typed"
"""What of a context holds the words that were typed after the command's name."""

RUNNING: ContextVar[Sequence[Any]] = ContextVar("running", default=())
"""Options and arguments of the command that runs, by whose names its warnings call them."""


VALUES: ContextVar[frozenset[str]] = ContextVar("values", default=frozenset())
"""Parameters of the command that runs whose options were typed with a value, and not with the name of a file."""


class Command(TyperCommand):
    """A command whose list options take every value up to the next option: `--runs a.csv b.csv --out found`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse `args` as typer does, once they have one value for each option."""
        ctx.meta[TYPED] = list(args)
        RUNNING.set(self.params)
        options: list[Any] = [option for option in self.params if option.param_type_name == "option"]
        names = {name for option in options for name in option.opts}
        words = {word.partition("=")[0] for word in args}
        values = (one.name for one in options if words & {*one.opts} and "FILE" not in str(one.metavar))
        VALUES.set(frozenset(values))
        known = {old: new for old, new in RENAMED.items() if new in names and old not in names}
        for old in sorted(words & known.keys()):
            typer.echo(f"note: {old} is now called {known[old]}", err=True)
        return super().parse_args(
            ctx,
            one_value_each(
                [_renamed(word, known) for word in args],
                lists={name for option in options if option.multiple for name in option.opts},
                singles={n for o in options if not (o.multiple or o.is_flag or o.count) for n in o.opts},
                only_points=len(options) < len(self.params),
            ),
        )


def _renamed(word: str, known: Mapping[str, str]) -> str:
    name, equals, value = word.partition("=")
    return f"{known.get(name, name)}{equals}{value}"


def one_value_each(args: Iterable[str], *, lists: set[str], singles: set[str], only_points: bool = False) -> list[str]:
    """Return a command line in which an option of several values is repeated before each of them."""
    words, out = list(args), list[str]()
    option, wants_value = "", False
    for k, word in enumerate(words):
        if word == "--" and not wants_value:
            return [*out, *words[k:]]
        is_option = len(word) > 1 and word.startswith("-") and not _begins_a_number(word)
        if wants_value:
            out.append(word)
            wants_value = False
        elif is_option:
            name, equals, _ = word.partition("=")
            option = name if name in lists else ""
            wants_value = not equals and name in lists | singles
            out.append(word)
        elif option and (not only_points or _POINT.fullmatch(word)):
            out += [option, word]
        else:
            option = ""
            out.append(word)
    return out


def _begins_a_number(word: str) -> bool:
    return word[1:2].isdigit() or (word[1:2] == "." and word[2:3].isdigit())


def with_option_names(message: str, parameters: Iterable[Any]) -> str:
    """Return a message of the library in which parameters have the names of a command's options.

    The library writes a parameter's name in backticks, with its unit: `resolution_m` becomes --resolution.
    """
    options = {p.name: max(p.opts, key=len) if p.param_type_name == "option" else p.metavar for p in parameters}

    def option_of(match: re.Match[str]) -> str:
        name = match[1]
        short = next((name.removesuffix(unit) for unit in _UNITS if name.endswith(unit)), name)
        return str(options.get(name) or options.get(short) or match[0])

    return _NAME.sub(option_of, message)


_WHOLE = "body"  # the field of what is wrong with a request as a whole
_WRONG_USAGE = 2  # as of click
_NOT_INSTALLED = 3  # as for input that cannot be used
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
        """Run the command that the context names."""
        with plain_errors():
            return super().invoke(ctx)


@contextmanager
def plain_errors() -> Iterator[None]:
    """Say an error of the command that runs inside.

    Raises typer.BadParameter for options that do not go together; else typer.Exit with 2 for values of options that
    their request refuses, the exit code of `service.problems`, 1 where a file cannot be read or written, 130 after
    Ctrl-C.
    """
    try:
        yield
    except JoulemapError as error:
        from joulemap.service.problems import exit_code

        options = RUNNING.get()
        words = with_option_names(_said(error), options) + _way_out(error, options)
        wrong = error.context.get("errors")
        if wrong and all(one["field"] == _WHOLE for one in wrong):  # not a value, but which options are given together
            raise typer.BadParameter(words) from error
        fail(words)
        raise typer.Exit(_WRONG_USAGE if wrong and _all_typed(wrong) else exit_code(error)) from error
    except KeyboardInterrupt as stop:
        fail(str(stop), mark="stopped")
        raise typer.Exit(STOPPED) from stop
    except ModuleNotFoundError as error:
        if (extra := extra_of(error)) is None:
            raise
        fail(f"this needs {error.name}, which is not installed: pip install 'joulemap[{extra}]'")
        raise typer.Exit(_NOT_INSTALLED) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        place = f"{error.filename}: " if error.filename is not None else ""
        fail(f"{place}{error.strerror or error}")
        raise typer.Exit(1) from error


def extra_of(error: BaseException) -> str | None:
    """The extra of this distribution that brings a module which is missing; None for another error."""
    if not isinstance(error, ModuleNotFoundError) or error.name is None:
        return None
    from importlib.metadata import requires  # loads slowly

    name = re.escape(error.name.partition(".")[0].replace("_", "-"))
    lines = (re.match(rf'{name}\b[^;]*;.*extra == "(\w+)"', line, re.IGNORECASE) for line in requires("joulemap") or ())
    return next((found[1] for found in lines if found and found[1] != "dev"), None)


def _said(error: JoulemapError) -> str:
    """The message; fields of a request are named in backticks, so that they get the names of options."""
    wrong = error.context.get("errors")
    if not wrong:
        return error.message
    names = map(_field_of, wrong)
    said = ((f"`{name}`: " if name != _WHOLE else "") + one["message"] for name, one in zip(names, wrong, strict=True))
    return "; ".join(dict.fromkeys(said))


def _field_of(wrong: Mapping[str, Any]) -> str:
    """The innermost field that a finding is about."""
    return next((part for part in reversed(wrong["field"].split(".")) if not part.isdigit()), _WHOLE)


def _all_typed(wrong: Iterable[Mapping[str, Any]]) -> bool:
    """Whether what a request refuses was typed as values of options, and not read from files."""
    return all(_field_of(one) in VALUES.get() for one in wrong)


def _way_out(error: JoulemapError, options: Iterable[Any]) -> str:
    """An option of the command that helps, of which the library cannot know."""
    tried = "furthest_m" in error.context
    if "nearest" in error.context and not tried and any("--snap" in option.opts for option in options):
        return "; --snap goes there"
    return ""


def fail(message: str, *, mark: str = "error") -> None:
    """Write one line on stderr."""
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
        """Write a line."""
        gap = " " if head and line else ""
        self.console.print(Text.assemble((head, style), gap, line), highlight=False)

    def table(self, rows: Mapping[str, str]) -> None:
        """Write names and values in two columns."""
        width = max(map(len, rows), default=0)
        for name, value in rows.items():
            self.say(value, head=f"  {name:<{width}} ", style="dim")

    def warn(self, warnings: Iterable[str]) -> None:
        """Write what the user must not overlook, on stderr."""
        console = Console(stderr=True, soft_wrap=True)
        for warning in warnings:
            words = with_option_names(warning, RUNNING.get())
            console.print(f"[bold yellow]warning:[/] {escape(words)}", highlight=False)

    def document(self, document: Mapping[str, Any]) -> None:
        """Write the JSON document where `--json` wants it. Raises JoulemapError if a number of it is not finite."""
        if self.json_file is None:
            return
        text = json_text(document)
        if self.to_stdout:
            sys.stdout.write(text)
        else:
            write_file(self.json_file, text.encode())


def json_text(document: Mapping[str, Any]) -> str:
    """Return a document as JSON that every reader accepts.

    Raises JoulemapError if a number of it is not finite: JSON has no NaN.
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
    """Write a file, and make its folder where it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


@contextmanager
def leaves_nothing_behind() -> Iterator[None]:
    """Say so when Ctrl-C or SIGTERM stops what is done inside, which removes its own traces."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # by default nothing is removed
    try:
        yield
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt("nothing is left behind") from stop
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def progress_bar(what: str) -> Iterator[Report]:
    """Show a bar on stderr that is gone when the work is done; its function is called with the share done, 0..1."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)


def parse_point(text: str | tuple[float, float] | dict[str, float]) -> tuple[float, float] | dict[str, float]:
    """Return a place that was typed: x, y [m], or latitude, longitude of a text such as 36.72N,4.49W.

    What was parsed already is returned as it is. Raises typer.BadParameter if the text is no point.
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


def check_origin(text: str | None) -> str | None:
    """Return an origin that was typed. Raises typer.BadParameter if it is neither X,Y nor the word start."""
    if text is not None and text != "start" and not isinstance(parse_point(text), tuple):
        raise typer.BadParameter(f"{text!r} is not X,Y: two numbers of metres with a comma between")
    return text


def parse_share(text: str | float) -> float:
    """Return a share that was typed.

    Raises typer.BadParameter if it is no number of 0..1. For a percentage the message says what to type.
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
