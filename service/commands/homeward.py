"""`joulemap return`: until where a robot may follow its path and still come home."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, parse_point
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.words import duration_words, energy_words


def point_of_no_return(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.homeward:ReturnRequest -position"],
    position: Annotated[
        Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where the robot is. [default: the path's start]")
    ] = None,
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
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.homeward import ReturnRequest, answer, ask

    output = Output(json_file)
    if "path" not in wanted and position is None:
        raise typer.BadParameter("give --path, --position or both")
    if server is not None:
        with served(server, key, costmap) as map_there:
            values, notes = wanted.on(map_there.grid)
            found = map_there.homeward(_place(position, values), **values)
    else:
        ground = open_costmap(costmap)
        values, notes = wanted.on(ground.planner.lattice.frame)
        asked = ReturnRequest.of(position=_place(position, values), **values)
        found = answer(ask(ground.planner, asked), ground.warnings)
    output.warn(notes)
    _say(output, found.model_dump(mode="json"))


def _place(position: Any, values: dict[str, Any]) -> Any:
    return [float(v) for v in values["path"][0][:2]] if position is None else position


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
