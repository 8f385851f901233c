"""Former names of keys in report.json and in the answer of `suggest-drive`, written beside today's. Removed in 0.3."""

from __future__ import annotations

from typing import Any

FORMER_KEYS = {
    "test_set": "kept_aside",
    "confounded_with": "tells_from",
}
"""Key today -> the key of versions before 0.2."""


def with_former_keys(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document that has its renamed values under their former keys too."""
    out = {key: with_former_keys(value) if isinstance(value, dict) else value for key, value in document.items()}
    return out | {former: out[key] for key, former in FORMER_KEYS.items() if key in out}
