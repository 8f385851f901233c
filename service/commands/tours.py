"""`joulemap tour`: several places and home again, in the order that costs least."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.commands.route_files import RouteCoordinates, RouteFiles, RouteFormatName, wanted_files
from joulemap.service.words import route_words


def tour(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.tour:TourRequest"],
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
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.tour import TourRequest, answer, ask, track

    output, files = Output(json_file), wanted_files(out, format, coordinates, geojson)
    if server is not None:
        with served(server, key, costmap) as map_there:
            for file in files:
                file.check(map_there.crs)
            values, notes = wanted.on(map_there.grid)
            output.warn(notes)
            document = map_there.tour(**values)
            for file in files:
                write_file(file.path, map_there.tour_file(**values, **file.query))
        _say_tour(output, document.model_dump(mode="json"), map_there.about.robot.name)
        return
    ground = open_costmap(costmap)
    for file in files:
        file.check(ground.crs)
    values, notes = wanted.on(ground.lattice.frame)
    output.warn(notes)
    with progress_bar("Tour") as report:
        found = ask(ground.planner, TourRequest.of(**values), progress=report)
    for file in files:
        write_file(file.path, file.content(track(found, ground.warnings)))
    _say_tour(output, answer(found, ground.warnings).model_dump(mode="json"), ground.robot.name)


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
