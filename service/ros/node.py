"""The node: it plans for Nav2, publishes what driving costs, follows the drive and says whether the battery lasts.

Its actions have the names of Nav2's planner server, so it takes its place in the launch file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from joulemap.model.errors import BlockedError, InputError, JoulemapError, NoRouteError, PointError
from joulemap.planner.route import Route
from joulemap.service.commands.console import Command, plain_errors
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.library.costmaps import CostMap, open_costmap
from joulemap.service.library.drive import Drive
from joulemap.service.ros.messages import Frame, Message, Ros

_SAME_M = 0.01  # a goal so near to the last place of the path adds nothing


class JoulemapNode:
    """Answers over a seam of ROS.

    Parameters
    ----------
    ros : Ros
        The node of ROS.
    costmap : CostMap
        What driving costs.
    origin : (float, float), optional
        World x, y of the origin of the frame [m].
    frame : str, optional
        Name of the frame of poses and odometry.
    reserve : float, optional
        Share of the battery that is to be left, 0..1.
    """

    def __init__(
        self,
        ros: Ros,
        costmap: CostMap,
        *,
        origin: tuple[float, float] = (0.0, 0.0),
        frame: str = "map",
        reserve: float = 0.0,
    ) -> None:
        self._ros, self._costmap, self._reserve = ros, costmap, reserve
        self._frame = Frame(ros, frame, origin)
        self._here: tuple[float, float] | None = None
        self._charge = math.nan
        self.drive: Drive | None = None
        ros.action("compute_path_to_pose", "nav2_msgs/action/ComputePathToPose", self._to_pose)
        ros.action("compute_path_through_poses", "nav2_msgs/action/ComputePathThroughPoses", self._through_poses)
        self._say = ros.publisher("joulemap/forecast", "diagnostic_msgs/msg/DiagnosticArray")
        ros.subscribe("odom", "nav_msgs/msg/Odometry", self._moved)
        ros.subscribe("battery_state", "sensor_msgs/msg/BatteryState", self._drew)
        costs = ros.publisher("joulemap/costs", "nav_msgs/msg/OccupancyGrid", latched=True)
        costs(self._frame.grid(costmap.lattice))

    def _to_pose(self, goal: Message, result: Message) -> bool:
        return self._answer(goal, [goal.goal], result)

    def _through_poses(self, goal: Message, result: Message) -> bool:
        goals = goal.goals  # a list; nav_msgs/Goals since Kilted; nav2_msgs/PoseStampedArray in between
        for name in ("goals", "poses"):
            goals = getattr(goals, name, goals)
        return self._answer(goal, goals, result)

    def _answer(self, goal: Message, goals: Sequence[Message], result: Message) -> bool:
        """Fill in the path; or say what is wrong, with the error code that this version of Nav2 has for it."""
        began = self._ros.stamp()
        try:
            result.path = self._plan(goal, goals)
        except (JoulemapError, ValueError) as error:
            self._ros.error(str(error))
            if hasattr(result, "error_code"):  # since Iron
                name = _code(error)
                result.error_code = getattr(goal if hasattr(goal, name) else result, name)
            if hasattr(result, "error_msg"):  # since Kilted
                result.error_msg = str(error)
            return False
        ended, took = self._ros.stamp(), result.planning_time
        nanoseconds = 1_000_000_000 * (ended.sec - began.sec) + ended.nanosec - began.nanosec
        took.sec, took.nanosec = divmod(nanoseconds, 1_000_000_000)
        return True

    def _plan(self, goal: Message, goals: Sequence[Message]) -> Message:
        """The path through all goals, which is followed from now on."""
        if not goals:
            raise InputError("there is no goal to plan to")
        places = [self._frame.world(pose.header.frame_id, pose.pose) for pose in goals]
        if goal.use_start:
            start = self._frame.world(goal.start.header.frame_id, goal.start.pose)
        elif self._here is not None:
            start = self._here
        else:
            raise InputError("start is not known: no odometry came yet, and `use_start` is false")
        points = [np.array([start])]
        for place in places:
            if math.dist(points[-1][-1], place) > _SAME_M:
                points.append(self._costmap.plan(tuple(points[-1][-1]), place, snap=True).points[:, :2])
        way = np.vstack(points)
        apart = np.append(True, np.hypot(*np.diff(way, axis=0).T) > 1e-9)
        if not apart[1:].any():
            raise InputError("the robot is at its goal: there is no way to plan")
        route = price_given_path(self._costmap.lattice, way[apart])
        self._follow(route)
        return self._frame.path(route, self._costmap.robot.speed_mps, goals[-1])

    def _follow(self, route: Route) -> None:
        """Follow a new route; Nav2 plans again on the way, and what was learnt of this run stays."""
        known, charge = self.drive, 1.0 if math.isnan(self._charge) else self._charge
        battery = replace(self._costmap.robot.battery, charge=charge, reserve=self._reserve)
        self.drive = self._costmap.drive(route, battery=battery)
        if known is not None:
            self.drive.tracking.keep_learnt(known.tracking)

    def _moved(self, odometry: Message) -> None:
        try:
            self._here = self._frame.world(odometry.header.frame_id, odometry.pose.pose)
        except ValueError as error:
            self._ros.error(str(error))

    def _drew(self, battery: Message) -> None:
        """Take in voltage and current, which is negative while it discharges, and say the forecast."""
        charge = float(battery.percentage)
        self._charge = charge if 0.0 <= charge <= 1.0 else math.nan
        power_w = -float(battery.voltage) * float(battery.current)
        if self.drive is None or self._here is None or not math.isfinite(power_w):
            return
        time_s = battery.header.stamp.sec + 1e-9 * battery.header.stamp.nanosec
        known = None if math.isnan(self._charge) else self._charge
        try:
            self.drive.update(time_s, self._here, power_w=power_w, charge=known)
        except JoulemapError as error:
            self._ros.error(str(error))
            return
        self._say(self._frame.forecast(self.drive.forecast()))


def _code(error: Exception) -> str:
    """The name of an error code of nav2_msgs."""
    which = "START" if str(error).startswith("start") else "GOAL"
    codes: dict[type[JoulemapError], str] = {
        PointError: f"{which}_OUTSIDE_MAP",
        BlockedError: f"{which}_OCCUPIED",
        NoRouteError: "NO_VALID_PATH",
    }
    if not isinstance(error, JoulemapError):
        return "TF_ERROR"
    return codes.get(type(error), "UNKNOWN")


class _Alone(Command):
    """A command without a group, whose errors are said as those of `joulemap`."""

    def invoke(self, ctx: Any) -> Any:
        with plain_errors():
            return super().invoke(ctx)


def main(
    costmap: Annotated[Path, typer.Argument(metavar="MAP.zarr", help="The cost map, as `joulemap costmap` wrote it.")],
    origin: Annotated[
        tuple[float, float], typer.Option("--origin", metavar="E N", help="World x, y of the origin of the frame [m].")
    ] = (0.0, 0.0),
    frame: Annotated[str, typer.Option("--frame", help="Name of the frame of poses and odometry.")] = "map",
    reserve: Annotated[float, typer.Option("--reserve", min=0.0, max=1.0, help="Share to be left, 0..1.")] = 0.0,
) -> None:
    """Start the node on rclpy."""
    ground = open_costmap(costmap)
    ros = Ros("planner_server")
    JoulemapNode(ros, ground, origin=origin, frame=frame, reserve=reserve)
    ros.spin()


def start() -> None:
    """Entry point of the command `joulemap-ros`."""
    app = typer.Typer(add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False)
    app.command("joulemap-ros", cls=_Alone)(main)
    app()
