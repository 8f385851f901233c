"""What is wrong with a question, in words: pydantic's findings as HTTP, Python and the client say them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from joulemap.service.problems import MAX_ERRORS, jsonable

BODY = "body"
_THE_BODY = "the body "
_LONGEST_VALUE = 1000  # letters
_NAMED = 5


def findings(errors: Sequence[Mapping[str, Any]]) -> tuple[str, list[dict[str, Any]]]:
    """A sentence, and for each field what is wrong and the value that was given."""
    found = [_field_error(one) for one in errors[:MAX_ERRORS]]
    named = ("" if one["message"].startswith(_THE_BODY) else f"{one['field']}: " for one in found[:_NAMED])
    return "; ".join(f"{name}{one['message']}" for name, one in zip(named, found, strict=False)), found


def _field_error(error: Mapping[str, Any]) -> dict[str, Any]:
    """One of pydantic's findings: which field, what is wrong with it, and the value that was sent."""
    place = [text for part in error["loc"] if not (text := str(part)).startswith("function-")] or [BODY]  # of pydantic
    if error["type"] == "json_invalid":  # the second part of the place is the character
        reason = str(error.get("ctx", {}).get("error", error["msg"]))
        return {"field": BODY, "message": f"{_THE_BODY}is no valid JSON: {reason} at character {place[-1]}"}
    if place == [BODY] and error["type"] in ("model_attributes_type", "model_type", "dict_type"):
        return {"field": BODY, "message": f"{_THE_BODY}must be a JSON object with Content-Type: application/json"}
    field = ".".join(place[1:] or place)  # the first says where: body, query, path, header, or a form field
    message = str(error["msg"]).removeprefix("Value error, ")
    if error["type"] == "too_short" and "ctx" in error:
        message = "give at least {min_length}; {actual_length} are given".format(**error["ctx"])
    found = {"field": jsonable(field), "message": jsonable(message)}
    if error["type"] != "missing" and "input" in error:
        found["value"] = _shown(error["input"])
        ours = error["type"] in ("value_error", "unknown_field")  # these words name the value where it matters
        if not ours and isinstance(error["input"], (int, float, str)) and not isinstance(error["input"], bool):
            found["message"] = f"{found['message']}, got {str(jsonable(error['input']))[:60]}"
    return found


def _shown(value: Any) -> Any:
    """A value as it was sent, or the beginning of its text where that is long: a problem may have many of them."""
    shown = jsonable(value, depth=2)
    text = json.dumps(shown)
    return shown if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."
