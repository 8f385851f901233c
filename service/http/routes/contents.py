"""The contents of a cost map: its data as files, its picture, its prices at one place."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from anyio.to_thread import run_sync
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from joulemap.model.errors import InputError
from joulemap.model.ranges import HEADING_DEG
from joulemap.planner.lattice.npz import export_npz
from joulemap.service.exports.formats import WORDS, check_origin
from joulemap.service.exports.maps import MAP_FORMATS, map_files, zip_folder, zipped
from joulemap.service.http.asked import answer_of, attachment
from joulemap.service.http.dependencies import CostmapDep
from joulemap.service.http.documents import BINARY, problems
from joulemap.service.questions import at, field
from joulemap.service.questions.field import FieldRequest, Within
from joulemap.service.questions.parts import Neighbours, Snap
from joulemap.service.render.pictures import field_image, lattice_image
from joulemap.service.schemas.base import Coordinate
from joulemap.service.schemas.base import within as bounds
from joulemap.service.schemas.maps import AtOut, FieldOut

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["cost maps"])
_MAP_FORMATS = ("geotiff", "npz", "zarr", *(name for name in MAP_FORMATS if name != "geotiff"))
_MAP_WORDS = "; ".join(f"{known.name}: {known.words}" for known in MAP_FORMATS.values())


class FieldQuery(BaseModel):
    """From where, to where, or both, as what stands behind the address of a request."""

    start_x: Annotated[Coordinate | None, Field(description="energy from here to each cell: world x [m]")] = None
    start_y: Annotated[Coordinate | None, Field(description="world y [m]")] = None
    goal_x: Annotated[Coordinate | None, Field(description="energy from each cell to here: world x [m]")] = None
    goal_y: Annotated[Coordinate | None, Field(description="world y [m]")] = None
    within: Within = None
    neighbours: Neighbours = 16
    snap: Snap = False
    format: Annotated[
        Literal["json", "geotiff", "png"],
        Field(description="json: figures only; geotiff: energy [J], and the corridor as a second band; png: a picture"),
    ] = "json"

    @property
    def wanted(self) -> FieldRequest:
        """The question."""
        ends: dict[str, Any] = {
            "start": _place(self.start_x, self.start_y, "start"),
            "goal": _place(self.goal_x, self.goal_y, "goal"),
        }
        how: dict[str, Any] = {"within_percent": self.within, "neighbours": self.neighbours, "snap": self.snap}
        return FieldRequest.model_construct(**ends, **how)


@router.get(
    "/data",
    response_class=Response,
    responses={
        200: {
            "description": "The cost map as a file",
            "content": {
                "image/tiff": BINARY,
                "application/zip": BINARY,
                "application/octet-stream": BINARY,
                "application/geo+json": {"schema": {"type": "object", "description": "nodes and edges"}},
            },
        },
        **problems(404, 409, 503),
    },
)
async def get_data(
    on: CostmapDep,
    format: Annotated[
        Literal[_MAP_FORMATS],  # type: ignore[valid-type]
        Query(description=f"npz: arrays; zarr: the kept lattice, zipped; {_MAP_WORDS}"),
    ] = "geotiff",
    origin: Annotated[str | None, Query(max_length=60, description=WORDS)] = None,
) -> Response:
    """The whole cost map as a file."""
    check_origin(origin, format)
    await on.row()
    if format == "zarr":
        folder = await run_sync(on.service.store.here, on.service.store.lattice_path(on.id))
        return attachment(zip_folder(folder), "application/zip", f"{on.id}.zarr.zip")

    def _export() -> Response:
        lattice = on.service.maps.planner(on.id).lattice
        if format == "npz":
            return attachment(export_npz(lattice), "application/octet-stream", f"{on.id}.npz")
        chosen = MAP_FORMATS[format]
        files = map_files(lattice, chosen, origin=origin)
        if len(files) > 1:
            return attachment(zipped(files, on.id), chosen.media_type, f"{on.id}-{format}.zip")
        return attachment(next(iter(files.values())), chosen.media_type, f"{on.id}{chosen.suffix}")

    return await on.planned(_export)


@router.get(
    "/image.png",
    response_class=Response,
    responses={200: {"description": "A picture", "content": {"image/png": BINARY}}, **problems(404, 409, 503)},
)
async def get_image(
    on: CostmapDep,
    heading_deg: Annotated[
        Annotated[float, bounds(HEADING_DEG)] | None,
        Query(
            description="clockwise from north [deg]; the picture shows the prices in this heading",
        ),
    ] = None,
    view: Annotated[
        Literal["mean", "directionality", "heading"] | None,
        Query(
            description="mean over the headings; directionality (most expensive minus cheapest heading); or one heading"
        ),
    ] = None,
) -> Response:
    """A picture of the cost map: the mean over headings, one heading, or how much the heading matters."""
    await on.row()
    chosen = view or ("mean" if heading_deg is None else "heading")

    def _draw() -> Response:
        lattice = on.service.maps.planner(on.id).lattice
        return Response(lattice_image(lattice, view=chosen, heading_deg=heading_deg), media_type="image/png")

    return await on.planned(_draw)


@router.get("/at", responses=problems(404, 409, 503))
async def get_at(
    on: CostmapDep,
    x: Annotated[Coordinate | None, Query(description="world x [m]", examples=[12.5])] = None,
    y: Annotated[Coordinate | None, Query(description="world y [m]", examples=[40.5])] = None,
    lat: Annotated[float | None, Query(ge=-90.0, le=90.0, description="latitude [degrees], instead of x")] = None,
    lon: Annotated[float | None, Query(ge=-180.0, le=180.0, description="longitude [degrees], instead of y")] = None,
) -> AtOut:
    """Energy per metre at one place in all headings, and why some headings are blocked."""
    place = _place(x, y, "") or _on_earth(lat, lon)
    if place is None or (x is not None and lat is not None):
        raise InputError("name one place: x and y in metres, or lat and lon in degrees")

    def _look() -> AtOut:
        on.service.done_costmap(on.id)
        wanted = at.AtRequest.model_construct(place=place)
        return at.answer(at.ask(on.service.maps.planner(on.id), wanted))

    return await on.service.prices.do(on.id, _look)


@router.get(
    "/field",
    response_model=FieldOut,
    responses={
        200: {"description": "Figures, a file or a picture", "content": {"image/tiff": BINARY, "image/png": BINARY}},
        **problems(404, 409, 503),
    },
)
async def get_field(on: CostmapDep, query: Annotated[FieldQuery, Query()]) -> Any:
    """Least energy from a start to all cells, from all cells to a goal, or over each cell between both."""
    await on.row()
    wanted = query.wanted

    def _search() -> Response:
        found = field.ask(on.service.maps.planner(on.id), wanted)
        if query.format == "geotiff":
            return attachment(found.energies.geotiff(within=found.within), "image/tiff", f"{on.id}-field.tif")
        if query.format == "png":
            return Response(field_image(found.energies, within=found.within), media_type="image/png")
        return answer_of(FieldOut(**field.answer(found)))

    return await on.planned(_search)


def _on_earth(lat: float | None, lon: float | None) -> dict[str, float] | None:
    if (lat is None) != (lon is None):
        raise InputError("lat and lon go together")
    return None if lat is None or lon is None else {"lat": lat, "lon": lon}


def _place(x: float | None, y: float | None, name: str) -> tuple[float, float] | None:
    if (x is None) != (y is None):
        raise InputError(f"{name}_x and {name}_y go together" if name else "x and y go together")
    return None if x is None or y is None else (x, y)
