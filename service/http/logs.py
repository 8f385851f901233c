"""What the service writes to its log: a line per request, each line with the id of its request, as text or JSON."""

from __future__ import annotations

import json
import logging
import threading
from contextlib import suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from logging.handlers import QueueHandler
from queue import Full, Queue
from typing import Any, Literal

REQUEST_ID: ContextVar[str | None] = ContextVar("request_id", default=None)
"""Of the request that this task, or a thread that works for it, answers."""

ACCESS = logging.getLogger("joulemap.access")
_MOST_WAITING = 10_000  # lines; from then on, who logs waits until some are written
_LAST_S = 2.0  # for the last lines when the service ends
_ESCAPED = {k: f"\\x{k:02x}" for k in (*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029)}
_TEXT = "%(asctime)s %(levelname)-8s %(name)s [%(request_id)s] %(message)s"


class WithRequestId(logging.Filter):
    """Gives each record the id of the request at hand, or ``-``."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Add `request_id`."""
        record.request_id = REQUEST_ID.get() or "-"
        return True


class TextLines(logging.Formatter):
    """A record as a line of text. A request decides no line but its own: control characters are escaped."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line without exceptions, which are the program's own.

        Result: without line breaks or other control characters.
        """
        return super().formatMessage(record).translate(_ESCAPED)


class JsonLines(logging.Formatter):
    """A record as a line of JSON: `time` (UTC), `level`, `logger`, `message`, `request_id`, and fields of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "request_id": getattr(record, "request_id", None),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


class WrittenByAThread(QueueHandler):
    """Leaves lines to a thread: standard error may be a pipe, and the event loop does not wait for its reader."""

    def __init__(self, kind: Literal["text", "json"]) -> None:
        self._lines: Queue[logging.LogRecord | None] = Queue(_MOST_WAITING)
        super().__init__(self._lines)
        self.addFilter(WithRequestId())
        self._writer = logging.StreamHandler()
        self._writer.setFormatter(JsonLines() if kind == "json" else TextLines(_TEXT))
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """Return the record as it is: it is formatted where it is written."""
        return record

    def enqueue(self, record: logging.LogRecord) -> None:
        """Leave a record to the thread."""
        self._lines.put(record)

    def close(self) -> None:
        """Write what waits, and end the thread; Python does it at its end. A reader that has stopped is left."""
        with suppress(Full):
            self._lines.put(None, timeout=_LAST_S)
        self._thread.join(_LAST_S)
        super().close()

    def _write(self) -> None:
        for record in iter(self._lines.get, None):
            self._writer.handle(record)


def log_config(kind: Literal["text", "json"]) -> dict[str, Any]:
    """Return the configuration of the log for uvicorn, which then writes no line per request of its own."""
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "handlers": {"stderr": {"()": f"{__name__}.WrittenByAThread", "kind": kind}},
        "root": {"handlers": ["stderr"], "level": "WARNING"},
        "loggers": {
            "joulemap": {"level": "INFO"},
            "uvicorn": {"level": "INFO"},
            "uvicorn.access": {"level": "WARNING"},
        },
    }
