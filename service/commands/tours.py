"""`joulemap tour`: several places and home again, in the order that costs least."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, json_text, parse_point, progress_bar, write_file
from joulemap.service.commands.maps import MapFolder
from joulemap.service.commands.options import Reserve, StateOfCharge
from joulemap.service.words import route_words


def tour(
    costmap: MapFolder,
    stop: Annotated[
        list[Any],
        typer.Option(metavar="X,Y...", parser=parse_point, help="Places to visit [m, map's CRS], home first."),
    ],
    neighbours: Annotated[int, typer.Option(help="Moves of the grid: 8, 16 or 32.")] = 16,
    refine: Annotated[bool, typer.Option(help="Improve the legs to any angle.")] = True,
    time_limit: Annotated[float, typer.Option(min=0.01, help="Seconds for proving the order.")] = 10.0,
    charge: StateOfCharge = 1.0,
    reserve: Reserve = 0.0,
    geojson: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the legs as GeoJSON.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Visit several places and **come home with least energy**: the order, the legs, and whether the battery lasts.

    Needs the extra `tours` (OR-tools).

    Example:

    `joulemap tour dem.zarr --stop 12,40 180,95 90,20 --charge 0.8 --geojson tour.geojson`
    """
    from joulemap.model.robot import Battery
    from joulemap.planner.lattice_io import load_lattice
    from joulemap.planner.plan import RoutePlanner
    from joulemap.service.schemas.tours import tour_geojson, tour_out
    from joulemap.service.workflows import judge_routes

    output = Output(json_file)
    lattice = load_lattice(costmap)
    with progress_bar("Tour") as report:
        trip = RoutePlanner(lattice).tour(
            stop, neighbours=neighbours, refine=refine, time_limit_s=time_limit, progress=report
        )
    battery = Battery(lattice.robot.battery_wh, charge=charge, reserve=reserve)
    known = lattice.provenance.get("warnings", [])
    found = tour_out(trip, judge_routes(lattice, trip.legs, battery), known).model_dump(mode="json")
    way = " -> ".join(str(k) for k in (*found["order"], 0))
    output.say(f"[bold]Tour[/] for {lattice.robot.name}: {way}{'' if found['proven'] else ' (not proven the best)'}")
    ends = zip(found["order"], (*found["order"][1:], 0), strict=True)
    output.table(
        {f"{here} to {there}": route_words(leg) for (here, there), leg in zip(ends, found["legs"], strict=True)}
        | {"all": route_words(found)}
    )
    output.say(f"[bold {'green' if found['battery']['feasible'] else 'red'}]{found['battery']['message']}[/]")
    output.warn(found["warnings"])
    if geojson is not None:
        write_file(geojson, json_text(tour_geojson(trip, known)).encode())
    output.document(found)
