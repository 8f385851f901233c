"""How a command line is read: several values after one option, names of older versions, option names in messages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextvars import ContextVar
from typing import Any

import typer
from typer.core import TyperCommand

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
