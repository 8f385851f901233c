"""Where a battery lasts to: one way, or there and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from joulemap.model.errors import InputError
from joulemap.model.ranges import BATTERY, MAX_CHARGES, QUANTILE
from joulemap.service.questions.parts import OnMap, OwnBattery, Snap, battery_of, on_map, unsure_notes
from joulemap.service.schemas.base import Place, ResponseModel, within

if TYPE_CHECKING:  # they take their time to load
    from joulemap.planner.areas.reach import Need
    from joulemap.planner.areas.reach_map import ReachMap
    from joulemap.planner.route import Route
    from joulemap.planner.route_planner import RoutePlanner

Position = list[float]


class ReachRequest(OnMap):
    """From where, with which battery, and how sure."""

    start: Place = Field(examples=[[12.5, 40.5]])
    battery: OwnBattery = None
    charges: list[Annotated[float, within(BATTERY["charge"])]] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_CHARGES,
        description="states of charge at the start, 0..1, each answered on its own; default: that of the battery",
        examples=[[0.4, 0.6, 0.8]],
    )
    confidence: Annotated[float, within(QUANTILE)] | None = Field(
        default=None,
        description="probability with which the battery is to last; default: the expected energy decides",
        examples=[0.9],
    )
    round_trip: bool = Field(default=False, description="it must come back to the start, by the best way back")
    snap: Snap = False


class ReachLevel(ResponseModel):
    """Where one charge lasts to."""

    charge: float = Field(description="state of charge at the start, 0..1")
    available_j: float = Field(description="energy above the reserve at the start [J]")
    area_m2: float = Field(ge=0, description="area where the battery lasts [m2]")
    polygons: list[list[list[Position]]] = Field(
        description="parts of that area: the outer ring of each, anticlockwise, then the rings of its holes; world "
        "x, y [m], the last point of a ring is the first one"
    )


class ReachOut(ResponseModel):
    """Where the battery lasts to."""

    start: Position = Field(description="world x, y [m]")
    round_trip: bool = Field(description="whether it comes back to the start")
    confidence: float | None = Field(description="as asked for; null where the expected energy decides")
    levels: list[ReachLevel] = Field(description="one for each charge, in the order asked for")
    warnings: list[str]
    crs: str | None


def ask(planner: RoutePlanner, wanted: ReachRequest) -> ReachMap:
    """Where a battery lasts to from a start, one way or there and back, for one or more charges.

    The border is where a route that is planned to it needs all of the charge above the reserve. The first question
    from a start takes as long as an energy field and some routes; further charges and confidences are answered at once.
    """
    import numpy as np

    from joulemap.planner.areas.reach import peak_need
    from joulemap.planner.areas.reach_map import ReachMap

    asked, battery = on_map(planner, wanted), battery_of(wanted.battery, planner.lattice.robot)
    start = asked.places(wanted.start, "start")
    levels = (battery.charge,) if wanted.charges is None else tuple(float(charge) for charge in wanted.charges)
    if not 1 <= len(levels) <= MAX_CHARGES:
        raise InputError(f"`charges` has {len(levels)} values; from 1 to {MAX_CHARGES} can be answered at a time")
    batteries = [replace(battery, charge=charge) for charge in levels]
    planner.needs_memory("a map of reach")
    unsure_notes(planner.lattice, wanted)
    found, notes = asked.planner.reach(start, round_trip=wanted.round_trip, snap=wanted.snap)
    need = peak_need if wanted.confidence is None else _need_with(wanted.confidence)
    available = tuple(each.available_j for each in batteries)
    margins = np.stack([found.margin_j(energy, need=need) for energy in available])
    lattice = asked.planner.lattice
    x, y = (float(value) for value in lattice.frame.xy(*found.out.places[0]))
    question = {
        "start": [x, y],
        "charges": list(levels),
        "available_j": list(available),
        "reserve": battery.reserve,
        "round_trip": wanted.round_trip,
        "confidence": wanted.confidence,
    }
    record = {**lattice.provenance, "reach": question}
    how = wanted.round_trip, wanted.confidence
    return ReachMap(lattice.frame, (x, y), levels, available, *how, margins, record, (*asked.places.notes, *notes))


def _need_with(confidence: float) -> Need:
    """The energy that is enough with a probability, at every point of the routes."""

    from joulemap.service.analysis.route_uncertainty import odds_along

    def _need(routes: Sequence[Route]) -> float:
        odds = odds_along(routes)
        assert odds is not None  # the lattice was asked
        return float(odds.quantile(confidence).max(initial=0.0))

    return _need


def answer(found: ReachMap, warnings: list[str]) -> ReachOut:
    """The answer to a question for reach, with outlines in the map's coordinates."""
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
    """The same answer as GeoJSON (RFC 7946), in longitude and latitude [degrees], or in the map's x and y [m]."""
    from joulemap.service.places.coordinates import to_wgs84

    crs = found.frame.crs
    said = answer(found, warnings)
    document: dict[str, Any] = {"type": "FeatureCollection", "warnings": said.warnings, "map_crs": crs}
    if coordinates == "map" and crs is not None:
        document["crs"] = {"type": "name", "properties": {"name": crs}}
    document["features"] = []
    for k, level in enumerate(said.levels):
        parts = [
            [(ring if coordinates == "map" else to_wgs84(crs, ring).round(9)).tolist() for ring in part]
            for part in found.polygons(k)
        ]
        properties = level.model_dump(exclude={"polygons"}) | {
            "round_trip": said.round_trip,
            "confidence": said.confidence,
        }
        geometry = {"type": "MultiPolygon", "coordinates": parts}
        document["features"].append({"type": "Feature", "geometry": geometry, "properties": properties})
    return document
