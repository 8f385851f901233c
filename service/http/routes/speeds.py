"""What a route costs at other speeds."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from joulemap.service.exports.clearance import price_given_path
from joulemap.service.http.asked import answer_of, same_robot, warnings_of
from joulemap.service.http.dependencies import KernelsDep
from joulemap.service.http.documents import problems
from joulemap.service.http.long_questions import while_connected
from joulemap.service.http.quick_json import QuickJsonRoute
from joulemap.service.places import Places
from joulemap.service.questions.speeds import SpeedsRequest
from joulemap.service.schemas.speeds import SpeedsOut, speeds_out
from joulemap.service.speeds import speeds_along

router = APIRouter(prefix="/costmaps/{costmap_id}", tags=["questions"], route_class=QuickJsonRoute)


@router.post("/speeds", response_model=SpeedsOut, responses=problems(404, 409, 503))
async def find_speeds(costmap_id: str, wanted: SpeedsRequest, service: KernelsDep, request: Request) -> Any:
    """The cheapest cruising speed of a route, and its energy against its time at every speed that the model knows.

    The route stays as it is for the robot's declared speed. A model that has seen one speed only, or that does not know
    what speed costs, such as `physics`, is refused.
    """

    def _find() -> Response:
        row = service.done_costmap(costmap_id)
        same_robot(row, wanted.robot)
        planner = service.maps.planner(costmap_id)
        places = Places(planner.lattice.frame)
        if wanted.path is not None:
            route = price_given_path(planner.lattice, places.path(wanted.path))
        else:
            planner = planner.avoiding(places.areas(wanted.avoid))
            ends = places(wanted.start, "start"), places(wanted.goal, "goal")
            route = planner.plan(*ends, snap=wanted.snap).route
        ground = service.store.open_heightmap(row.heightmap_id)
        found = speeds_along(route, planner.lattice, ground, service.find_predictor(row.request["model"]))
        return answer_of(speeds_out(found, places.noted(route), warnings_of(row)))

    return await while_connected(request, service.plans.do(costmap_id, _find))
