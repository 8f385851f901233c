"""The fields of a request for the faces that read them, and methods whose parameters they are."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, TypeVar

from pydantic import BaseModel

from joulemap.service.questions.given import checked
from joulemap.service.questions.parts import OnMap
from joulemap.service.schemas.base import InPython
from joulemap.service.words import capital

Field = Mapping[str, Any]


def fields_of(request: type[BaseModel]) -> tuple[dict[str, Field], dict[str, Field]]:
    """Return the fields that must be given, and the others: its own first, then what all questions have."""
    schema = request.model_json_schema()
    last = list(OnMap.model_fields)
    marks = {n: next((m for m in f.metadata if isinstance(m, InPython)), None) for n, f in request.model_fields.items()}
    names = sorted((n for n, mark in marks.items() if mark is None or mark.words), key=lambda name: name in last)
    needed = schema.get("required", ())
    ordered = {name: _resolved(schema["properties"][name], schema.get("$defs", {})) for name in names}
    for name, mark in marks.items():
        if mark is not None and mark.words:
            ordered[name] = {**ordered[name], "python": mark.words}
    return {n: f for n, f in ordered.items() if n in needed}, {n: f for n, f in ordered.items() if n not in needed}


def value_of(field: Field) -> Field:
    """What a field holds where it is not null: a number, a text, an array, or an object with `properties`."""
    kinds = [one for one in field.get("anyOf", ()) if one.get("type") != "null"]
    return value_of(kinds[0]) if kinds else field


def meaning_of(field: Field) -> str:
    """What a field means; where it may be null, that may be said of its value alone."""
    inside = (meaning_of(one) for one in field.get("anyOf", ()))
    return field.get("description") or next((words for words in inside if words), "")


def is_place(value: Field) -> bool:
    """Whether a field holds the coordinates of one place."""
    return (
        value.get("type") == "array" and value_of(value["items"])["type"] == "number" and value.get("minItems", 0) > 1
    )


def _resolved(node: Any, known: Mapping[str, Any]) -> Any:
    """A schema with what its references stand for."""
    if isinstance(node, dict):
        if "$ref" in node:
            return _resolved(known[node["$ref"].rpartition("/")[2]], known)
        return {name: _resolved(value, known) for name, value in node.items()}
    return [_resolved(one, known) for one in node] if isinstance(node, list) else node


Answer = TypeVar("Answer")
_TYPES = {"integer": "int", "number": "float", "string": "str", "boolean": "bool", "object": "Mapping[str, Any]"}
_FORMATS = {"path": "str | Path", "model": "ModelLike"}
_PARAMETERS = "Parameters\n----------\n"
SHARED = {
    "progress": "progress : callable, optional\n    Called with the share done, 0..1.",
    "robot": "robot : Robot, mapping, str, Path or None, optional\n"
    "    The robot, its fields, its TOML file, or None for the built-in 35 kg rover.",
    "runs": "runs : Runs, str, Path or sequence of these, optional\n    The runs, or their files.",
    "campaign": "campaign : str or Path, optional\n    A TOML file with a table [[site]] for every map.",
}
"""Parameters that are the same everywhere, as numpydoc has them; no docstring of an asking method repeats them."""


def asks(
    request: type[BaseModel], *without: str, complete: bool = True
) -> Callable[[Callable[..., Answer]], Callable[..., Answer]]:
    """Give a method, or a function, the fields of a request, but for some, in the place of its parameter `wanted`.

    Those that must be given come first, and the others are given by name. `help` and the signature show all of them,
    with the meanings that the request gives them. The method gets the request; where these fields do not make it
    complete, it gets the values that were given, by name.
    """
    needed, others = ({n: f for n, f in some.items() if n not in without} for some in fields_of(request))
    fields = needed | others
    first = [
        inspect.Parameter(n, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=_type_of(f)) for n, f in needed.items()
    ]
    by_name = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=request.model_fields[name].default,
            annotation=_type_of(field),
        )
        for name, field in others.items()
    ]

    def make(values: dict[str, Any]) -> BaseModel:
        return request.of(**values) if issubclass(request, OnMap) else checked(request, values)

    def _asking(method: Callable[..., Answer]) -> Callable[..., Answer]:
        plain = inspect.signature(method)
        own = list(plain.parameters.values())
        at = list(plain.parameters).index("wanted")
        signature = plain.replace(
            parameters=sorted([*own[:at], *first, *by_name, *own[at + 1 :]], key=lambda one: one.kind)
        )

        @wraps(method)
        def _method(*args: Any, **given: Any) -> Answer:
            try:
                bound = signature.bind(*args, **given).arguments
            except TypeError as error:
                raise TypeError(f"{method.__name__}() {error}") from None
            values = {name: bound.pop(name) for name in fields if name in bound}
            return method(**bound, wanted=make(values) if complete else values)

        _method.__signature__ = signature  # type: ignore[attr-defined]
        entries = "\n".join(_described(name, field, needed=name in needed) for name, field in fields.items())
        text, names = inspect.getdoc(method) or "", [one.name for one in own]
        _method.__doc__ = _with_entries(text, names, SHARED | {"wanted": entries})
        return _method

    return _asking


def _described(name: str, field: Field, *, needed: bool) -> str:
    """A field in numpydoc's form."""
    text = textwrap.fill(f"{capital(meaning_of(field))}.", 110, initial_indent="    ", subsequent_indent="    ")
    return f"{name} : {_type_of(field)}{'' if needed else ', optional'}\n{text}"


def _with_entries(text: str, names: Sequence[str], entries: Mapping[str, str]) -> str:
    """A docstring with the entries of the parameters that it does not describe itself, in their order."""
    before, found, after = text.partition(_PARAMETERS)
    if found:
        described, _, rest = after.partition("\n\n")
    else:
        described, at = "", re.search(r"^(Returns|Raises)\n-", text, re.M)
        before, rest = (text[: at.start()], text[at.start() :]) if at else (f"{text}\n\n", "")
    own = {re.split(r"\W", one)[0]: one for one in re.split(r"\n(?=\S)", described)}
    parts = [part for name in names if (part := own.get(name) or entries.get(name))]
    return f"{before}{_PARAMETERS}{chr(10).join(parts)}\n\n{rest}"


def _type_of(field: Field) -> str:
    """The type of a field, in words of Python."""
    value = value_of(field)
    if "python" in field:
        return str(field["python"])
    if is_place(value):
        kind = "Point"
    elif "capacity_wh" in value.get("properties", ()):
        kind = "Battery"
    elif value["type"] == "array":
        kind = f"Sequence[{_type_of(value['items'])}]"
    else:
        kind = _FORMATS.get(value.get("format", "")) or _TYPES[value["type"]]
    return f"{kind} | None" if {"type": "null"} in field.get("anyOf", ()) else kind
