"""What questions to a cost map share: the robot that is meant, the cost map's warnings, the answer as it is."""

from __future__ import annotations

from fastapi import Response
from pydantic import BaseModel

from joulemap.model.errors import ConflictError
from joulemap.model.robot import Robot
from joulemap.service.problems import jsonable
from joulemap.service.schemas.base import robot_values
from joulemap.service.storage.tables import CostmapRow


def answer_of(body: BaseModel) -> Response:
    """Return an answer as it is: it was validated when it was made, and FastAPI need not do it again.

    Parameters
    ----------
    body : BaseModel
        The answer.

    Returns
    -------
    Response
        JSON.
    """
    return Response(body.model_dump_json(), media_type="application/json")


def warnings_of(row: CostmapRow) -> list[str]:
    """Return what the maker of a cost map warned of.

    Parameters
    ----------
    row : CostmapRow
        Of a cost map that is done.

    Returns
    -------
    list of str
        In words.
    """
    return list((row.summary or {}).get("provenance", {}).get("warnings", []))


def same_robot(row: CostmapRow, given: BaseModel | None) -> Robot:
    """Return the robot of a cost map.

    Parameters
    ----------
    row : CostmapRow
        Of the cost map.
    given : BaseModel or None
        The robot of a question, which must be this one or the one that was asked for.

    Returns
    -------
    Robot
        The cost map's.

    Raises
    ------
    ConflictError
        If another one is given; it names the fields.
    RobotError
        If what is given is no robot.
    """
    robot, values = Robot.from_mapping(row.robot), robot_values(given)
    Robot.from_mapping(values)
    differing = {
        key: (getattr(robot, key), value)
        for key, value in values.items()
        if value not in (getattr(robot, key), row.request["robot"][key])
    }
    if differing:
        words = ", ".join(f"{key} {there}, not {here}" for key, (there, here) in differing.items())
        raise ConflictError(
            f"cost map {row.id} was made for another robot ({words}): make a cost map for this robot",
            fields=sorted(differing),
            costmap_robot=jsonable({key: there for key, (there, _) in differing.items()}),
            given_robot=jsonable({key: here for key, (_, here) in differing.items()}),
        )
    return robot
