"""The contents of a cost map: its data as files, its picture, its prices at one place."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from anyio.to_thread import run_sync
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse

from joulemap.model.errors import InputError
from joulemap.model.ranges import HEADING_DEG
from joulemap.planner.lattice.io import export_npz
from joulemap.service.exports.maps import MAP_FORMATS, map_files, zipped
from joulemap.service.http.asked import answer_of
from joulemap.service.http.dependencies import KernelsDep
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import while_connected
from joulemap.service.http.zip_stream import zip_folder
from joulemap.service.pictures import field_image, lattice_image
from joulemap.service.questions import at, field
from joulemap.service.questions.field import FieldRequest, Neighbours, Snap, Within
from joulemap.service.schemas.base import Coordinate
from joulemap.service.schemas.base import within as bounds
from joulemap.service.schemas.maps import AtOut, FieldOut

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["cost maps"])
_MAP_FORMATS = ("geotiff", "npz", "zarr", *(name for name in MAP_FORMATS if name != "geotiff"))
_MAP_WORDS = "; ".join(f"{known.name}: {known.words}" for known in MAP_FORMATS.values())
_BINARY = {"schema": {"type": "string", "format": "binary"}}


@router.get(
    "/data",
    response_class=Response,
    responses={
        200: {
            "description": "The cost map as a file",
            "content": {
                "image/tiff": _BINARY,
                "application/zip": _BINARY,
                "application/octet-stream": _BINARY,
                "application/geo+json": {"schema": {"type": "object", "description": "nodes and edges"}},
            },
        },
        **problems(404, 409, 503),
    },
)
async def get_data(
    costmap_id: str,
    service: KernelsDep,
    request: Request,
    format: Annotated[
        Literal[_MAP_FORMATS],  # type: ignore[valid-type]
        Query(description=f"npz: arrays; zarr: the kept lattice, zipped; {_MAP_WORDS}"),
    ] = "geotiff",
) -> Response:
    """The whole cost map as a file."""
    await run_sync(service.done_costmap, costmap_id)
    if format == "zarr":
        folder = await run_sync(service.store.here, service.store.lattice_path(costmap_id))
        return _file(zip_folder(folder), "application/zip", f"{costmap_id}.zarr.zip")

    def _export() -> Response:
        lattice = service.maps.planner(costmap_id).lattice
        if format == "npz":
            return _file(iter([export_npz(lattice)]), "application/octet-stream", f"{costmap_id}.npz")
        chosen = MAP_FORMATS[format]
        files = map_files(lattice, chosen)
        if len(files) > 1:
            return _file(iter([zipped(files, costmap_id)]), chosen.media_type, f"{costmap_id}-{format}.zip")
        return _file(iter(files.values()), chosen.media_type, f"{costmap_id}{chosen.suffix}")

    return await while_connected(request, service.plans.do(costmap_id, _export))


@router.get(
    "/image.png",
    response_class=Response,
    responses={200: {"description": "A picture", "content": {"image/png": _BINARY}}, **problems(404, 409, 503)},
)
async def get_image(
    costmap_id: str,
    service: KernelsDep,
    request: Request,
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
    await run_sync(service.done_costmap, costmap_id)
    chosen = view or ("mean" if heading_deg is None else "heading")

    def _draw() -> Response:
        lattice = service.maps.planner(costmap_id).lattice
        return Response(lattice_image(lattice, view=chosen, heading_deg=heading_deg), media_type="image/png")

    return await while_connected(request, service.plans.do(costmap_id, _draw))


@router.get("/at", responses=problems(404, 409, 503))
async def get_at(
    costmap_id: str,
    service: KernelsDep,
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
        service.done_costmap(costmap_id)
        wanted = at.AtRequest.model_construct(place=place)
        return at.answer(at.ask(service.maps.planner(costmap_id), wanted))

    return await service.prices.do(costmap_id, _look)


@router.get(
    "/field",
    response_model=FieldOut,
    responses={
        200: {"description": "Figures, a file or a picture", "content": {"image/tiff": _BINARY, "image/png": _BINARY}},
        **problems(404, 409, 503),
    },
)
async def get_field(
    costmap_id: str,
    service: KernelsDep,
    request: Request,
    start_x: Annotated[Coordinate | None, Query(description="energy from here to each cell: world x [m]")] = None,
    start_y: Annotated[Coordinate | None, Query(description="world y [m]")] = None,
    goal_x: Annotated[Coordinate | None, Query(description="energy from each cell to here: world x [m]")] = None,
    goal_y: Annotated[Coordinate | None, Query(description="world y [m]")] = None,
    within: Annotated[Within, Query()] = None,
    neighbours: Annotated[Neighbours, Query()] = 16,
    snap: Annotated[Snap, Query()] = False,
    format: Annotated[
        Literal["json", "geotiff", "png"],
        Query(description="json: figures only; geotiff: energy [J], and the corridor as a second band; png: a picture"),
    ] = "json",
) -> Any:
    """Least energy from a start to all cells, from all cells to a goal, or over each cell between both."""
    await run_sync(service.done_costmap, costmap_id)
    ends: dict[str, Any] = {"start": _place(start_x, start_y, "start"), "goal": _place(goal_x, goal_y, "goal")}
    wanted = FieldRequest.model_construct(**ends, within_percent=within, neighbours=neighbours, snap=snap)

    def _search() -> Response:
        found = field.ask(service.maps.planner(costmap_id), wanted)
        if format == "geotiff":
            return _file(iter([found.energies.geotiff(within=found.within)]), "image/tiff", f"{costmap_id}-field.tif")
        if format == "png":
            return Response(field_image(found.energies, within=found.within), media_type="image/png")
        return answer_of(FieldOut(**field.answer(found)))

    return await while_connected(request, service.plans.do(costmap_id, _search))


def _on_earth(lat: float | None, lon: float | None) -> dict[str, float] | None:
    if (lat is None) != (lon is None):
        raise InputError("lat and lon go together")
    return None if lat is None or lon is None else {"lat": lat, "lon": lon}


def _place(x: float | None, y: float | None, name: str) -> tuple[float, float] | None:
    if (x is None) != (y is None):
        raise InputError(f"{name}_x and {name}_y go together" if name else "x and y go together")
    return None if x is None or y is None else (x, y)


def _file(chunks: Iterator[bytes], kind: str, name: str) -> StreamingResponse:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return StreamingResponse(chunks, media_type=kind, headers=headers)
