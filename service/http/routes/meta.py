"""Where to start, and whether the service lives and is ready."""

from __future__ import annotations

from importlib import resources

from fastapi import APIRouter
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, Field

from joulemap.planner.plan import PLANNERS
from joulemap.service.http.documents import problems
from joulemap.service.http.state import ServiceDep

router = APIRouter(tags=["service"])


class Live(BaseModel):
    status: str = Field(examples=["live"])


class Ready(BaseModel):
    status: str = Field(examples=["ready"])
    warm_up_s: float = Field(description="seconds that loading or compiling the kernels took [s]")


class Index(BaseModel):
    """Where things are."""

    name: str
    version: str
    planners: list[str]
    links: dict[str, str]


@router.get("/healthz")
async def healthz() -> Live:
    """The process lives."""
    return Live(status="live")


@router.get("/readyz", responses={503: problems(503)[503]})
async def readyz(service: ServiceDep) -> Ready:
    """Ready once all kernels are compiled and loaded, so that the first question is as fast as the second."""
    return Ready(status="ready", warm_up_s=service.check_ready())


@router.get("/v1")
async def index(service: ServiceDep) -> Index:
    """Links to everything."""
    links = {
        "heightmaps": "/v1/heightmaps",
        "costmaps": "/v1/costmaps",
        "runs": "/v1/runs",
        "calibrations": "/v1/calibrations",
        "openapi": "/openapi.json",
        "live": "/healthz",
        "ready": "/readyz",
    }
    return Index(name="joulemap", version=service.version, planners=list(PLANNERS), links=links)


@router.get("/", response_class=HTMLResponse, include_in_schema=False)
def home() -> str:
    """A page for people who look."""
    return resources.files("joulemap.service").joinpath("web/index.html").read_text(encoding="utf-8")
