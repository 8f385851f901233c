"""What all requests and answers are made from: strictness, points, robots, problems, jobs."""

from __future__ import annotations

import datetime as dt
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, NamedTuple, Self, get_type_hints

import numpy as np
from annotated_types import Interval
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from joulemap.model.errors import nearest_name
from joulemap.model.ranges import COORDINATE_M, LONGEST_NAME, NAME_PATTERN, ROBOT, Range
from joulemap.model.robot import Robot


class InPython(NamedTuple):
    """Marks a field whose type has other words in Python; without words, one that only HTTP has."""

    words: str = ""


class WholeMap(NamedTuple):
    """Marks a field that no planner takes which leaves its cost map on disk."""


UNKNOWN_FIELD = "unknown_field"
"""The type of pydantic's finding for a field that a request does not have."""
_MOST_UNKNOWN = 100
"""An object with more fields than it can have, and so many beyond, is refused as a whole."""


class ClosedModel(BaseModel):
    """A model that refuses unknown fields and names the known field that is nearest."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    @model_validator(mode="wrap")
    @classmethod
    def _name_the_nearest(cls, values: Any, check: ModelWrapValidatorHandler[Self]) -> Self:
        if isinstance(values, Mapping) and len(values) > len(cls.model_fields) + _MOST_UNKNOWN:
            raise PydanticCustomError(
                "too_many_fields",
                "an object of {count} fields; it has at most {limit}",
                {"count": len(values), "limit": len(cls.model_fields)},
            )
        try:
            return check(values)
        except ValidationError as error:
            found = error.errors(include_url=False)
            if not any(_is_unknown(one) for one in found):
                raise
            raise ValidationError.from_exception_data(error.title, [cls._said(one) for one in found]) from error

    @classmethod
    def _said(cls, found: Mapping[str, Any]) -> InitErrorDetails:
        """A finding as it was, but for unknown fields of this model."""
        finding = PydanticCustomError(found["type"], found["msg"])
        if _is_unknown(found):
            near = nearest_name(str(found["loc"][0]), cls.model_fields)
            hint = f"did you mean {near}?" if near else f"known are {', '.join(cls.model_fields)}"
            finding = PydanticCustomError(UNKNOWN_FIELD, f"unknown field; {hint}")
        return InitErrorDetails(type=finding, loc=found["loc"], input=found["input"])


def _is_unknown(found: Mapping[str, Any]) -> bool:
    return found["type"] == "extra_forbidden" and len(found["loc"]) == 1


class Request(ClosedModel):
    """A strict model: unknown fields, numbers in quotes, NaN and infinity are refused."""

    model_config = ConfigDict(strict=True)


class ResponseModel(BaseModel):
    """An answer: it has the fields of the schema and no others."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


def like(kind: type, *without: str, **nested: type) -> Any:
    """Return the base of an answer with the attributes of a value object, and what its docstring says of each.

    `nested`: answers in place of other value objects, by their names.
    """
    kinds = {name: one for name, one in get_type_hints(kind, localns=nested).items() if name not in without}
    words: dict[str, str] = {}
    described = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2].partition("\n\n")[0]
    for names, text in re.findall(r"^(\S.*?) :.*\n((?:    .*\n?)+)", described, re.M):
        said = " ".join(text.split()).rstrip(".").replace("None", "null")
        words |= dict.fromkeys(names.split(", "), said[:1].lower() + said[1:])
    fields: dict[str, Any] = {name: (one, Field(description=words.get(name))) for name, one in kinds.items()}
    return create_model(kind.__name__, __base__=ResponseModel, **fields)


def within(allowed: Range) -> Interval:
    """Return the bounds of a range as a type's annotation."""
    return Interval(ge=allowed.low, le=allowed.high)


Coordinate = Annotated[float, within(COORDINATE_M)]
FilePlace = Annotated[str, Field(json_schema_extra={"format": "path"})]
Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=NAME_PATTERN)]
Point = Annotated[
    list[Coordinate],
    Field(
        min_length=2, max_length=3, description="world [x, y] in the map's CRS [m], x east and y north; z is ignored"
    ),
]
PathPoint = Annotated[
    list[Coordinate | None],
    Field(min_length=2, max_length=3, description="world x, y or x, y, z [m]; z, which may be null, is ignored"),
]


class LatLon(Request):
    """A place on Earth, WGS 84."""

    lat: float = Field(ge=-90.0, le=90.0, description="latitude [degrees]", examples=[36.72])
    lon: float = Field(ge=-180.0, le=180.0, description="longitude [degrees]", examples=[-4.49])


class _OrLatLon:
    """Accepts an object with `lat` and `lon` in the place of what is annotated, and leaves it as it is."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        def _either(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
            return LatLon.model_validate(value).model_dump() if isinstance(value, Mapping) else check(value)

        return core_schema.no_info_wrap_validator_function(
            _either,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda value: value),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [handler(schema["schema"]), handler(LatLon.__pydantic_core_schema__)]}


_DEGREES = (
    "or latitude, longitude [degrees], where that is on the map and the numbers are not, which a warning says; or an "
    "object with `lat` and `lon`"
)
Place = Annotated[
    Point,
    _OrLatLon(),
    Field(description=f"world [x, y] in the map's CRS [m], x east and y north, z is ignored; {_DEGREES}"),
]
PathPlace = Annotated[
    PathPoint,
    _OrLatLon(),
    Field(description=f"world x, y or x, y, z [m]; z, which may be null, is ignored; {_DEGREES}"),
]
Areas = Annotated[
    list[Annotated[list[Place], Field(min_length=3, max_length=10_000, fail_fast=True)]],
    Field(
        max_length=100,
        description="areas that no route may touch: the corners of each, world x, y [m]; their cells are blocked "
        "with the reason `avoid`",
        examples=[[[[20.0, 20.0], [30.0, 20.0], [30.0, 35.0]]]],
    ),
]
_MANY, _SLICE = 32, 4_000  # points
_MOST_FLAGS = 1_000


def quick_points(points: Any, validate: Callable[[Any], Any]) -> Any:
    """Check many points as an array, in a quarter of the time; what is no array of points goes one by one."""
    if not isinstance(points, list) or len(points) < _MANY:
        return validate(points)
    try:  # in slices, because no other thread runs during one call
        slices = [np.asarray(points[at : at + _SLICE]) for at in range(0, len(points), _SLICE)]
        array = np.concatenate(slices)
    except ValueError:  # of several lengths
        return validate(points)
    if array.ndim != 2 or array.shape[1] not in (2, 3) or array.dtype.kind not in "fi":
        return validate(points)
    inside = bool(((array >= COORDINATE_M.low) & (array <= COORDINATE_M.high)).all())
    flags = np.argwhere((array == 0) | (array == 1))  # among them true and false, which are no numbers here
    if not inside or len(flags) > _MOST_FLAGS or any(isinstance(points[row][col], bool) for row, col in flags):
        return validate(points)
    return array.astype(np.float64, copy=False)


GivenPath = Annotated[list[PathPlace], Field(fail_fast=True), WrapValidator(quick_points)]
Point3 = Annotated[
    list[float | None], Field(min_length=3, max_length=3, description="world x, y, z [m]; z null where unknown")
]

_ROBOT_WORDS = {
    "name": "name of the robot",
    "mass_kg": "mass [kg]",
    "width_m": "width over the wheels [m]",
    "length_m": "length [m]",
    "wheel_radius_m": "wheel radius [m]; a higher step is blocked",
    "nominal_voltage_v": "nominal battery voltage [V]",
    "speed_mps": "cruising speed [m/s]",
    "battery_wh": "energy of the full battery [Wh]",
    "idle_power_w": "power of everything except the motion [W]",
    "max_grade_deg": "steepest slope along the motion that is allowed, up and down [deg]",
    "max_cross_slope_deg": "steepest slope across the motion that is allowed [deg]",
    "rolling_resistance": "coefficient of rolling resistance, dimensionless",
    "drivetrain_efficiency": "share of the battery's energy that lifts the robot on a climb, 0.1..1; 0: not known",
    "regeneration": "share of the energy released downhill that returns to the battery, 0..0.99",
    "turn_j_per_rad": "energy of turning, per radian [J/rad]",
    "tracking_std_m": "standard deviation of how far beside its path the robot drives [m]; 0: paths keep no margin",
    "clearance_m": "least distance between the robot's outline and every obstacle [m]",
    "centre_ahead_m": "how far the middle of its outline lies ahead of the point that follows the route [m]",
    "min_turning_radius_m": "radius of the tightest curve that it drives [m]; 0: it turns on the spot",
    "gravity_mps2": "gravity where it drives [m/s2]; 1.62 on the Moon, 3.71 on Mars",
}
_KIND: dict[str, Any] = {f.name: str if f.name == "name" else float for f in fields(Robot)}
_KIND_IN: dict[str, Any] = {key: Annotated[float, within(allowed)] for key, allowed in ROBOT.items()} | {"name": Name}

RobotIn = create_model(  # type: ignore[call-overload]
    "RobotIn",
    __base__=Request,
    __doc__="A robot. A field that is left out has the default robot's value, or in a question the cost map's.",
    **{
        key: (
            _KIND_IN[key] | None,
            Field(default=None, description=_ROBOT_WORDS[key], examples=[getattr(Robot(), key)]),
        )
        for key in _KIND
    },
)
RobotOut = create_model(  # type: ignore[call-overload]
    "RobotOut",
    __base__=ResponseModel,
    __doc__="The robot that prices and limits belong to.",
    **{
        key: (kind, Field(description=_ROBOT_WORDS[key], examples=[getattr(Robot(), key)]))
        for key, kind in _KIND.items()
    },
)


def robot_values(robot: BaseModel | None) -> dict[str, Any]:
    """Return the fields of a robot that a request gave."""
    return robot.model_dump(exclude_none=True) if robot is not None else {}


class Problem(BaseModel):
    """RFC 9457 problem details."""

    type: str = Field(examples=["urn:joulemap:problem:blocked"])
    title: str = Field(examples=["The question has no answer"])
    status: int = Field(examples=[422])
    detail: str = Field(examples=["start (3, 4) is on blocked ground: step"])
    code: str = Field(description="short name of the error", examples=["blocked"])
    request_id: str | None = Field(examples=["3f9c1a7be2d04c55"])
    context: dict[str, Any] = Field(
        description="the value that was refused, and the limit", examples=[{"reason": "step"}]
    )


class UnreadableOut(ResponseModel):
    """Something that is kept, but cannot be shown: an older version stored values that are not valid."""

    id: str
    created_at: dt.datetime = Field(description="UTC")
    problem: Problem = Field(description="what is not valid")


class PlaceOut(ResponseModel):
    """A place on the way, where something happens."""

    distance_m: float = Field(description="from the start; over both ways of a round trip [m]")
    time_s: float = Field(description="from the start, at the robot's speed [s]")
    x: float = Field(description="[m]")
    y: float = Field(description="[m]")


class JobOut(ResponseModel):
    """A job that waits, runs, is done, has failed, or was cancelled."""

    id: str
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    progress: float = Field(ge=0, le=1, description="share that is done, 0..1", examples=[1.0])
    created_at: dt.datetime = Field(description="UTC")
    finished_at: dt.datetime | None = Field(description="UTC")
