"""The page at `/`: its own files, Leaflet and plotly.js from their packages, and what it has to know at the start."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from xstatic.pkg import leaflet

from joulemap.model.energy.predictor import MODEL_NAMES
from joulemap.model.errors import NotFoundError
from joulemap.model.terrain.formats import formats_in_words
from joulemap.model.terrain.layers.kinds import library
from joulemap.model.terrain.synthesis import SAMPLE_GOAL, SAMPLE_START, sample_terrain
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.http.dependencies import ServiceDep

router = APIRouter(include_in_schema=False)

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""Nothing is loaded from elsewhere but pictures of the base map, and no script or style stands in the document."""

VIEW_3D_POLICY = POLICY.replace("style-src 'self'", "style-src 'self' 'unsafe-inline'").replace(
    "frame-ancestors 'none'", "frame-ancestors 'self'"
)
"""plotly.js writes styles into the document of the 3-D view, which is shown inside the page."""

_WEB = resources.files("joulemap.service").joinpath("web")
_KINDS = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_LEAFLET = "leaflet.js", "leaflet.css"
_FOREVER = {"Cache-Control": "public, max-age=31536000, immutable"}  # the address has the version


def headers_of(policy: str) -> dict[str, str]:
    """Return the headers of a page."""
    return {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-cache",
    }


@router.get("/")
def home(service: ServiceDep) -> HTMLResponse:
    """The page."""
    host = urlsplit(service.settings.basemap_url)
    pictures = f"img-src {host.scheme}://{host.netloc}" if host.netloc else "img-src"
    return _page("index.html", POLICY.replace("img-src", pictures))


@router.get("/page/view3d.html")
def view_3d() -> HTMLResponse:
    """The document of the 3-D view, which is shown inside the page."""
    return _page("view3d.html", VIEW_3D_POLICY)


SAMPLE = {"name": "joulemap sample", "start": SAMPLE_START, "goal": SAMPLE_GOAL, "capacity_wh": 6.0}
"""What the page opens first: twice the energy of its route, so that the battery's curve tells something [Wh]."""


@router.get("/page/start.json")
def start(request: Request, service: ServiceDep) -> JSONResponse:
    """What the page has to know before it asks anything: what this service can do, the sample, the robot's fields."""
    document, settings = request.app.openapi(), service.settings
    fields, url = document["components"]["schemas"], settings.basemap_url
    return JSONResponse(
        {
            "version": service.version,
            "planners": fields["PathRequest"]["properties"]["planner"]["enum"],
            "path_formats": _formats(document["paths"]["/v1/costmaps/{costmap_id}/paths"]["post"]),
            "models": list(MODEL_NAMES),
            "most_values": settings.max_lattice_values,
            "robot": fields["RobotIn"]["properties"],
            "kinds": {name: kind.rolling_resistance for name, kind in library().items()},
            "formats": formats_in_words(),
            "sample": SAMPLE,
            "plotly": plotly_version(),
            "basemap": {"url": url, "attribution": settings.basemap_attribution} if url else None,
        },
        headers={"Cache-Control": "no-cache"},
    )


@router.get("/page/sample.tif")
def sample() -> Response:
    """The heightmap of the demo."""
    return Response(_sample(), media_type="image/tiff")


@router.get("/page/{name}")
def own_file(name: str) -> Response:
    """A script, style or picture of the page."""
    kind = _KINDS.get(Path(name).suffix)
    if kind is None or name not in _own_files():
        raise _unknown(name)
    return Response(_WEB.joinpath(name).read_bytes(), media_type=kind, headers={"Cache-Control": "no-cache"})


@router.get("/page/leaflet/{release}/{name}")
def leaflet_file(release: str, name: str) -> FileResponse:
    """Leaflet, of the installed version."""
    if release != leaflet.VERSION or name not in _LEAFLET:
        raise _unknown(f"leaflet/{release}/{name}")
    return FileResponse(Path(leaflet.BASE_DIR) / name, headers=_FOREVER)


@router.get("/page/plotly/{release}/plotly.min.js")
def plotly_file(release: str) -> FileResponse:
    """plotly.js, of the installed package; the page loads it for its 3-D view alone."""
    spec = find_spec("plotly")
    if spec is None or spec.origin is None or release != plotly_version():
        raise _unknown(f"plotly/{release}/plotly.min.js")
    return FileResponse(Path(spec.origin).parent / "package_data" / "plotly.min.js", headers=_FOREVER)


@cache
def plotly_version() -> str | None:
    """Return the version of the installed package plotly."""
    try:
        return version("plotly")
    except PackageNotFoundError:
        return None


def _page(name: str, policy: str) -> HTMLResponse:
    text = _WEB.joinpath(name).read_text(encoding="utf-8")
    modules = sorted(file for file in _own_files() if file.endswith(".js") and file not in ("main.js", "view3d.js"))
    early = "\n".join(f'<link rel="modulepreload" href="page/{file}">' for file in modules)  # all at once, not in turn
    for name_in_braces, value in (("modules", early), ("leaflet", leaflet.VERSION), ("plotly", plotly_version() or "")):
        text = text.replace(f"{{{name_in_braces}}}", value)
    return HTMLResponse(text, headers=headers_of(policy))


@cache
def _own_files() -> frozenset[str]:
    return frozenset(file.name for file in _WEB.iterdir())


@cache
def _sample() -> bytes:
    data = write_geotiff(None, sample_terrain())
    assert data is not None
    return data


def _formats(operation: Mapping[str, Any]) -> list[str]:
    """What the parameter `format` of a question may be."""
    schema = next(one["schema"] for one in operation["parameters"] if one["name"] == "format")
    return next(one["enum"] for one in (schema, *schema.get("anyOf", [])) if "enum" in one)


def _unknown(name: str) -> NotFoundError:
    return NotFoundError(f"the page has no file {name[:80]!r}", name=name[:80])
