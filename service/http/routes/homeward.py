"""The point of no return of a robot that asks on its way."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from joulemap.service.homeward import homeward
from joulemap.service.http.asked import answer_of, same_robot, warnings_of
from joulemap.service.http.dependencies import KernelsDep
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.places import Places
from joulemap.service.questions.homeward import ReturnRequest
from joulemap.service.questions.parts import battery_of
from joulemap.service.schemas.homeward import ReturnOut, homeward_out

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)


@router.post("/return", response_model=ReturnOut, responses=problems(404, 409, 503))
async def find_point_of_no_return(costmap_id: str, wanted: ReturnRequest, service: KernelsDep, request: Request) -> Any:
    """Until where a robot may follow the rest of its path and still come home, or still reach a place to charge.

    Made for a robot that asks every second with its place, the rest of its path and its measured charge. The first
    question about a home takes as long as an energy field; the energies are kept, and the next ones take milliseconds.
    """

    def _find() -> Response:
        row = service.done_costmap(costmap_id)
        battery = battery_of(wanted.battery, same_robot(row, wanted.robot))
        planner = service.maps.planner(costmap_id)
        places = Places(planner.lattice.frame)
        found = homeward(
            planner.avoiding(places.areas(wanted.avoid)),
            places(wanted.position, "position"),
            places(wanted.home, "home"),
            battery,
            path=None if wanted.path is None else places.path(wanted.path),
            charging=[places(place, f"charging place {k}") for k, place in enumerate(wanted.charging)],
            confidence=wanted.confidence,
        )
        return answer_of(homeward_out(found, [*places.notes, *warnings_of(row)]))

    return await while_connected(request, service.prices.do(costmap_id, _find))
