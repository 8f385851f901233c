"""Cost maps: make, list, describe and delete them."""

from __future__ import annotations

from typing import Annotated, Any

import anyio
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData
from starlette.exceptions import HTTPException

from joulemap.model.energy.predictor import MODEL_NAMES
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.layers.layer import check_legend
from joulemap.model.terrain.layers.polygons import check_polygons
from joulemap.model.terrain.layers.reading import check_raster
from joulemap.service.analysis.cost_lattices import check_lattice
from joulemap.service.http.dependencies import Limit, Offset, ServiceDep
from joulemap.service.http.documents import costmap_body, problems
from joulemap.service.http.routes.jobs import Prefer, job_answer
from joulemap.service.http.service import Service
from joulemap.service.http.uploads import arriving, invalid, media_type, take_form
from joulemap.service.questions.costmap import CostmapOptions, CostmapRequest, RasterLayerIn
from joulemap.service.questions.reading import UploadOptions
from joulemap.service.schemas.base import UnreadableOut, robot_values
from joulemap.service.schemas.kept import costmap_out, listed, shown
from joulemap.service.schemas.maps import CostmapOut
from joulemap.service.storage.stats import frame_of_stats
from joulemap.service.storage.tables import CostmapRow, HeightmapRow

router = APIRouter(prefix="/costmaps", tags=["cost maps"])
MOST_BYTES_PER_VALUE = 8  # a price and its uncertainty, float32 each, before they are compressed


class CostmapList(BaseModel):
    """One page of cost maps, newest first."""

    total: int
    items: list[CostmapOut | UnreadableOut]


@router.post(
    "",
    status_code=202,
    response_model=CostmapOut,
    responses={
        201: {"model": CostmapOut, "description": "Done within the time of `Prefer: wait=SECONDS`"},
        **problems(404, 409, 415, 503),
    },
    openapi_extra=costmap_body(),
)
async def make_costmap(
    request: Request,
    service: ServiceDep,
    options: Annotated[UploadOptions, Query()],
    prefer: Prefer = None,
) -> Response:
    """Make a cost map of a heightmap that was sent before, or of one in the same form; it is made in the background."""
    service.check_room()
    kind = media_type(request)
    if kind == "multipart/form-data":
        async with arriving(request, service) as request, request.form(max_files=1, max_fields=20) as form:
            wanted = await anyio.to_thread.run_sync(_form_options, form)
            await anyio.to_thread.run_sync(_check_settings, service, wanted)
            heightmap = await take_form(request, form, service, options)
    elif kind == "application/json":
        wanted = await _json_request(request)
        heightmap = await anyio.to_thread.run_sync(service.store.heightmap, wanted.heightmap_id)
        await anyio.to_thread.run_sync(_check_settings, service, wanted)
    else:
        raise HTTPException(415, "send application/json, or multipart/form-data with the heightmap as `file`")
    row = await anyio.to_thread.run_sync(_enqueue, service, heightmap, wanted)
    return await job_answer(service, row.id, "/v1/costmaps", prefer, load=service.store.costmap, answer=costmap_out)


@router.get("", responses=problems())
def list_costmaps(service: ServiceDep, limit: Limit = 100, offset: Offset = 0) -> CostmapList:
    """All cost maps, finished or not, newest first."""
    rows, total = service.store.page(CostmapRow, limit=limit, offset=offset)
    return CostmapList(total=total, items=listed(rows, costmap_out))


@router.get("/{costmap_id}", responses=problems(404, 409))
def get_costmap(costmap_id: str, service: ServiceDep) -> CostmapOut:
    """Status and progress; once done, the frame, the prices, what is blocked and why, and how it was made."""
    return shown(service.store.costmap(costmap_id), costmap_out)


@router.get("/{costmap_id}/provenance", responses=problems(404, 409))
def get_provenance(costmap_id: str, service: ServiceDep) -> dict[str, Any]:
    """How a cost map was made, with everything about its model: settings, training data, errors."""
    provenance: dict[str, Any] = (service.done_costmap(costmap_id).summary or {})["provenance"]
    return provenance


@router.delete("/{costmap_id}", status_code=204, responses=problems(404))
def delete_costmap(costmap_id: str, service: ServiceDep) -> None:
    """Delete a cost map; one that is being made is stopped."""
    service.delete_costmap(costmap_id)


async def _json_request(request: Request) -> CostmapRequest:
    try:
        return await anyio.to_thread.run_sync(CostmapRequest.model_validate_json, await request.body())
    except ValidationError as error:
        raise invalid(error, "body") from error


def _form_options(form: FormData) -> CostmapOptions:
    text = form.get("options", "{}")
    try:
        return CostmapOptions.model_validate_json(text if isinstance(text, str) else "")
    except ValidationError as error:
        raise invalid(error, "options") from error


def _check_settings(service: Service, wanted: CostmapOptions) -> None:
    """Check all that can be checked without the map. Raises RobotError, ModelError."""
    Robot.from_mapping(robot_values(wanted.robot))
    if wanted.model not in MODEL_NAMES:  # those need no check, and only the workers load them
        service.find_predictor(wanted.model)


def _checked_layers(service: Service, wanted: CostmapOptions, frame: GridFrame) -> dict[str, Any]:
    """The layers of a request, as a job keeps them.

    Raises InputError where one is no layer of this map; NotFoundError where a raster is not there.
    """
    if not wanted.layers and not wanted.legend:
        return {}
    legend = {name: kind.model_dump(exclude_defaults=True) for name, kind in wanted.legend.items()}
    check_legend(legend, wanted.layers)
    layers, polygons = dict[str, Any](), dict[str, dict[str, Any]]()
    for role, layer in wanted.layers.items():
        if isinstance(layer, RasterLayerIn):
            sent = service.store.heightmap(layer.heightmap_id)
            check_raster(role, frame_of_stats(sent.stats), frame, legend, source=sent.name)
            layers[role] = layer.model_dump()
        else:
            layers[role] = polygons[role] = layer
    check_polygons(polygons, frame, legend)
    return {"layers": layers, "legend": legend}


def _enqueue(service: Service, heightmap: HeightmapRow, wanted: CostmapOptions) -> CostmapRow:
    stats = heightmap.stats
    if stats.get("layer"):
        raise InputError(f"{heightmap.id} ({heightmap.name}) was sent as a layer: it has no heights", id=heightmap.id)
    frame = frame_of_stats(stats)
    limit = service.settings.max_lattice_values
    tiling = check_lattice(frame, spacing_m=wanted.spacing_m, headings=wanted.headings, max_values=limit)
    robot = Robot.from_mapping(robot_values(wanted.robot))
    over = _checked_layers(service, wanted, frame)
    service.check_room()
    row = service.store.add_costmap(
        heightmap.id,
        {
            "robot": robot.as_dict(),
            "model": wanted.model,
            "spacing_m": wanted.spacing_m,
            "headings": wanted.headings,
            **over,
        },
        most_bytes=MOST_BYTES_PER_VALUE * tiling.values,
    )
    service.jobs.submit()
    return row
