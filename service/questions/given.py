"""What Python users give, as the values of a request, and checked as HTTP checks a body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import PurePath
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.service.problems import BODY, findings

Model = TypeVar("Model", bound=BaseModel)
_REGISTERED = ("planner", "architecture")
"""Fields that name what a Python user may register too; an unknown name is refused where it is looked up."""


def plain(value: Any) -> Any:
    """A value as JSON has it: tuples and arrays as lists, a battery as its fields, a model as its folder."""
    if isinstance(value, Battery):
        return {name: plain(one) for name, one in asdict(value).items() if one is not None}
    if isinstance(value, BaseModel):
        return value.model_dump(exclude_unset=True)
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, PurePath) or hasattr(value, "folder"):
        return str(getattr(value, "folder", value))
    if hasattr(value, "tolist"):
        heights = getattr(value, "ndim", 0) == 2 and value.shape[1] == 3  # of places: NaN where unknown, not used
        return (value[:, :2] if heights else value).tolist()
    if isinstance(value, str) or not isinstance(value, Iterable):
        return value
    return [plain(one) for one in value]


def checked(request: type[Model], values: Mapping[str, Any]) -> Model:
    """The request with these values.

    How many points and areas there may be is left to who answers, as that limit protects a service that many share; so
    are names that can be registered.
    """
    given = {name: plain(value) for name, value in values.items()}
    try:
        return request.model_validate(given)
    except ValidationError as error:
        wrong = [one for one in error.errors(include_url=False) if one["type"] != "too_long" and not _registered(one)]
        if not wrong:
            return request.model_construct(**given)
        words, found = findings([{**one, "loc": (BODY, *one["loc"])} for one in wrong])
        raise InputError(words, errors=found) from None


def _registered(error: Mapping[str, Any]) -> bool:
    return error["type"] == "literal_error" and error["loc"][-1] in _REGISTERED and isinstance(error["input"], str)


def battery_with(battery: Any, **state: Any) -> dict[str, Any] | None:
    """A battery with what is said of it beside it; what both say must be the same. Result: None if nothing is said."""
    values = plain(battery) or {}
    for name, value in state.items():
        if value is None:
            continue
        if values.get(name) not in (None, value):
            raise InputError(f"`{name}` is {value}, and `battery` says {values[name]}: say it once", key=name)
        values[name] = value
    return values or None
