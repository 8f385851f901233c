"""JSON of the database, with a checksum: a damaged text harms its own row alone. What is not finite is null there."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from typing import Any, NoReturn

from joulemap.model.errors import DamagedError

_SUM = "crc32"
"""Last member of an object; a list has an object with it as its last item. Versions before 0.2 wrote none."""


def dumps(value: Any) -> str:
    """Return a value as JSON."""
    try:
        text = json.dumps(value, allow_nan=False)
    except ValueError:
        text = json.dumps(_finite(value), allow_nan=False)
    if not isinstance(value, Mapping | list | tuple):
        return text
    own = f'"{_SUM}": {_sum(text)}'
    return f"{text[:-1]}{', ' if value else ''}{own if isinstance(value, Mapping) else f'{{{own}}}'}{text[-1]}"


class Damaged(Mapping[str, Any]):
    """Stands for a text that is damaged: who looks into it gets the error, and who reads only other columns none."""

    def __init__(self, why: str) -> None:
        self._why = why

    def _fail(self, *_: object) -> NoReturn:
        raise DamagedError(f"what the database has of it is damaged: {self._why}", file="joulemap.db")

    __getitem__ = __iter__ = __len__ = _fail


def loads(text: str) -> Any:
    """Return what a text of the database says."""
    try:
        value = json.loads(text)
    except ValueError as error:
        return Damaged(f"it is no JSON: {error}")
    if isinstance(value, dict):
        kept = value.pop(_SUM, None)
    else:
        last = isinstance(value, list) and value and isinstance(value[-1], dict) and value[-1].keys() == {_SUM}
        kept = value.pop()[_SUM] if last else None
    return value if kept in (None, _sum(json.dumps(value))) else Damaged("it is not what was written")


def _sum(text: str) -> int:
    return zlib.crc32(text.encode())


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
