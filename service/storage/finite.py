"""JSON of the database: a number that is not finite is null there, and a damaged text harms its own row alone."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NoReturn

from joulemap.model.errors import DamagedError


def dumps(value: Any) -> str:
    """Return a value as JSON."""
    try:
        return json.dumps(value, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(value), allow_nan=False)


class Damaged(Mapping[str, Any]):
    """Stands for a text that is no JSON: who looks into it gets the error, and who reads only other columns none."""

    def __init__(self, why: str) -> None:
        self._why = why

    def _fail(self, *_: object) -> NoReturn:
        raise DamagedError(f"what the database has of it is no JSON: {self._why}", file="joulemap.db")

    __getitem__ = __iter__ = __len__ = _fail


def loads(text: str) -> Any:
    """Return what a text of the database says."""
    try:
        return json.loads(text)
    except ValueError as error:
        return Damaged(str(error))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
