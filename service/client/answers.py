"""What an answer means: a model, or an error of the tree. Not every answer is a service's: a proxy has its own."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from joulemap.model.errors import BusyError, InputError, JoulemapError
from joulemap.service.problems import TABLE

Answer = TypeVar("Answer", bound=BaseModel)

_LATER = (408, 425, 502, 504)  # beside 503, which is in the table
_PAGE = "text/html"
_SHOWN = 200  # characters of what somebody else wrote


def answer_of(model: type[Answer], answer: httpx.Response) -> Answer:
    """Return an answer as a model."""
    try:
        return model.model_validate(json.loads(answer.content))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the document"
        raise stranger(answer, f"{place}: {first['msg']}") from error
    except (ValueError, RecursionError) as error:
        raise stranger(answer, f"{_kind(answer)} and no JSON") from error


def refuse_failed(answer: httpx.Response) -> None:
    """Refuse an answer that says why there is none, and one that a service never sends."""
    if answer.has_redirect_location:
        to = answer.headers["location"][:_SHOWN]
        raise InputError(
            f"{_place(answer)} sends requests on to {to}: give the address of the service itself, and check whether a "
            "proxy in front of it wants a login",
            url=_place(answer),
            location=to,
        )
    if not answer.is_success:
        found = document_of(answer.content)
        if "code" not in found:
            found = {"context": {"status": answer.status_code}, "detail": _unexplained(answer, found)}
        found["context"] = _waiting_time(answer) | _mapping(found.get("context"))
        raise error_of(found, answer.status_code)
    if _kind(answer) == _PAGE:
        raise stranger(answer, "a web page")


def stranger(answer: httpx.Response, what: str) -> InputError:
    """Return the error of an answer that is not a service's."""
    return InputError(
        f"{_place(answer)} sent something that is no answer of a joulemap service ({what}): check its address, and "
        "whether a proxy in front of it wants a login",
        url=_place(answer),
    )


def _unexplained(answer: httpx.Response, document: Mapping[str, Any]) -> str:
    """What is known of a failure that no service explains. document : the body, where it is a JSON object."""
    status = answer.status_code
    phrase = HTTPStatus(status).phrase if status in list(HTTPStatus) else "no status of HTTP"
    words = next((document[key] for key in ("detail", "message", "error") if isinstance(document.get(key), str)), None)
    said = "without saying why" if words is None else f"and says {words[:_SHOWN]!r}"
    return f"{_place(answer)} answered {status} ({phrase}) {said}: it may come from a proxy in front of the service"


def _place(answer: httpx.Response) -> str:
    return str(answer.request.url.copy_with(query=None))[:_SHOWN]


def _kind(answer: httpx.Response) -> str:
    return answer.headers.get("content-type", "").partition(";")[0].strip().lower() or "no media type"


def _waiting_time(answer: httpx.Response) -> dict[str, float]:
    """Retry-After in seconds; a date is left out."""
    seconds = answer.headers.get("retry-after", "")
    return {"retry_after_s": float(seconds)} if seconds.isascii() and seconds.isdigit() else {}


def _mapping(value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else {}


def document_of(content: bytes) -> dict[str, Any]:
    """Return what an answer says."""
    try:
        found = json.loads(content)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def error_of(problem: Mapping[str, Any], status: int | None = None) -> JoulemapError:
    """Return the error of the tree that the service raised."""
    code, detail = problem.get("code"), problem.get("detail")
    context = _mapping(problem.get("context")) | {"request_id": problem.get("request_id")}
    context.pop("message", None)  # which every error has already
    given = problem.get("status") if status is None else status
    number = given if isinstance(given, int) else 500
    found = next((cls for cls in tree_of(JoulemapError) if cls.code == code), None) or _error_of_status(number)
    return found(str(detail or f"the service answered {number} without saying why"), **context)


def _error_of_status(status: int) -> type[JoulemapError]:
    """The branch of the tree that is answered so, the first of several; 500 says nothing without a code."""
    if status == HTTPStatus.INTERNAL_SERVER_ERROR:
        return JoulemapError
    named = next((cls for cls, row in TABLE.items() if row.status == status), None)
    if named is not None:
        return named
    return BusyError if status in _LATER else InputError if 400 <= status < 500 else JoulemapError


def tree_of(cls: type[JoulemapError]) -> Iterator[type[JoulemapError]]:
    """Yield all errors below one."""
    for child in cls.__subclasses__():
        yield child
        yield from tree_of(child)
