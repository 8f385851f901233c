"""Makes the FastAPI app out of settings: nothing is opened, started or read before it runs."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import anyio
from fastapi import FastAPI

from joulemap.service import problems
from joulemap.service.http import documents
from joulemap.service.http.limits import RequestLimits
from joulemap.service.http.routes import calibrations, contents, costmaps, heightmaps, meta, questions, runs
from joulemap.service.http.state import Service
from joulemap.service.settings import Settings

DESCRIPTION = """Energy planner for ground robots: a heightmap in, a directional cost map, an energy-optimal path and a
battery verdict out; measured runs in, what the model lacked and a model that has it out. World coordinates are metres
in the heightmap's CRS (x east, y north); headings are clockwise from north; energies are joules unless a field says
otherwise. Errors are RFC 9457 problems."""


def create_app(settings: Settings | None = None) -> FastAPI:
    """The app for these settings (default: from the environment). Its service starts and stops with its lifespan."""
    settings = settings or Settings()
    service = Service(settings)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        await anyio.to_thread.run_sync(service.start)
        try:
            yield
        finally:
            await anyio.to_thread.run_sync(service.stop)

    app = FastAPI(
        title="joulemap",
        version=version("joulemap"),
        description=DESCRIPTION,
        lifespan=lifespan,
        generate_unique_id_function=lambda route: route.name,
        docs_url=None,
        redoc_url=None,
    )
    app.state.service = service
    app.include_router(meta.router)
    for module in (heightmaps, costmaps, contents, questions, runs, calibrations):
        app.include_router(module.router, prefix="/v1")
    problems.install(app)
    documents.install(app)
    app.add_middleware(
        RequestLimits,
        upload_bytes=int(settings.max_upload_mb * 1e6),
        other_bytes=int(settings.max_json_mb * 1e6),
        upload_paths=("/v1/heightmaps", "/v1/costmaps", "/v1/runs"),
    )
    return app


def openapi_document() -> dict[str, Any]:
    """The OpenAPI 3.1 document, the same on every machine."""
    return create_app(Settings(data_dir=Path("data"))).openapi()


if __name__ == "__main__":
    print(json.dumps(openapi_document(), indent=2, ensure_ascii=False))
