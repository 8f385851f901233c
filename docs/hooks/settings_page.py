"""The reference of the service's settings, from the class that reads them."""

from __future__ import annotations

import json
from typing import Any

_INTRO = """# Settings of the service

`joulemap serve` reads its settings from the environment. Options of the command line come first.

| variable | default | meaning |
| --- | --- | --- |
"""


def settings_page() -> str:
    """A table of every environment variable, its default and its meaning."""
    from joulemap.service.hosting.settings import Settings

    rows = (
        f"| `JOULEMAP_{name.upper()}` | {_default(field.default)} | {field.description} |"
        for name, field in Settings.model_fields.items()
    )
    return _INTRO + "\n".join(rows) + "\n"


def _default(value: Any) -> str:
    if value is None:
        return ""
    return f"`{json.dumps(list(value))}`" if isinstance(value, tuple) else f"`{value}`"
