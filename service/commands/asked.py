"""Options of commands that are read from a request: a field is an option, with its name, type, default and meaning.

A command has a parameter `wanted: Annotated[Wanted, "MODULE:REQUEST"]`, or "MODULE:REQUEST -FIELD" without a field. In
its place come the options. Places are typed as X,Y; areas and paths come from files, and so does what is known of a
battery beside its charge. pydantic loads slowly, so requests are imported when one command is asked for, and not when
all of them are listed.
"""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer

from joulemap.model.errors import InputError
from joulemap.service.commands.console import Command, Output, PlainErrors, parse_point, parse_share
from joulemap.service.commands.options import BatteryFile, battery_values, known_model, there
from joulemap.service.commands.route_files import PLACE
from joulemap.service.words import capital

if TYPE_CHECKING:
    from pydantic import BaseModel

    from joulemap.model.frames import GridFrame
    from joulemap.service.questions.asking import Field
    from joulemap.service.questions.parts import OnMap

_TYPES = {"integer": int, "number": float, "string": str, "boolean": bool, "array": list}
_METAVARS = {"m": "M", "s": "S", "w": "W", "wh": "WH", "percent": "PERCENT"}  # by the unit that a name ends with
_NAMES = {
    "charges": ("charge",),
    "stops": ("stop",),
    "round_trip": ("return", "round-trip"),
    "within_percent": ("within",),
    "architecture": ("arch", "architecture"),
    "start_from": ("from", "start-from"),
    "backbone": ("weights",),
}
"""Options whose names are not that of their field."""
_FILES = {
    "avoid": "GeoJSON with areas (polygons) that no route may touch; may be given several times.",
    "path": "A path: GeoJSON, GPX, KML, a mission (.plan, .waypoints), the JSON of `joulemap path` or `tour`, or CSV "
    "with lines x,y. Several lines are driven one after another.",
}
_OF_BATTERY = ("charge", "reserve", "capacity_wh")


@dataclass(frozen=True)
class Wanted:
    """The fields of a request as they were typed; `changed` are those that differ from their defaults."""

    typed: dict[str, Any]
    changed: frozenset[str]
    request: type[OnMap]

    def __contains__(self, name: str) -> bool:
        return name in self.changed

    def on(self, frame: GridFrame) -> tuple[dict[str, Any], list[str]]:
        """The fields on a map but for those that are as usual, and notes of files that had to be interpreted."""
        from joulemap.service.commands.path_files import read_areas, read_path

        values, notes = {name: value for name, value in self.typed.items() if name in self}, list[str]()
        if "path" in values:
            values["path"], notes = read_path(values["path"], frame)
        if "avoid" in values:
            read = [read_areas(file, frame) for file in values["avoid"]]
            values["avoid"] = [area for areas, _ in read for area in areas]
            notes += [note for _, found in read for note in found]
        return values, notes


class Commands(PlainErrors):
    """The commands of `joulemap`, of which only the one that is asked for is made with its options."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._whole: dict[str, Any] = {}
        self._listing = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help of the group."""
        self._listing = True
        super().format_help(ctx, formatter)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name."""
        command: Any = super().get_command(ctx, cmd_name)
        function = getattr(command and command.callback, "whole", None)
        if self._listing or function is None:
            return command
        if cmd_name not in self._whole:
            alone = typer.Typer(add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False)
            alone.command(cmd_name, cls=Command, context_settings=command.context_settings)(with_options(function))
            self._whole[cmd_name] = typer.main.get_command(alone)
        return self._whole[cmd_name]


def listed(command: Callable[..., None]) -> Callable[[], None]:
    """A command without its options, for the list of commands."""

    def _listed() -> None:
        raise AssertionError("the group makes the command with its options")

    _listed.__name__, _listed.__doc__ = command.__name__, command.__doc__
    _listed.whole = command  # type: ignore[attr-defined]
    return _listed


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command with the options of its requests."""
    whole = _part_of(command)

    def _command(**given: Any) -> None:
        with _warnings_said():
            whole.made(given)

    _command.__name__, _command.__doc__ = command.__name__, command.__doc__
    _command.__signature__ = inspect.Signature(whole.options)  # type: ignore[attr-defined]
    _command.__annotations__ = {one.name: one.annotation for one in whole.options}
    return _command


@dataclass(frozen=True)
class _Part:
    """Options, and what is made of their values, which it takes out of those that were typed."""

    options: list[inspect.Parameter]
    made: Callable[[dict[str, Any]], Any]


def _part_of(made_of: Callable[..., Any]) -> _Part:
    """The options of a command, or of a dataclass that several commands share."""
    hints = get_type_hints(made_of, include_extras=True)
    parts = {one.name: _part(one, hints[one.name]) for one in inspect.signature(made_of).parameters.values()}
    options = [option for part in parts.values() for option in part.options]
    return _Part(options, lambda typed: made_of(**{name: part.made(typed) for name, part in parts.items()}))


def _part(parameter: inspect.Parameter, kind: Any) -> _Part:
    """What a parameter is made of: one option, the fields of a request, or the fields of a dataclass."""
    if is_dataclass(kind):
        return _part_of(kind)  # type: ignore[arg-type]
    if get_origin(kind) is not Annotated or not isinstance(get_args(kind)[1], str):
        option = parameter.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY)
        return _Part([option], lambda typed: typed.pop(parameter.name))
    place, *without = get_args(kind)[1].split(" -")
    module, _, request = place.partition(":")
    asked = getattr(import_module(module), request)
    options = list(_options_of(asked, without))

    def _made(typed: dict[str, Any]) -> Wanted | dict[str, Any]:
        values = {option.name: typed.pop(option.name) for option in options}
        changed = {option.name for option in options if values[option.name] != option.default}
        wanted = Wanted(_joined(values), frozenset(changed | ({"battery"} & values.keys())), asked)
        if get_args(kind)[0] is Wanted:  # which is checked on its map
            return wanted
        _check_numbers(asked, {name: typed for name, typed in values.items() if name in changed})
        return wanted.typed

    return _Part(options, _made)


def _check_numbers(request: type[BaseModel], typed: Mapping[str, Any]) -> None:
    """Refuse numbers out of their bounds, before files are read. Raises InputError."""
    from joulemap.service.questions.given import checked

    numbers = {name: value for name, value in typed.items() if isinstance(value, int | float)}
    try:
        checked(request, numbers)
    except InputError as error:  # other fields come from files
        if wrong := [one for one in error.context["errors"] if one["field"] in numbers]:
            raise InputError(error.message, errors=wrong) from None


@contextmanager
def _warnings_said() -> Iterator[None]:
    """Say what the library warns of as commands say it, and not as Python does."""
    usual = warnings.showwarning

    def _say(message: Any, category: type[Warning], filename: str, *more: Any, **rest: Any) -> None:
        if category is UserWarning and "joulemap" in filename:
            Output(None).warn([str(message)])
        else:
            usual(message, category, filename, *more, **rest)

    with warnings.catch_warnings():
        warnings.showwarning = _say
        yield


def _joined(typed: dict[str, Any]) -> dict[str, Any]:
    """Options as fields: those of the battery are one, and so are layers."""
    if typed.get("layers"):
        typed["layers"] = _layers(typed["layers"])
    if "battery" not in typed:
        return typed
    from joulemap.service.questions.given import battery_with

    state = {name: typed.pop(name) for name in _OF_BATTERY if name in typed}
    return {**typed, "battery": battery_with(battery_values(typed["battery"]), **state)}


def _layers(words: Sequence[str]) -> dict[str, list[str]]:
    """Layers as they were typed, WHAT=FILE, by what they are of."""
    from joulemap.model.terrain.layers.layer import ROLES  # loads slowly

    found: dict[str, list[str]] = {}
    for text in words:
        role, equals, file = text.partition("=")
        if not (equals and file):
            raise typer.BadParameter(
                f"{text!r} is no layer: write WHAT=FILE, like kinds=land.tif", param_hint="--layer"
            )
        if role not in ROLES:
            raise typer.BadParameter(f"{role!r} is no layer: known are {', '.join(ROLES)}", param_hint="--layer")
        there(Path(file))
        found.setdefault(role, []).append(file)
    return found


def _options_of(request: type[BaseModel], without: Sequence[str]) -> Iterator[inspect.Parameter]:
    from joulemap.service.questions.asking import fields_of, value_of

    needed, others = fields_of(request)
    panel = None if "robot" in request.model_fields else (request.__doc__ or "").rstrip(".")
    fields = {name: field for name, field in (needed | others).items() if name not in without}
    for name, field in fields.items():
        if name in _FILES:
            several = name == "avoid"
            file = typer.Option(f"--{name}", metavar="FILE", callback=there, help=_FILES[name])
            yield _parameter(name, Annotated[list[Path] | None if several else Path | None, file], None)
        elif name == "layers":
            option = typer.Option("--layer", metavar="WHAT=FILE", help=_sentence(field, fields))
            yield _parameter(name, Annotated[list[str] | None, option], None)
        elif name == "charges":  # several shares, and with them the charge of the battery
            option = typer.Option("--charge", metavar="0..1[,0..1...]", parser=_shares, help=_sentence(field, fields))
            yield _parameter(name, Annotated[Any, option], "1.0")
        elif name == "battery":
            known = value_of(field)["properties"]
            own = [one for one in _OF_BATTERY if one != "charge" or "charges" not in fields]
            yield from (_option(one, known[one], fields) for one in own)
            yield _parameter(name, BatteryFile, None)
        else:
            yield _option(name, field, fields, needed=name in needed, rich_help_panel=panel)


def _option(
    name: str, field: Field, fields: Mapping[str, Field], *, needed: bool = False, **more: Any
) -> inspect.Parameter:
    """The option of a number, a text, a flag, a place or a list of places."""
    from joulemap.service.questions.asking import is_place, value_of

    value, names = value_of(field), flags(name)
    kind: Any = _TYPES[value["type"]]
    default = ... if needed else field.get("default")
    words: dict[str, Any] = {"help": _sentence(field, fields), **more}
    low, high = value.get("minimum"), value.get("maximum")
    if kind is list:
        several, default = not is_place(value), default or None
        own = field.get("description")
        own = None if own is None or own.startswith("world") else own
        words |= {
            "metavar": "X,Y..." if several else "X,Y",
            "parser": parse_point,
            "help": f"{capital(name) if own is None else capital(own)}: {PLACE}.",
        }
        kind = list[Any] if several else Any
    elif kind is bool:
        names = [f"{names[0]}/--no-{names[0][2:]}"] if default else names
    elif choices := value.get("enum"):
        words["metavar"] = "|".join(map(str, choices))
    elif (
        low is not None
        and high is not None
        and default is not None
        and any(one.get("type") == "null" for one in field.get("anyOf", ()))
    ):
        words |= {"metavar": f"{low:g}..{high:g}|null", "parser": _or_null}
        kind = Any
    elif (low, high) == (0.0, 1.0):
        words |= {"metavar": "0..1", "parser": parse_share}
    elif kind in (int, float):
        share = high is not None and high <= 1.0
        words["metavar"] = "0..1" if share else "N" if kind is int else _METAVARS.get(name.rpartition("_")[2], "NUMBER")
    elif value.get("format") == "path":
        kind, words = Path, {**words, "metavar": "FILE", "callback": there}
    elif value.get("format") == "model":
        words |= {"metavar": "M", "callback": known_model}
    else:
        words["metavar"] = "|".join(value["enum"]) if "enum" in value else name.upper()
    if default is None and kind is not Any:
        kind = kind | None
    return _parameter(name, Annotated[kind, typer.Option(*names, **words)], default)


def flags(name: str) -> list[str]:
    """The options of a field; a unit in its name is in its help."""
    return [f"--{one.replace('_', '-')}" for one in _NAMES.get(name) or (re.sub(r"_[msw]$", "", name),)]


def _sentence(field: Field, fields: Mapping[str, Field]) -> str:
    """The meaning of a field, which calls other fields by their options."""
    from joulemap.service.questions.asking import meaning_of

    def _called(found: re.Match[str]) -> str:
        return flags(found[1])[0] if found[1] in fields else found[0]

    return capital(re.sub(r"`(\w+)`", _called, meaning_of(field))) + "."


def _parameter(name: str, kind: Any, default: Any) -> inspect.Parameter:
    empty = inspect.Parameter.empty
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, annotation=kind, default=empty if default is ... else default
    )


def _or_null(text: Any) -> Any:
    """A number, or null for none; its bounds are those of the request."""
    try:
        return None if text == "null" else float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no number; `null` is for none") from None


def _shares(text: Any) -> Any:
    return tuple(parse_share(part) for part in text.split(",")) if isinstance(text, str) else text
