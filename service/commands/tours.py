"""`joulemap tour`: several places and home again, in the order that costs least."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.battery_file import BatteryFile, battery_values
from joulemap.service.commands.console import JsonFile, Output, parse_point, progress_bar, write_file
from joulemap.service.commands.options import Avoid, Reserve, Snap, StateOfCharge
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.commands.route_files import PLACE, RouteCoordinates, RouteFiles, RouteFormatName, wanted_files
from joulemap.service.words import route_words


def tour(
    costmap: MapOrId,
    stop: Annotated[
        list[Any],
        typer.Option(metavar="X,Y...", parser=parse_point, help=f"Places to visit, home first: {PLACE}."),
    ],
    neighbours: Annotated[int, typer.Option(metavar="N", help="Directions of a step on the grid: 8, 16 or 32.")] = 16,
    refine: Annotated[bool, typer.Option(help="Straighten the legs to any angle.")] = True,
    time_limit: Annotated[
        float, typer.Option(min=0.01, metavar="S", help="Longest search for the best order [s].")
    ] = 10.0,
    charge: StateOfCharge = 1.0,
    reserve: Reserve = 0.0,
    capacity_wh: Annotated[
        float | None,
        typer.Option(metavar="WH", help="Energy of the full battery [Wh]. [default: the robot's battery_wh]"),
    ] = None,
    battery_file: BatteryFile = None,
    snap: Snap = False,
    avoid: Avoid = None,
    out: RouteFiles = None,
    format: RouteFormatName = None,
    coordinates: RouteCoordinates = None,
    geojson: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the legs as GeoJSON.")] = None,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
) -> None:
    """Find the **round trip of least energy** over several places: the order, the legs, and whether the battery lasts.

    Needs the extra `tours` (OR-tools).

    Example:

    `joulemap tour dem.zarr --stop 12,40 180,95 90,20 --charge 0.8 --out tour.geojson`

    `joulemap tour dem.zarr --stop 12,40 180,95 90,20 --charge 0.8 --reserve 0.2 --battery pack.toml`
    """
    from joulemap.model.battery import Battery
    from joulemap.service.commands.path_files import read_areas
    from joulemap.service.feasibility import judge_routes
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.schemas.tours import tour_out

    output, files = Output(json_file), wanted_files(out, format, coordinates, geojson)
    given = {**battery_values(battery_file, capacity_wh), "charge": charge, "reserve": reserve}
    if server is not None:
        asked: dict[str, Any] = {"neighbours": neighbours, "refine": refine, "snap": snap, "time_limit_s": time_limit}
        with served(server, key, costmap) as map_there:
            for file in files:
                file.check(map_there.crs)
            asked["avoid"], notes = read_areas(avoid, map_there.grid)
            output.warn(notes)
            answer = map_there.tour(stop, **asked, battery=given)
            for file in files:
                write_file(file.path, map_there.tour_file(stop, **file.query, **asked))
        _say_tour(output, answer.model_dump(mode="json"), map_there.about.robot.name)
        return
    ground = open_costmap(costmap)
    for file in files:
        file.check(ground.crs)
    areas, notes = read_areas(avoid, ground.lattice.frame)
    output.warn(notes)
    with progress_bar("Tour") as report:
        planned = ground.tour(
            stop, neighbours=neighbours, refine=refine, snap=snap, time_limit_s=time_limit, avoid=areas, progress=report
        )
    trip = planned.found
    battery = Battery.from_mapping({"capacity_wh": ground.robot.battery_wh, **given})
    found = tour_out(trip, judge_routes(ground.lattice, trip.legs, battery), ground.warnings).model_dump(mode="json")
    for file in files:
        write_file(file.path, file.content(planned.track))
    _say_tour(output, found, ground.robot.name)


def _say_tour(output: Output, found: dict[str, Any], robot: str) -> None:
    way = " -> ".join(str(k) for k in (*found["order"], 0))
    output.say(f"for {robot}: {way}{'' if found['proven'] else ' (not proven the best)'}", head="Tour")
    ends = zip(found["order"], (*found["order"][1:], 0), strict=True)
    output.table(
        {f"{here} to {there}": route_words(leg) for (here, there), leg in zip(ends, found["legs"], strict=True)}
        | {"all": route_words(found)}
    )
    verdict = found["battery"]
    colour = {"yes": "green", "likely": "green", "marginal": "yellow", "no": "red"}[verdict["verdict"]]
    output.say(head=verdict["message"], style=f"bold {colour}")
    output.say(verdict["verdict_text"])
    output.warn(found["warnings"])
    output.document(found)
