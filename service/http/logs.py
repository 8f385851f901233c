"""What the service writes to its log: a line per request, each line with the id of its request, as text or JSON."""

from __future__ import annotations

import json
import logging
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any, Literal

REQUEST_ID: ContextVar[str | None] = ContextVar("request_id", default=None)
"""Of the request that this task, or a thread that works for it, answers."""

ACCESS = logging.getLogger("joulemap.access")
_TEXT = "%(asctime)s %(levelname)-8s %(name)s [%(request_id)s] %(message)s"


class WithRequestId(logging.Filter):
    """Gives each record the id of the request at hand, or ``-``."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Add `request_id`.

        Parameters
        ----------
        record : LogRecord
            Is changed.

        Returns
        -------
        bool
            True: every record stays.
        """
        record.request_id = REQUEST_ID.get() or "-"
        return True


class JsonLines(logging.Formatter):
    """A record as a line of JSON: `time` (UTC), `level`, `logger`, `message`, `request_id`, and fields of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line.

        Parameters
        ----------
        record : LogRecord
            The record.

        Returns
        -------
        str
            JSON without a line break.
        """
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


def log_config(kind: Literal["text", "json"]) -> dict[str, Any]:
    """Return the configuration of the log for uvicorn, which then writes no line per request of its own.

    Parameters
    ----------
    kind : {"text", "json"}
        Form of a line.

    Returns
    -------
    dict
        For `logging.config.dictConfig`.
    """
    here = __name__
    formatter = {"()": f"{here}.JsonLines"} if kind == "json" else {"format": _TEXT}
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "filters": {"request": {"()": f"{here}.WithRequestId"}},
        "formatters": {"line": formatter},
        "handlers": {
            "stderr": {
                "class": "logging.StreamHandler",
                "formatter": "line",
                "filters": ["request"],
                "stream": "ext://sys.stderr",
            }
        },
        "root": {"handlers": ["stderr"], "level": "WARNING"},
        "loggers": {
            "joulemap": {"level": "INFO"},
            "uvicorn": {"level": "INFO"},
            "uvicorn.access": {"level": "WARNING"},
        },
    }
