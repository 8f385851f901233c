"""Where a battery lasts to: the question, and its answer as JSON and as GeoJSON."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from joulemap.model.ranges import BATTERY
from joulemap.planner.areas.reach_map import ReachMap
from joulemap.service.coordinates import to_wgs84
from joulemap.service.reach import CONFIDENCE, MOST_CHARGES
from joulemap.service.schemas.base import Areas, Place, Request, ResponseModel, RobotIn, within
from joulemap.service.schemas.planning import BatteryIn

Position = list[float]


class ReachRequest(Request):
    """From where, with which battery, and how sure."""

    start: Place = Field(examples=[[12.5, 40.5]])
    battery: BatteryIn | None = Field(default=None, description="default: the robot's own, full, without a reserve")
    charges: list[Annotated[float, within(BATTERY["charge"])]] | None = Field(
        default=None,
        min_length=1,
        max_length=MOST_CHARGES,
        description="states of charge at the start, 0..1, each answered on its own; default: that of the battery",
        examples=[[0.4, 0.6, 0.8]],
    )
    confidence: float | None = Field(
        default=None,
        ge=CONFIDENCE[0],
        le=CONFIDENCE[1],
        description="probability with which the battery is to last; default: the expected energy decides",
        examples=[0.9],
    )
    round_trip: bool = Field(default=False, description="it must come back to the start, by the best way back")
    snap: bool = Field(
        default=False, description="move a start on blocked ground to the nearest free place; a warning says where"
    )
    avoid: Areas = Field(default=[])
    robot: RobotIn | None = Field(default=None, description="refused where it differs from the cost map's robot")


class ReachLevel(ResponseModel):
    """Where one charge lasts to."""

    charge: float = Field(description="state of charge at the start, 0..1")
    available_j: float = Field(description="energy above the reserve at the start [J]")
    area_m2: float = Field(ge=0, description="area where the battery lasts [m2]")
    polygons: list[list[list[Position]]] = Field(
        description="parts of that area: the outer ring of each, anticlockwise, then the rings of its holes; world "
        "[x, y] [m], the last point of a ring is the first one"
    )


class ReachOut(ResponseModel):
    """Where the battery lasts to."""

    start: Position = Field(description="world [x, y] [m]")
    round_trip: bool = Field(description="whether it comes back to the start")
    confidence: float | None = Field(description="as asked for; null where the expected energy decides")
    levels: list[ReachLevel] = Field(description="one for each charge, in the order asked for")
    warnings: list[str]
    crs: str | None


def reach_out(found: ReachMap, warnings: list[str]) -> ReachOut:
    """Return the answer to a question for reach.

    Parameters
    ----------
    found : ReachMap
        What was found.
    warnings : list of str
        Of the cost map.

    Returns
    -------
    ReachOut
        With outlines in the map's coordinates.
    """
    levels = [
        ReachLevel(
            charge=charge,
            available_j=available,
            area_m2=found.area_m2(k),
            polygons=[[ring.tolist() for ring in part] for part in found.polygons(k)],
        )
        for k, (charge, available) in enumerate(zip(found.charges, found.available_j, strict=True))
    ]
    return ReachOut(
        start=list(found.start),
        round_trip=found.round_trip,
        confidence=found.confidence,
        levels=levels,
        warnings=[*found.notes, *warnings],
        crs=found.frame.crs,
    )


def reach_geojson(found: ReachMap, warnings: list[str], *, coordinates: str = "wgs84") -> dict[str, Any]:
    """Return the same answer as GeoJSON.

    Parameters
    ----------
    found : ReachMap
        What was found.
    warnings : list of str
        Of the cost map.
    coordinates : {"wgs84", "map"}
        Longitude and latitude [degrees], or x and y [m] in the map's CRS, named in the member `crs`.

    Returns
    -------
    dict
        A FeatureCollection with a MultiPolygon for each charge.

    Raises
    ------
    InputError
        If the map has no known place on Earth, and degrees are wanted.

    References
    ----------
    RFC 7946.
    """
    crs = found.frame.crs
    answer = reach_out(found, warnings)
    document: dict[str, Any] = {"type": "FeatureCollection", "warnings": answer.warnings, "map_crs": crs}
    if coordinates == "map" and crs is not None:
        document["crs"] = {"type": "name", "properties": {"name": crs}}
    document["features"] = []
    for k, level in enumerate(answer.levels):
        parts = [
            [(ring if coordinates == "map" else to_wgs84(crs, ring).round(9)).tolist() for ring in part]
            for part in found.polygons(k)
        ]
        properties = level.model_dump(exclude={"polygons"}) | {
            "round_trip": answer.round_trip,
            "confidence": answer.confidence,
        }
        geometry = {"type": "MultiPolygon", "coordinates": parts}
        document["features"].append({"type": "Feature", "geometry": geometry, "properties": properties})
    return document
