"""What goes over the wire between a client and its service: questions, answers and events."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import httpx

from joulemap.model.errors import BusyError, InputError, JoulemapError
from joulemap.service.client.answers import Answer, answer_of, error_of, refuse_failed, stranger

_EVENTS = "text/event-stream"


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
            with self._http.stream("POST", path, json=dict(body), headers={"Accept": _EVENTS}) as answer:
                if not answer.headers.get("content-type", "").startswith(_EVENTS):
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
