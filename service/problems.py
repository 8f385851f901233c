"""The one table from errors to HTTP statuses and exit codes, RFC 9457 problem bodies, pydantic's findings in words."""

from __future__ import annotations

import errno
import json
import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from joulemap.model.errors import (
    BusyError,
    ConflictError,
    DamagedError,
    ForbiddenError,
    InfeasibleError,
    InputError,
    JoulemapError,
    NotFoundError,
    RateError,
    StorageFullError,
    TooLargeError,
    UnauthorizedError,
)

MEDIA_TYPE = "application/problem+json"
INTERNAL_EXIT_CODE = 1
_MAX_TEXT = 500
MAX_ERRORS = 20
"""Most items of a list, and most invalid fields, that a problem names."""
_RETRY_S = 5.0  # a database that restarts
_MAX_ITEMS = 200
_PLACE = re.compile(r"(?<![\w./-])/+([\w.-]+)/(?:[^\s/'\",;:()\[\]{}<>]+/+)*([^\s/'\",;:()\[\]{}<>]*)")


class Row(NamedTuple):
    """How one branch of the error tree is answered.

    Attributes
    ----------
    status : int
        HTTP status.
    exit_code : int
        Of the command line.
    title : str
        Of the problem body.
    """

    status: int
    exit_code: int
    title: str


TABLE: dict[type[JoulemapError], Row] = {
    InputError: Row(422, 3, "The input cannot be used"),
    InfeasibleError: Row(422, 4, "The question has no answer"),
    NotFoundError: Row(404, 5, "There is no such thing"),
    ConflictError: Row(409, 6, "The request contradicts what is stored"),
    TooLargeError: Row(413, 7, "Too large"),
    BusyError: Row(503, 8, "Come back later"),
    UnauthorizedError: Row(401, 9, "A key is needed"),
    ForbiddenError: Row(403, 10, "Not allowed"),
    RateError: Row(429, 11, "Too many at once"),
    StorageFullError: Row(507, 12, "No room to keep more"),
    DamagedError: Row(503, 13, "What was kept is damaged"),
}
"""By branch of the tree; a leaf is answered as its nearest branch. Exit code 2 means wrong usage of a command."""


def row_of(error: type[JoulemapError]) -> Row | None:
    """Return the row of an error class: that of its nearest ancestor in the table.

    Result: None where no ancestor is in the table.
    """
    return next((TABLE[cls] for cls in error.__mro__ if cls in TABLE), None)


def exit_code(error: BaseException) -> int:
    """Return the exit code of a command that ended with an error.

    Result: the table's code; 1 for anything outside the error tree, which is our bug.
    """
    row = row_of(type(error)) if isinstance(error, JoulemapError) else None
    return row.exit_code if row is not None else INTERNAL_EXIT_CODE


def jsonable(value: Any, *, depth: int = 6) -> Any:
    """Return a value as plain JSON."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, str):
        text = without_places(value.encode("utf-8", "replace").decode("utf-8"))
        return text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + "..."
    if depth > 0 and isinstance(value, Mapping):
        first = islice(value.items(), _MAX_ITEMS)
        kept = {str(key)[:_MAX_TEXT]: jsonable(item, depth=depth - 1) for key, item in first}
        return kept | ({"...": f"{len(value)} in all"} if len(value) > _MAX_ITEMS else {})
    if depth > 0 and isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (bytes, bytearray)):
        items = [jsonable(item, depth=depth - 1) for item in list(value)[:MAX_ERRORS]]
        return [*items, f"... {len(value)} in all"] if len(value) > MAX_ERRORS else items
    return without_places(repr(value))[:_MAX_TEXT]


def without_places(text: str) -> str:
    """Return a text in which each path of this machine is its last part alone."""
    return _PLACE.sub(lambda found: found[2] if found[1] in _top_folders() else found[0], text)


@cache
def _top_folders() -> frozenset[str]:
    """The folders at the root of this machine, and those that GDAL has in memory: `/v1/costmaps` begins with none."""
    return frozenset({each.name for each in Path("/").iterdir() if each.is_dir()} | {"vsimem", "vsizip", "vsigzip"})


def problem(
    status: int, code: str, title: str, detail: str, request_id: str | None, context: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return an RFC 9457 problem body, with the extensions code, request_id and context."""
    return {
        "type": f"urn:joulemap:problem:{code}",
        "title": title,
        "status": status,
        "detail": jsonable(detail),
        "code": code,
        "request_id": request_id,
        "context": jsonable(dict(context or {})),
    }


def problem_of(error: BaseException, request_id: str | None = None) -> dict[str, Any]:
    """Return the problem body of an exception."""
    error = from_outside(error) or error
    row = row_of(type(error)) if isinstance(error, JoulemapError) else None
    if row is None or not isinstance(error, JoulemapError):
        detail = "something went wrong inside the service; its log has the details under this request id"
        return problem(500, "internal_error", "Internal error", detail, request_id)
    return problem(row.status, error.code, row.title, error.message, request_id, error.context)


def no_database() -> BusyError:
    """Return the error of a request for which the database does not answer."""
    return BusyError("the database does not answer", retry_after_s=_RETRY_S)


def from_outside(error: BaseException) -> JoulemapError | None:
    """Return what is neither the caller's fault nor ours: a full disk, a database that does not answer.

    Result: the same in words; None for another error.
    """
    from sqlalchemy.exc import OperationalError  # loads slowly, and commands that answer have no database
    from sqlalchemy.exc import TimeoutError as SQLAlchemyTimeout

    if isinstance(error, SQLAlchemyTimeout):
        return BusyError("the database has more questions than it can answer", retry_after_s=_RETRY_S)
    if isinstance(error, OperationalError):
        if "disk is full" in str(error.orig):
            return StorageFullError("the disk of the database is full: nothing more can be kept")
        return no_database()
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StorageFullError("the disk is full: nothing more can be kept")
    if isinstance(error, OSError) and error.errno == errno.EHOSTUNREACH:
        return BusyError(str(error.strerror), retry_after_s=_RETRY_S)
    return None


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
