"""What a cost map is made of: cells and headings, the robot, the model, and what is known of the ground."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from joulemap.model.ranges import HEADINGS, SPACING_M
from joulemap.model.terrain.layers.kinds import MOST_FACTOR, MOST_KINDS, MOST_RESISTANCE
from joulemap.model.terrain.layers.layer import COST, FACTOR, LIMITS, ROLES
from joulemap.planner.lattice.build import DEFAULT_HEADINGS
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.schemas.base import InPython, Request, RobotIn, within

LayerRole = Literal["kinds", "obstacles", "free", "factor", "cost", "height"]


StoredValue = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
"""A value of a raster, which has at most 32 bits."""


class KindIn(Request):
    """What a kind of ground costs: one of `rolling_resistance` and `factor`, or nothing where it is `blocked`."""

    rolling_resistance: float | None = Field(
        default=None, ge=0.0, le=MOST_RESISTANCE, description="in place of the robot's own", examples=[0.06]
    )
    factor: float | None = Field(
        default=None,
        ge=0.0,
        le=MOST_FACTOR,
        description="of the energy of motion on the robot's own ground",
        examples=[None],
    )
    std: float = Field(
        default=0.0,
        ge=0.0,
        le=MOST_FACTOR,
        description="standard deviation of whichever of both is given",
        examples=[0.02],
    )
    blocked: bool = Field(default=False, description="no part of the robot may be over it", examples=[False])
    value: Annotated[list[StoredValue], Field(max_length=MOST_KINDS)] | StoredValue = Field(
        default=[],
        description="numbers that mean it where polygons have the property `kind`, `value` or `DN` as a number",
        examples=[2],
    )


class RasterLayerIn(Request):
    """A raster that was sent as a heightmap is sent, with `layer=true`."""

    heightmap_id: str = Field(max_length=100, description="of the raster", examples=["hm-5f0c2a9d41be"])


class CostmapCells(Request):
    """Into which cells a cost map is divided."""

    spacing_m: Annotated[float, within(SPACING_M)] = Field(
        default=1.0, description="side of a cell [m]", examples=[1.0]
    )
    headings: int = Field(
        default=DEFAULT_HEADINGS,
        ge=int(HEADINGS.low),
        le=int(HEADINGS.high),
        description="number of heading bins",
        examples=[16],
    )


class CostmapOptions(CostmapCells):
    """Settings of a cost map."""

    robot: RobotIn | None = Field(default=None, description="default: the paper's 4WD robot")
    model: str = Field(
        default=DEFAULT_MODEL,
        max_length=100,
        description="`physics`, `default`, or the id of a trained model",
        examples=["physics"],
    )
    layers: Annotated[
        dict[LayerRole, RasterLayerIn | dict[str, Any]],
        InPython("Mapping[str, Mapping[str, Any] | str | Path | HeightmapOut] | None"),
    ] = Field(
        default={},
        max_length=len(ROLES),
        description="what is known of the ground beside its height: the `heightmap_id` of a raster that was sent with "
        "`layer=true`, or GeoJSON with polygons, in the map's CRS or in degrees: `kinds` (features with the property "
        "`kind`, a name or a value of the legend), `obstacles`, `free` (the only ground to be driven on), `factor` "
        f"(property `factor`, of the energy, 0 to {LIMITS[FACTOR][1]:,.0f}), "
        f"`cost` (property `cost`, added J/m, 0 to {LIMITS[COST][1]:,.0f}) or `height` (in "
        "place of the map's, of bridges and ramps: property `height` [m], or a height at each corner)",
        examples=[{}],
    )
    legend: Annotated[dict[str, KindIn], InPython("Mapping[str, Any] | str | Path | None")] = Field(
        default={},
        max_length=MOST_KINDS,
        description="what kinds of ground cost, by name; others are those of the library",
        examples=[{}],
    )


class CostmapRequest(CostmapOptions):
    """A cost map of a heightmap that was sent before."""

    heightmap_id: str = Field(max_length=100, examples=["hm-5f0c2a9d41be"])
