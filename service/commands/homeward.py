"""`joulemap return`: until where a robot may follow its path and still come home."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.battery_file import BatteryFile, battery_values
from joulemap.service.commands.console import JsonFile, Output, parse_point
from joulemap.service.commands.options import Reserve, StateOfCharge, there
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.commands.route_files import PLACE
from joulemap.service.words import duration_words, energy_words


def point_of_no_return(
    costmap: MapOrId,
    home: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help=f"Where to come home to: {PLACE}.")],
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", callback=there, help="The rest of the path, as for `joulemap feasibility`."),
    ] = None,
    position: Annotated[
        Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where the robot is. [default: the path's start]")
    ] = None,
    charging: Annotated[
        list[Any] | None, typer.Option(metavar="X,Y...", parser=parse_point, help="Places to charge.")
    ] = None,
    charge: StateOfCharge = 1.0,
    reserve: Reserve = 0.0,
    capacity_wh: Annotated[
        float | None,
        typer.Option(metavar="WH", help="Energy of the full battery [Wh]. [default: the robot's battery_wh]"),
    ] = None,
    battery_file: BatteryFile = None,
    confidence: Annotated[
        float, typer.Option(min=0.5, max=0.99, metavar="0..1", help="Probability with which the battery must last.")
    ] = 0.95,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
) -> None:
    """Say until where a robot may follow its path and **still come home**: the point of no return.

    Ways home are counted over grid moves, as by `joulemap path --no-refine`: a refined path may need less energy.

    Examples:

    `joulemap return dem.zarr --path survey.geojson --home 12,40 --charge 0.5 --reserve 0.2`

    `joulemap return dem.zarr --position 80,60 --home 12,40 --charge 0.1 --charging 60,20`
    """
    from joulemap.model.battery import Battery
    from joulemap.service.commands.path_files import read_path
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.schemas.homeward import homeward_out

    output, given = Output(json_file), battery_values(battery_file, capacity_wh)
    given |= {"charge": charge, "reserve": reserve}
    if path is None and position is None:
        raise typer.BadParameter("give --path, --position or both")
    asked: dict[str, Any] = {"charging": charging or [], "confidence": confidence}
    if server is not None:
        with served(server, key, costmap) as map_there:
            points, notes = (None, []) if path is None else read_path(path, map_there.grid)
            answer = map_there.homeward(_place(position, points), home, path=points, battery=given, **asked)
    else:
        ground = open_costmap(costmap)
        points, notes = (None, []) if path is None else read_path(path, ground.planner.lattice.frame)
        battery = Battery.from_mapping({"capacity_wh": ground.robot.battery_wh} | given)
        found = ground.homeward(_place(position, points), home, path=points, battery=battery, **asked)
        answer = homeward_out(found, ground.warnings)
    output.warn(notes)
    _say(output, answer.model_dump(mode="json"))


def _place(position: Any, points: Any) -> Any:
    return [float(v) for v in points[0][:2]] if position is None else position


def _say(output: Output, found: dict[str, Any]) -> None:
    output.say(head=found["text"], style="bold green" if found["still_home"] else "bold red")
    rows = {}
    if (place := found["point_of_no_return"]) is not None:
        ahead = f"{place['distance_m']:.0f} m, {duration_words(place['time_s'])}"
        rows["point of no return"] = f"({place['x']:.2f}, {place['y']:.2f}), {ahead} ahead"
    for k, bail in enumerate(found["charging"]):
        if not bail["reachable"]:
            rows[f"charging place {k}"] = "out of reach"
            continue
        leave = bail["last"]
        until = "" if leave is None else f", leave the path after {leave['distance_m']:.0f} m at the latest"
        rows[f"charging place {k}"] = f"{energy_words(bail['energy_j'])} from here{until}"
    output.table(rows)
    output.warn(dict.fromkeys(found["warnings"]))
    output.document(found)
