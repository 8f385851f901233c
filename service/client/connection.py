"""What goes over the wire between a client and its service, and what answers mean: a proxy has its own, too."""

from __future__ import annotations

import json
import re
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


_STREAM = "text/event-stream"


class Connection:
    """Connections to a service, which are kept open. `transport`: how requests are sent, None for the network."""

    def __init__(self, url: str, *, key: str | None, timeout_s: float, transport: httpx.BaseTransport | None) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        self.url = url.rstrip("/")
        try:
            self._http = httpx.Client(base_url=self.url, headers=headers, timeout=timeout_s, transport=transport)
        except (httpx.InvalidURL, UnicodeEncodeError) as error:
            raise InputError(f"{url[:100]!r} with this key cannot be asked: {error}", url=url[:100]) from error

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def ask(self, model: type[Answer], method: str, path: str, **how: Any) -> Answer:
        """Send a request, and return its answer as a model."""
        return answer_of(model, self.send(method, path, **how))

    def send(self, method: str, path: str, **how: Any) -> httpx.Response:
        """Send a request."""
        try:
            answer = self._http.request(method, path, **how)
        except (httpx.RequestError, httpx.InvalidURL) as error:
            raise self._without_answer(error) from error
        refuse_failed(answer)
        return answer

    def _without_answer(self, error: httpx.RequestError | httpx.InvalidURL) -> JoulemapError:
        words = str(error) or type(error).__name__
        if isinstance(error, (httpx.InvalidURL, httpx.UnsupportedProtocol)):
            return InputError(f"{self.url[:100]!r} is no address like http://HOST:8000: {words}", url=self.url[:100])
        return BusyError(f"the service at {self.url} does not answer: {words}", url=self.url)

    def events(self, path: str, body: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Ask a question and follow it, as server-sent events.

        Yields: name and document of each event: ``progress``, and at the end ``answer``.
        """
        try:
            with self._http.stream("POST", path, json=dict(body), headers={"Accept": _STREAM}) as answer:
                if not answer.headers.get("content-type", "").startswith(_STREAM):
                    answer.read()
                    refuse_failed(answer)
                    raise stranger(answer, "no events")
                name = ""
                for line in answer.iter_lines():
                    field, _, value = line.partition(": ")
                    if field == "event":
                        name = value
                    elif field == "data" and name == "problem":
                        raise error_of(json.loads(value))
                    elif field == "data":
                        yield name, json.loads(value)
        except (httpx.RequestError, httpx.InvalidURL) as error:
            raise self._without_answer(error) from error
        except json.JSONDecodeError as error:
            raise stranger(answer, "an event that is no JSON") from error


def part_of_path(text: str) -> str:
    """Return an id as one part of a path."""
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,100}", text) or set(text) == {"."}:
        raise InputError(f"{text[:100]!r} is no id", id=text[:100])
    return text
