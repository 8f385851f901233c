"""What routes take from FastAPI: the service as the caller sees it, with its kernels loaded, and pages of lists.

A route that is asked about a cost map takes all that it needs of the request as `OnCostmap`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from anyio.to_thread import run_sync
from fastapi import Depends, Query, Request, Response

from joulemap.service.http.long_questions import while_connected
from joulemap.service.http.service import Service
from joulemap.service.storage.owners import NOBODY, Caller
from joulemap.service.storage.tables import CostmapRow


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


@dataclass(frozen=True)
class OnCostmap:
    """A request about one cost map: its id, the service, and the request itself."""

    id: str
    service: Service
    request: Request

    async def row(self) -> CostmapRow:
        """Return the row of the cost map. Raises NotFoundError or ConflictError where it is not done."""
        return await run_sync(self.service.done_costmap, self.id)

    async def planned(self, work: Callable[[], Response]) -> Response:
        """Answer by work in the queue of plans, which ends where nobody waits for it any more."""
        return await while_connected(self.request, self.service.plans.do(self.id, work))

    async def priced(self, work: Callable[[], Response]) -> Response:
        """Answer by work in the queue of prices; likewise."""
        return await while_connected(self.request, self.service.prices.do(self.id, work))


async def _on_costmap(
    costmap_id: str, service: Annotated[Service, Depends(with_kernels)], request: Request
) -> OnCostmap:
    return OnCostmap(costmap_id, service, request)


ServiceDep = Annotated[Service, Depends(get_service)]
KernelsDep = Annotated[Service, Depends(with_kernels)]
CostmapDep = Annotated[OnCostmap, Depends(_on_costmap)]
Limit = Annotated[int, Query(ge=1, le=1000, description="most items in the answer")]
Offset = Annotated[int, Query(ge=0, le=10**9, description="items to skip")]
