"""Heightmaps: send, list, describe and delete them."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel

from joulemap.service.http.dependencies import Limit, Offset, ServiceDep
from joulemap.service.http.documents import problems, upload_body
from joulemap.service.http.uploads import arriving, media_type, take_form, take_raw
from joulemap.service.questions.reading import UploadOptions
from joulemap.service.schemas.base import UnreadableOut
from joulemap.service.schemas.kept import heightmap_out, listed, shown
from joulemap.service.schemas.maps import HeightmapOut
from joulemap.service.storage.tables import HeightmapRow

router = APIRouter(prefix="/heightmaps", tags=["heightmaps"])


class HeightmapList(BaseModel):
    """One page of heightmaps, newest first."""

    total: int
    items: list[HeightmapOut | UnreadableOut]


@router.post("", status_code=201, responses=problems(503), openapi_extra=upload_body())
async def send_heightmap(
    request: Request, response: Response, service: ServiceDep, options: Annotated[UploadOptions, Query()]
) -> HeightmapOut:
    """Send a heightmap, as the form field `file` or as the raw body. What the file does not say is a parameter."""
    if media_type(request) == "multipart/form-data":
        async with arriving(request, service) as request, request.form(max_files=1, max_fields=20) as form:
            row = await take_form(request, form, service, options)
    else:
        async with arriving(request, service) as request:
            row = await take_raw(request, service, options)
    response.headers["Location"] = f"/v1/heightmaps/{row.id}"
    return heightmap_out(row)


@router.get("", responses=problems())
def list_heightmaps(service: ServiceDep, limit: Limit = 100, offset: Offset = 0) -> HeightmapList:
    """All heightmaps, newest first."""
    rows, total = service.store.page(HeightmapRow, limit=limit, offset=offset)
    return HeightmapList(total=total, items=listed(rows, heightmap_out))


@router.get("/{heightmap_id}", responses=problems(404, 409))
def get_heightmap(heightmap_id: str, service: ServiceDep) -> HeightmapOut:
    """Size, position and heights of one heightmap."""
    return shown(service.store.heightmap(heightmap_id), heightmap_out)


@router.delete("/{heightmap_id}", status_code=204, responses=problems(404, 409))
def delete_heightmap(heightmap_id: str, service: ServiceDep) -> None:
    """Delete a heightmap. Refused while cost maps or calibrations were made from it."""
    service.store.delete_heightmap(heightmap_id)
