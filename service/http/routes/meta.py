"""Where to start, the documentation to click through, and whether the service is alive and ready."""

from __future__ import annotations

import re
from base64 import b64encode
from hashlib import sha256
from importlib import resources

from fastapi import APIRouter, Response
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import FileResponse, HTMLResponse, PlainTextResponse
from pydantic import BaseModel, Field

from joulemap.model.errors import NotFoundError
from joulemap.planner.route_planner import PLANNERS
from joulemap.service.http.dependencies import ServiceDep
from joulemap.service.http.documents import problems
from joulemap.service.http.metrics import MEDIA_TYPE
from joulemap.service.http.routes.page import headers_of

router = APIRouter(tags=["service"])
_SWAGGER_UI = "fastapi_swagger"  # the package that carries Swagger UI, so that the page needs no address outside
_DOCS_POLICY = (
    "default-src 'none'; script-src 'self' {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Swagger UI writes styles into the document; of scripts in it only that which FastAPI starts it with may run."""
_SCRIPT, _STYLE, _ICON = "swagger-ui-bundle.js", "swagger-ui.css", "favicon-32x32.png"


class Live(BaseModel):
    """The process is alive."""

    status: str = Field(examples=["live"])


class Ready(BaseModel):
    """The service can answer at full speed."""

    status: str = Field(examples=["ready"])
    warm_up_s: float = Field(description="how long loading or compiling the kernels took [s]")
    checks: dict[str, str] = Field(
        description="what the latest look at each part found: `ok`", examples=[{"database": "ok", "disk": "ok"}]
    )


class Index(BaseModel):
    """Where everything is."""

    name: str
    version: str
    planners: list[str]
    links: dict[str, str]


@router.get("/healthz")
async def healthz() -> Live:
    """Whether the process is alive."""
    return Live(status="live")


@router.get("/readyz", responses={503: problems(503)[503]})
async def readyz(service: ServiceDep) -> Ready:
    """Whether the database answers, files can be written, and all kernels are loaded, so that no question is slow.

    The service looks every few seconds and answers from what it saw last: this costs nothing and waits for nothing.
    """
    return Ready(status="ready", warm_up_s=service.check_ready(), checks=service.health.results())


@router.get("/metrics", response_class=PlainTextResponse)
async def metrics(service: ServiceDep) -> Response:
    """Numbers for Prometheus: requests, queues, the cost maps in memory, jobs, checks, stalls of the event loop."""
    return Response(service.metrics.text(), media_type=MEDIA_TYPE)


@router.get("/v1")
async def index(service: ServiceDep) -> Index:
    """Links to everything, and the planners that there are."""
    links = {
        "heightmaps": "/v1/heightmaps",
        "costmaps": "/v1/costmaps",
        "runs": "/v1/runs",
        "calibrations": "/v1/calibrations",
        "docs": "/docs",
        "openapi": "/openapi.json",
        "live": "/healthz",
        "ready": "/readyz",
        "metrics": "/metrics",
    }
    return Index(name="joulemap", version=service.version, planners=list(PLANNERS), links=links)


@router.get("/docs", response_class=HTMLResponse, include_in_schema=False)
def docs() -> HTMLResponse:
    """Every request with its fields, to read and to try; served without any other server."""
    page = get_swagger_ui_html(
        openapi_url="openapi.json",
        title="joulemap: HTTP API",
        swagger_js_url=f"docs/static/{_SCRIPT}",
        swagger_css_url=f"docs/static/{_STYLE}",
        swagger_favicon_url=f"docs/static/{_ICON}",
        swagger_ui_parameters={"validatorUrl": None},  # which would send the document to swagger.io
    )
    scripts = re.findall(rb"<script>(.*?)</script>", bytes(page.body), re.DOTALL)
    hashes = " ".join(f"'sha256-{b64encode(sha256(script).digest()).decode()}'" for script in scripts)
    page.headers.update(headers_of(_DOCS_POLICY.format(scripts=hashes)))
    return page


@router.get("/docs/static/{name}", include_in_schema=False)
def docs_file(name: str) -> FileResponse:
    """A file that the page of the documentation needs."""
    if name not in (_SCRIPT, _STYLE, _ICON):
        raise NotFoundError(f"the documentation has no file {name[:80]!r}", name=name[:80])
    return FileResponse(str(resources.files(_SWAGGER_UI) / "resources" / name))
