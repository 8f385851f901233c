"""Makes the FastAPI app from settings; nothing is opened, started or read before the app runs."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import anyio
from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

from joulemap.service.hosting.settings import Settings
from joulemap.service.http import documents, problem_answers
from joulemap.service.http.access import Admission, KeyCheck, Keys, TrustedPages, warn_if_open
from joulemap.service.http.middleware import RequestLimits, SlowClients
from joulemap.service.http.observed import Observed
from joulemap.service.http.routes import (
    calibrations,
    contents,
    costmaps,
    drives,
    jobs,
    layers,
    meta,
    page,
    questions,
    sent,
)
from joulemap.service.http.service import Service
from joulemap.service.http.watched import on_the_loop

DESCRIPTION = """Energy planner for ground robots. Send a heightmap, and ask for a directional cost map, energy-optimal
paths and battery verdicts. Send measured runs, and ask which effects the model does not contain; you get a calibrated
model that contains them. World coordinates are metres in the heightmap's CRS (x east, y north). Headings are clockwise
from north. Energies are joules unless a field says otherwise. Errors are RFC 9457 problems."""


def create_app(settings: Settings | None = None) -> FastAPI:
    """Return the app; its service starts and stops with the app's lifespan."""
    settings = settings or Settings()
    service = Service(settings)

    @asynccontextmanager
    async def _lifespan(_app: FastAPI) -> AsyncIterator[None]:
        await anyio.to_thread.run_sync(service.start, asyncio.get_running_loop())
        threading.Thread(target=app.openapi, name="openapi", daemon=True).start()  # seconds, which the page would wait
        await anyio.to_thread.run_sync(warn_if_open, service.store, settings.host)
        try:
            async with on_the_loop(service.metrics, service.queues), service.retention.running():
                yield
        finally:
            await anyio.to_thread.run_sync(service.stop)

    app = FastAPI(
        title="joulemap",
        version=version("joulemap"),
        description=DESCRIPTION,
        lifespan=_lifespan,
        generate_unique_id_function=lambda route: route.name,
        docs_url=None,
        redoc_url=None,
    )
    app.state.service = service
    for module in (  # the first routes are found soonest
        questions,
        sent,
        costmaps,
        contents,
        calibrations,
        jobs,
        drives,
        layers,
    ):
        app.include_router(module.router, prefix="/v1")
    app.include_router(meta.router)
    app.include_router(page.router)
    problem_answers.install(app)
    documents.install(app)
    # The middleware that is added last sees a request first.
    keys = Keys(service.store, settings)
    app.add_middleware(KeyCheck, keys=keys, away=service.database_is_away, answered=service.answered)
    app.add_middleware(
        CORSMiddleware,
        allow_origins=settings.cors_origins,
        allow_methods=("GET", "POST", "DELETE"),
        allow_headers=("Authorization", "X-API-Key", "Content-Type", "Prefer", "X-Request-ID", "Last-Event-ID"),
        expose_headers=("Location", "Retry-After", "X-Request-ID", "Preference-Applied"),
    )
    app.add_middleware(
        TrustedPages,
        host=settings.host,
        allowed_hosts=settings.allowed_hosts,
        cors_origins=settings.cors_origins,
    )
    app.add_middleware(
        RequestLimits,
        upload_bytes=int(settings.max_upload_mb * 1e6),
        other_bytes=int(settings.max_json_mb * 1e6),
        upload_paths=("/v1/heightmaps", "/v1/costmaps", "/v1/runs"),
    )
    app.add_middleware(Admission, most=settings.max_connections, each=service.answered)
    app.add_middleware(SlowClients, stalled_s=settings.stalled_s)
    app.add_middleware(Observed, metrics=service.metrics)
    return app


def openapi_document() -> dict[str, Any]:
    """Return the OpenAPI 3.1 document, which is the same on every machine."""
    return create_app(Settings(data_dir=Path("data"))).openapi()


if __name__ == "__main__":
    print(json.dumps(openapi_document(), indent=2, ensure_ascii=False))
