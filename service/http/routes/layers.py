"""What the page draws of heightmaps and cost maps: layers that lie on the map, contours, roses, a surface."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from anyio.to_thread import run_sync
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from joulemap.model.ranges import HEADING_DEG
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.service.http.dependencies import CostmapDep, OnCostmap, ServiceDep
from joulemap.service.http.documents import BINARY, problems
from joulemap.service.http.long_questions import while_connected
from joulemap.service.render.energy_colours import VIEWS, colour_scale, scale_colours
from joulemap.service.render.ground_drawing import REASONS
from joulemap.service.render.map_layers import (
    blocked_layer,
    coarse_heights,
    energy_layer,
    ground_layer,
    layer_bounds,
    overview,
)
from joulemap.service.render.map_pieces import (
    MOST_LEVELS,
    MOST_PIECES,
    PIECE_PIXELS,
    Look,
    contours,
    draw_piece,
    lat_lon,
    levels_of,
    look_of,
    roses,
)
from joulemap.service.render.raster_shading import centres, thinned
from joulemap.service.schemas.base import Coordinate, within
from joulemap.service.schemas.maps import BlockedColourOut, ColourScaleOut, LayersOut, RosesOut, SurfaceOut
from joulemap.service.schemas.planning import number

router = APIRouter()
_MAPS: list[Any] = ["cost maps"]
_PICTURE: dict[int | str, dict[str, Any]] = {200: {"description": "A picture", "content": {"image/png": BINARY}}}
_KEPT = {"Cache-Control": "private, max-age=3600"}  # a cost map and a heightmap never change
_SURFACE_PIXELS = 220
_OVERVIEWS: dict[str, CostLattice] = {}  # of the large cost map that was asked about last
_LOOKS: OrderedDict[str, Look] = OrderedDict()  # of the cost maps whose pieces were asked for last
_MOST_LOOKS = 16
_LOCK = threading.Lock()
Answer = Callable[[CostLattice], Response]


class PieceQuery(BaseModel):
    """Which piece, and what it shows."""

    level: Annotated[int, Field(ge=0, lt=MOST_LEVELS, description="a pixel is 2^level x 2^level cells")] = 0
    row: Annotated[int, Field(ge=0, le=MOST_PIECES, description="of the pieces of this level, from the north")] = 0
    col: Annotated[int, Field(ge=0, le=MOST_PIECES, description="of the pieces of this level, from the west")] = 0
    view: Annotated[
        Literal["mean", "directionality", "heading", "ground"], Field(description="as of `layer.png`; or ground alone")
    ] = "mean"
    heading_deg: Annotated[
        Annotated[float, within(HEADING_DEG)] | None,
        Field(description="of energy and blocked ground: clockwise from north [deg]"),
    ] = None
    blocked: Annotated[bool, Field(description="whether blocked ground is hatched")] = True


class GeoJson(JSONResponse):
    """GeoJSON."""

    media_type = "application/geo+json"


@router.get(
    "/heightmaps/{heightmap_id}/ground.png",
    tags=["heightmaps"],
    response_class=Response,
    responses={**_PICTURE, **problems(404, 409, 503)},
)
async def get_ground(heightmap_id: str, service: ServiceDep, request: Request) -> Response:
    """Shaded ground of a heightmap, as a picture that lies on its bounds; what is unknown is transparent."""
    row = await run_sync(service.store.heightmap, heightmap_id)

    def _draw() -> Response:
        heights, extent = coarse_heights(service.store.open_heightmap(row.id))
        return Response(ground_layer(heights, extent), media_type="image/png", headers=_KEPT)

    return await while_connected(request, service.plans.do(heightmap_id, _draw))


@router.get("/costmaps/{costmap_id}/layers", tags=_MAPS, response_model=LayersOut, responses=problems(404, 409, 503))
async def get_layers(on: CostmapDep) -> Response:
    """Where the layers of `layer.png` lie, what their colours mean, and where on Earth they are."""
    row = await on.row()
    shape = (row.summary or {})["frame"]

    def _describe(lattice: CostLattice) -> Response:
        known = lattice.elevation_m[np.isfinite(lattice.elevation_m)]
        scales = {}
        for one in VIEWS:
            low, high = colour_scale(lattice, one)
            scales[one] = ColourScaleOut(low=low, high=high, colours=scale_colours(one))
        found = LayersOut(
            bounds=list(layer_bounds(lattice.frame)),
            height_min_m=float(known.min()) if known.size else None,
            height_max_m=float(known.max()) if known.size else None,
            blocked=[BlockedColourOut(reason=r.label, colour=face) for r, (face, _, _) in REASONS.items()],
            lat_lon=lat_lon(lattice.frame),
            piece_levels=levels_of((shape["rows"], shape["cols"])),
            piece_pixels=PIECE_PIXELS,
            **scales,
        )
        return Response(found.model_dump_json(), media_type="application/json", headers=_KEPT)

    return await _of_lattice(on, _describe)


@router.get(
    "/costmaps/{costmap_id}/layer.png",
    tags=_MAPS,
    response_class=Response,
    responses={**_PICTURE, **problems(404, 409, 503)},
)
async def get_layer(
    on: CostmapDep,
    layer: Annotated[
        Literal["ground", "energy", "blocked"],
        Query(description="ground: shaded heights; energy: J/m in colour; blocked: hatched by reason"),
    ] = "energy",
    view: Annotated[
        Literal["mean", "directionality", "heading"] | None,
        Query(description="of `energy`: mean over the headings; most expensive minus cheapest heading; or one heading"),
    ] = None,
    heading_deg: Annotated[
        Annotated[float, within(HEADING_DEG)] | None,
        Query(description="of `energy` and `blocked`: clockwise from north [deg]"),
    ] = None,
) -> Response:
    """A picture without axes that lies on the bounds of `layers`; where it has nothing to show, it is transparent."""
    chosen = view or ("mean" if heading_deg is None else "heading")

    def _draw(lattice: CostLattice) -> Response:
        if layer == "ground":
            picture = ground_layer(*thinned(lattice.elevation_m, lattice.frame))
        elif layer == "energy":
            picture = energy_layer(lattice, view=chosen, heading_deg=heading_deg)
        else:
            picture = blocked_layer(lattice, heading_deg=heading_deg)
        return Response(picture, media_type="image/png", headers=_KEPT)

    return await _of_lattice(on, _draw)


@router.get(
    "/costmaps/{costmap_id}/contours",
    tags=_MAPS,
    response_class=Response,
    responses={
        200: {
            "content": {
                "application/geo+json": {
                    "schema": {"type": "object", "description": "FeatureCollection of MultiLineStrings"}
                }
            },
            "description": "Contour lines",
        },
        **problems(404, 409, 503),
    },
)
async def get_contours(on: CostmapDep) -> Response:
    """Contour lines as GeoJSON in the map's CRS, with `height_m`; simplified to what is seen of the whole map."""

    def _trace(lattice: CostLattice) -> Response:
        features = [
            {
                "type": "Feature",
                "properties": {"height_m": level},
                "geometry": {"type": "MultiLineString", "coordinates": [line.round(3).tolist() for line in lines]},
            }
            for level, lines in contours(lattice.elevation_m, lattice.frame)
        ]
        return GeoJson({"type": "FeatureCollection", "features": features}, headers=_KEPT)

    return await _of_lattice(on, _trace)


@router.get("/costmaps/{costmap_id}/roses", tags=_MAPS, response_model=RosesOut, responses=problems(404, 409, 503))
async def get_roses(
    on: CostmapDep,
    west: Annotated[Coordinate, Query(description="of the part that is asked about [m]", examples=[0.0])],
    south: Annotated[Coordinate, Query(description="[m]", examples=[0.0])],
    east: Annotated[Coordinate, Query(description="[m]", examples=[20.0])],
    north: Annotated[Coordinate, Query(description="[m]", examples=[20.0])],
    across: Annotated[int, Query(ge=1, le=40, description="most cells along a side", examples=[12])] = 12,
) -> Response:
    """Energy per metre by heading at evenly spaced cells of a part of the map."""
    await on.row()

    def _look() -> Response:
        with on.service.maps.for_pricing(on.id) as planner:
            found = RosesOut(**roses(planner.ground, (west, south, east, north), across=across))
        return Response(found.model_dump_json(), media_type="application/json")

    return await on.priced(_look)


@router.get("/costmaps/{costmap_id}/surface", tags=_MAPS, response_model=SurfaceOut, responses=problems(404, 409, 503))
async def get_surface(on: CostmapDep) -> Response:
    """Heights on a coarse grid, for a view in three dimensions."""

    def _thin(lattice: CostLattice) -> Response:
        ground, extent = thinned(lattice.elevation_m, lattice.frame, most=_SURFACE_PIXELS)
        x, y = centres(ground, extent)
        z = [[number(value) for value in row] for row in ground.astype(float).tolist()]
        found = SurfaceOut(x=x.tolist(), y=y.tolist(), z=z)
        return Response(found.model_dump_json(), media_type="application/json", headers=_KEPT)

    return await _of_lattice(on, _thin)


@router.get(
    "/costmaps/{costmap_id}/piece.png",
    tags=_MAPS,
    response_class=Response,
    responses={**_PICTURE, **problems(404, 409, 503)},
)
async def get_piece(on: CostmapDep, wanted: Annotated[PieceQuery, Query()]) -> Response:
    """A piece of a large cost map, as fine as its cells: ground, energy and blocked ground over each other.

    `layers` says how many levels and how many pixels; a map whose `layer.png` shows every cell has none.
    """
    await on.row()

    def _draw() -> Response:
        with on.service.maps.for_pricing(on.id) as planner:
            with _LOCK:
                look = _look(on.id, planner.ground)
            place = wanted.level, wanted.row, wanted.col
            view = None if wanted.view == "ground" else wanted.view
            drawn = draw_piece(
                planner.ground, look, place, view=view, heading_deg=wanted.heading_deg, blocked=wanted.blocked
            )
        return Response(drawn, media_type="image/png", headers=_KEPT)

    return await on.planned(_draw)


def _look(costmap_id: str, lattice: CostLattice | StoredLattice) -> Look:
    if costmap_id not in _LOOKS:
        whole = lattice if isinstance(lattice, CostLattice) else _coarse(costmap_id, lattice)
        _LOOKS[costmap_id] = look_of(whole)
        while len(_LOOKS) > _MOST_LOOKS:
            _LOOKS.popitem(last=False)
    _LOOKS.move_to_end(costmap_id)
    return _LOOKS[costmap_id]


async def _of_lattice(on: OnCostmap, answer: Answer) -> Response:
    """The answer about a cost map, or about a coarse one where it is too large for memory."""
    await on.row()

    def _ask() -> Response:
        with on.service.maps.for_pricing(on.id) as planner:
            if isinstance(planner.ground, CostLattice):
                return answer(planner.ground)
            with _LOCK:  # one at a time, and the next one finds it made
                return answer(_coarse(on.id, planner.ground))

    return await on.planned(_ask)


def _coarse(costmap_id: str, stored: StoredLattice) -> CostLattice:
    if costmap_id not in _OVERVIEWS:
        _OVERVIEWS.clear()
        _OVERVIEWS[costmap_id] = overview(stored)
    return _OVERVIEWS[costmap_id]
