"""What goes over the wire between a client and its service: questions, answers, events, and errors of the tree."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel

from joulemap.model.errors import BusyError, InputError, JoulemapError

Answer = TypeVar("Answer", bound=BaseModel)


class Connection:
    """Connections to a service, which are kept open.

    Parameters
    ----------
    url : str
        Of the service.
    key : str or None
        Where the service wants one.
    timeout_s : float
        Longest time for one answer [s].
    transport : httpx.BaseTransport or None
        How requests are sent; None for the network.

    Raises
    ------
    InputError
        If no request can be sent so.
    """

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
        """Send a request, and return its answer as a model.

        Parameters
        ----------
        model : type
            Of the answer.
        method, path : str
            Of the request.
        **how
            As `httpx.request` takes it.

        Returns
        -------
        BaseModel
            Checked.

        Raises
        ------
        JoulemapError
            As the service says why there is no answer.
        """
        return model.model_validate(self.send(method, path, **how).json())

    def send(self, method: str, path: str, **how: Any) -> httpx.Response:
        """Send a request.

        Parameters
        ----------
        method, path : str
            Of the request.
        **how
            As `httpx.request` takes it.

        Returns
        -------
        Response
            Of a request that succeeded.

        Raises
        ------
        JoulemapError
            As the service says why there is no answer.
        """
        try:
            answer = self._http.request(method, path, **how)
        except httpx.TransportError as error:
            raise self._unreachable(error) from error
        if not answer.is_success:
            raise error_of(document_of(answer.content), answer.status_code)
        return answer

    def _unreachable(self, error: httpx.TransportError) -> BusyError:
        words = str(error) or type(error).__name__
        return BusyError(f"the service at {self.url} does not answer: {words}", url=self.url, unreachable=True)

    def events(self, path: str, body: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Ask a question and follow it, as server-sent events.

        Parameters
        ----------
        path : str
            Of the question, which is posted.
        body : mapping
            The question.

        Yields
        ------
        tuple
            Name and document of each event: ``progress``, and at the end ``answer``.

        Raises
        ------
        JoulemapError
            As the service says why there is no answer.
        """
        try:
            with self._http.stream("POST", path, json=dict(body), headers={"Accept": "text/event-stream"}) as answer:
                if not answer.is_success:
                    raise error_of(document_of(answer.read()), answer.status_code)
                name = ""
                for line in answer.iter_lines():
                    field, _, value = line.partition(": ")
                    if field == "event":
                        name = value
                    elif field == "data" and name == "problem":
                        raise error_of(json.loads(value))
                    elif field == "data":
                        yield name, json.loads(value)
        except httpx.TransportError as error:
            raise self._unreachable(error) from error


def part_of_path(text: str) -> str:
    """Return an id as one part of a path.

    Parameters
    ----------
    text : str
        The id.

    Returns
    -------
    str
        The same.

    Raises
    ------
    InputError
        If it cannot be an id.
    """
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,100}", text) or set(text) == {"."}:
        raise InputError(f"{text[:100]!r} is no id", id=text[:100])
    return text


def document_of(content: bytes) -> dict[str, Any]:
    """Return what an answer says.

    Parameters
    ----------
    content : bytes
        Its body.

    Returns
    -------
    dict
        Empty where it is no JSON object.
    """
    try:
        found = json.loads(content)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def error_of(problem: Mapping[str, Any], status: int | None = None) -> JoulemapError:
    """Return the error of the tree that the service raised. Not every answer is a service's: a proxy's has no code.

    Parameters
    ----------
    problem : mapping
        A problem body, as of RFC 9457.
    status : int, optional
        Of the answer; by default as the body says.

    Returns
    -------
    JoulemapError
        With the words of the service.
    """
    code, detail = problem.get("code"), problem.get("detail")
    context = dict(problem.get("context") or {}) | {"request_id": problem.get("request_id")}
    found = next((cls for cls in tree_of(JoulemapError) if cls.code == code), None)
    number = status if status is not None else int(problem.get("status") or 500)
    if found is None:
        found = InputError if 400 <= number < 500 else BusyError if number in (502, 503, 504) else JoulemapError
    return found(str(detail or f"the service answered {number} without saying why"), **context)


def tree_of(cls: type[JoulemapError]) -> Iterator[type[JoulemapError]]:
    """Yield all errors below one.

    Parameters
    ----------
    cls : type
        Of the error tree.

    Yields
    ------
    type
        Those that are derived from it.
    """
    for child in cls.__subclasses__():
        yield child
        yield from tree_of(child)
