"""What routes take from FastAPI: the service as the caller sees it, with its kernels loaded, and pages of lists."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query, Request

from joulemap.service.http.service import Service
from joulemap.service.storage.owners import NOBODY, Caller


async def get_service(request: Request) -> Service:
    """Return the service of the app that answers a request (a FastAPI dependency), as its caller sees it."""
    service: Service = request.app.state.service
    caller: Caller = request.state.caller
    return service if caller is NOBODY else service.seen_by(caller)


async def with_kernels(request: Request) -> Service:
    """Return the service once its kernels are loaded (a FastAPI dependency of routes that compute)."""
    service = await get_service(request)
    await service.kernels.loaded()
    return service


ServiceDep = Annotated[Service, Depends(get_service)]
KernelsDep = Annotated[Service, Depends(with_kernels)]
Limit = Annotated[int, Query(ge=1, le=1000, description="most items in the answer")]
Offset = Annotated[int, Query(ge=0, le=10**9, description="items to skip")]
