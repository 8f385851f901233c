"""What is sent and kept, heightmaps and measured runs: send, list, get, delete."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel

from joulemap.model.errors import InputError
from joulemap.model.ranges import LONGEST_NAME, NAME_PATTERN, TRACK_M
from joulemap.model.runs.mapping import read_mapping
from joulemap.model.runs.odometry import Odometry
from joulemap.service.http.dependencies import KernelsDep, Limit, Offset, ServiceDep
from joulemap.service.http.documents import problems, runs_body, upload_body
from joulemap.service.http.uploads import arriving, media_type, take_form, take_raw, take_raw_run, take_runs
from joulemap.service.intake.limits import RunReading
from joulemap.service.questions.reading import UploadOptions
from joulemap.service.schemas.base import UnreadableOut, within
from joulemap.service.schemas.kept import heightmap_out, listed, runs_out, shown
from joulemap.service.schemas.loop import RunsOut
from joulemap.service.schemas.maps import HeightmapOut
from joulemap.service.storage.tables import HeightmapRow, RunsRow

heightmaps = APIRouter(prefix="/heightmaps", tags=["heightmaps"])
runs = APIRouter(prefix="/runs", tags=["runs and calibrations"])
router = APIRouter()


class HeightmapList(BaseModel):
    """One page of heightmaps, newest first."""

    total: int
    items: list[HeightmapOut | UnreadableOut]


@heightmaps.post("", status_code=201, responses=problems(503), openapi_extra=upload_body())
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


@heightmaps.get("", responses=problems())
def list_heightmaps(service: ServiceDep, limit: Limit = 100, offset: Offset = 0) -> HeightmapList:
    """All heightmaps, newest first."""
    rows, total = service.store.page(HeightmapRow, limit=limit, offset=offset)
    return HeightmapList(total=total, items=listed(rows, heightmap_out))


@heightmaps.get("/{heightmap_id}", responses=problems(404, 409))
def get_heightmap(heightmap_id: str, service: ServiceDep) -> HeightmapOut:
    """Size, position and heights of one heightmap."""
    return shown(service.store.heightmap(heightmap_id), heightmap_out)


@heightmaps.delete("/{heightmap_id}", status_code=204, responses=problems(404, 409))
def delete_heightmap(heightmap_id: str, service: ServiceDep) -> None:
    """Delete a heightmap. Refused while cost maps or calibrations were made from it."""
    service.store.delete_heightmap(heightmap_id)


class RunsList(BaseModel):
    """Measured runs, newest first."""

    total: int
    items: list[RunsOut | UnreadableOut]


@runs.post("", status_code=201, responses=problems(404, 503), openapi_extra=runs_body())
async def send_runs(
    request: Request,
    response: Response,
    service: KernelsDep,
    heightmap_id: Annotated[
        str | None,
        Query(
            max_length=100, description="heightmap that they were driven on; `lat` and `lon` need its coordinate system"
        ),
    ] = None,
    odometry_track_m: Annotated[
        Annotated[float, within(TRACK_M)] | None,
        Query(
            description="the runs have no positions: integrate `speed_left` and `speed_right` with this effective "
            "track width [m]",
        ),
    ] = None,
    terrain_from_name: Annotated[
        bool, Query(description="with odometry_track_m: the file snow_02.csv was driven on snow")
    ] = False,
    entries: Annotated[
        list[Annotated[str, Query(max_length=120)]] | None,  # all in a URL of at most 64 kB, 12 for a character
        Query(
            alias="map",
            max_length=30,
            description="where a column is taken from, with a unit or factor: `t=timestamp_ms:ms`, "
            "`current=left+right`, `voltage=/battery.voltage`; usual names, units and message types are recognised",
            examples=[["t=timestamp_ms:ms", "current=batt_current_mA:mA"]],
        ),
    ] = None,
    accept_implausible: Annotated[
        bool, Query(description="keep runs whose numbers are hardly in the units that they are read in")
    ] = False,
    name: Annotated[
        str,
        Query(
            min_length=1,
            max_length=LONGEST_NAME,
            pattern=NAME_PATTERN,
            description="name of a run that is the raw body; in a form, the file has a name",
        ),
    ] = "run.csv",
) -> RunsOut:
    """Send measured runs: each as a form field `file`, or one as the raw body. All are kept or none.

    Formats: CSV of any shape, Parquet, MCAP, ROS bags, ArduPilot and MAVLink logs, PX4 ULog, FIT. What is in other
    columns or units is kept in joulemap's; `reading` says what was taken from where.
    """
    if terrain_from_name and odometry_track_m is None:
        raise InputError("terrain_from_name goes with odometry_track_m", field="terrain_from_name")
    if heightmap_id is not None and odometry_track_m is not None:
        raise InputError("runs without positions belong to no heightmap: leave heightmap_id out", field="heightmap_id")
    odometry = None if odometry_track_m is None else Odometry(odometry_track_m, terrain_from_name)
    reading = RunReading(odometry, read_mapping(entries), accept_implausible)
    how: dict[str, Any] = {"heightmap_id": heightmap_id, "reading": reading}
    if media_type(request) == "multipart/form-data":
        async with (
            arriving(request, service) as request,
            request.form(max_files=service.settings.max_runs, max_fields=20) as form,
        ):
            row = await take_runs(request, form, service, **how)
    else:
        async with arriving(request, service) as request:
            row = await take_raw_run(request, service, name=name, **how)
    response.headers["Location"] = f"/v1/runs/{row.id}"
    return runs_out(row)


@runs.get("", responses=problems())
def list_runs(service: ServiceDep, limit: Limit = 100, offset: Offset = 0) -> RunsList:
    """All runs, newest first."""
    rows, total = service.store.page(RunsRow, limit=limit, offset=offset)
    return RunsList(total=total, items=listed(rows, runs_out))


@runs.get("/{runs_id}", responses=problems(404, 409))
def get_runs(runs_id: str, service: ServiceDep) -> RunsOut:
    """What was read from runs that were sent together, and what was left out and why."""
    return shown(service.store.runs(runs_id), runs_out)


@runs.delete("/{runs_id}", status_code=204, responses=problems(404, 409))
def delete_runs(runs_id: str, service: ServiceDep) -> None:
    """Delete runs; refused while there are calibrations made from them."""
    service.store.delete_runs(runs_id)


router.include_router(heightmaps)
router.include_router(runs)
