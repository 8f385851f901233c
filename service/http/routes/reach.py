"""Where a battery lasts to: one way, or there and back."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from anyio.to_thread import run_sync
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse

from joulemap.model.errors import InputError
from joulemap.service.coordinates import known_crs
from joulemap.service.http.asked import answer_of, same_robot, warnings_of
from joulemap.service.http.dependencies import KernelsDep
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.http.route_files import Coordinates
from joulemap.service.pictures import reach_image
from joulemap.service.questions import reach
from joulemap.service.questions.reach import ReachOut, ReachRequest, reach_geojson

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)
GEOJSON, TIFF, PNG = "application/geo+json", "image/tiff", "image/png"
_BINARY = {"schema": {"type": "string", "format": "binary"}}
_FILES: dict[str, Any] = {GEOJSON: {"schema": {"type": "object"}}, TIFF: _BINARY, PNG: _BINARY}


@router.post("/reach", response_model=ReachOut, responses={200: {"content": _FILES}, **problems(404, 409, 503)})
async def find_reach(
    costmap_id: str,
    wanted: ReachRequest,
    service: KernelsDep,
    request: Request,
    format: Annotated[
        Literal["json", "geojson", "geotiff", "png"],
        Query(description="geojson: outlines; geotiff: what is left at every cell [J], a band for each charge"),
    ] = "json",
    coordinates: Coordinates = None,
) -> Any:
    """Where a battery lasts to from a start, one way or there and back, for one or more charges.

    The border is where a route that is planned to it needs all of the charge above the reserve. The first question
    from a start takes as long as an energy field and some routes; further charges and confidences are answered at once.
    """
    row = await run_sync(service.done_costmap, costmap_id)
    if coordinates is not None and format != "geojson":
        raise InputError("`coordinates` is for format=geojson: leave it out", coordinates=coordinates)

    def _find() -> Response:
        same_robot(row, wanted.robot)
        with service.maps.for_routes(costmap_id) as planner:
            if format == "geojson" and coordinates != "map":
                known_crs(planner.lattice.frame.crs)
            found = reach.ask(planner, wanted)
            warnings = warnings_of(row)
            if format == "png":
                return _file(reach_image(planner.lattice, found), PNG, f"{costmap_id}-reach.png")
        if format == "geotiff":
            return _file(found.geotiff(), TIFF, f"{costmap_id}-reach.tif")
        if format == "geojson":
            return JSONResponse(reach_geojson(found, warnings, coordinates=coordinates or "wgs84"), media_type=GEOJSON)
        return answer_of(reach.answer(found, warnings))

    return await while_connected(request, service.plans.do(costmap_id, _find))


def _file(content: bytes, media_type: str, name: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type=media_type, headers=headers)
