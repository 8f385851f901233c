"""The fields of a request as JSON Schema describes them, for the faces that read them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from joulemap.service.questions.parts import OnMap
from joulemap.service.schemas.base import InPython

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
