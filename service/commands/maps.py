"""`joulemap costmap`, `path` and `feasibility`: from a heightmap to a route and a verdict, without a service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.console import Answer, JsonFile, parse_point, progress_bar, write_file
from joulemap.service.commands.options import ModelName, Overwrite, RobotFile, refuse_to_replace, robot_of, there
from joulemap.service.words import route_words, saving_words

MapFolder = Annotated[
    Path, typer.Argument(metavar="MAP.zarr", callback=there, help="A cost map made by `joulemap costmap`.")
]


def costmap(
    heightmap: Annotated[
        Path,
        typer.Argument(
            metavar="HEIGHTMAP", callback=there, help="GeoTIFF, ESRI ASCII (.asc), .npy, .npz or 16-bit PNG."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="MAP.zarr", help="Folder to write the cost map to.")],
    robot: RobotFile = None,
    model: ModelName = "default",
    spacing: Annotated[float, typer.Option(min=0.01, help="Side of a cell of the cost map [m].")] = 1.0,
    headings: Annotated[int, typer.Option(min=4, max=360, help="Heading bins per cell.")] = 16,
    resolution: Annotated[
        float | None, typer.Option(help="Side of a heightmap cell [m], where the file does not say.")
    ] = None,
    west: Annotated[float, typer.Option(help="Western edge of the map [m], where the file does not say.")] = 0.0,
    north: Annotated[
        float | None, typer.Option(help="Northern edge [m], likewise. [default: the southern edge is at 0]")
    ] = None,
    crs: Annotated[str | None, typer.Option(help="Its coordinate system, likewise, e.g. EPSG:32630.")] = None,
    scale: Annotated[float | None, typer.Option(help="Metres per stored unit (needed for PNG).")] = None,
    offset: Annotated[float, typer.Option(help="Metres added to every height.")] = 0.0,
    nodata: Annotated[float | None, typer.Option(help="Stored value that means unknown.")] = None,
    band: Annotated[int | None, typer.Option(min=1, help="Band of a GeoTIFF with several.")] = None,
    geotiff: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a GeoTIFF, a band per heading [J/m].")
    ] = None,
    npz: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write a NumPy .npz.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also draw it, mean over headings (PNG).")
    ] = None,
    overwrite: Overwrite = False,
    json_file: JsonFile = None,
) -> None:
    """Make a **cost map**: energy per metre for every cell and heading, and where the robot cannot go and why.

    Examples:

    `joulemap costmap dem.tif --robot robot.toml --out dem.zarr`

    `joulemap costmap heights.png --resolution 0.5 --scale 0.01 --model physics --out heights.zarr`
    """
    from joulemap.model.terrain.readers import open_ground
    from joulemap.service.workflows import write_cost_lattice

    answer = Answer(json_file)
    refuse_to_replace(out, overwrite=overwrite)
    ground = open_ground(
        heightmap,
        resolution_m=resolution,
        west_m=west,
        north_m=north,
        crs=crs,
        scale_m=scale,
        offset_m=offset,
        nodata=nodata,
        band=band,
    )
    rover = robot_of(robot)
    with progress_bar("Cost map") as report:
        made = write_cost_lattice(
            out, ground, rover, model=model, spacing_m=spacing, headings=headings, progress=report
        )
    _also_as(out, geotiff, npz, picture)
    frame, warnings = made.frame, made.provenance["warnings"]
    price, blocked = made.figures["energy_per_m"], made.figures["blocked"]
    words = ", ".join(f"{share:.1%} {reason.replace('_', ' ')}" for reason, share in blocked.items() if share > 0)
    answer.say(f"[bold]Cost map[/] of {ground.source} for {rover.name}, model {made.provenance['model']['name']}")
    answer.table(
        {
            "cells": f"{frame.rows} rows x {frame.cols} columns of {frame.resolution_m:g} m, {headings} headings",
            "energy": "{min:.1f} .. {max:.1f} J/m, mean {mean:.1f} J/m".format(**price) if price else "nothing is free",
            "ground": words,
            "written": str(out),
        }
    )
    answer.warn(warnings)
    answer.document(
        {
            "heightmap": {**made.provenance["heightmap"], "rows": ground.frame.rows, "cols": ground.frame.cols},
            "rows": frame.rows,
            "cols": frame.cols,
            "spacing_m": frame.resolution_m,
            "headings": headings,
            "bounds": list(frame.bounds),
            "crs": frame.crs,
            "robot": made.robot.as_dict(),
            "provenance": made.provenance,
            "warnings": warnings,
            "out": str(out),
            **made.figures,
        }
    )


def _also_as(folder: Path, geotiff: Path | None, npz: Path | None, picture: Path | None) -> None:
    """Other files of a cost map; it is only read, as a whole, when one is wanted."""
    if geotiff is None and npz is None and picture is None:
        return
    from joulemap.planner.lattice_io import export_geotiff, export_npz, load_lattice
    from joulemap.service.pictures import lattice_image

    lattice = load_lattice(folder)
    for place, make in ((geotiff, export_geotiff), (npz, export_npz), (picture, lattice_image)):
        if place is not None:
            write_file(place, make(lattice))


def path(
    costmap: MapFolder,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to start [m, map's CRS].")],
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to go [m, map's CRS].")],
    planner: Annotated[
        str,
        typer.Option(help="astar or dijkstra (exact on the grid); rrtstar, informed_rrtstar or bitstar (sampling)."),
    ] = "astar",
    neighbours: Annotated[int, typer.Option(help="Moves of the grid planners: 8, 16 or 32.")] = 16,
    refine: Annotated[bool, typer.Option(help="Improve the grid path to any angle.")] = True,
    time_limit: Annotated[float, typer.Option(min=0.01, help="Seconds for the sampling planners.")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sampling planners.")] = 0,
    alternatives: Annotated[int, typer.Option(min=0, metavar="K", help="Other good ways to look for, at most.")] = 0,
    geojson: Annotated[Path | None, typer.Option(metavar="FILE", help="Write all paths as GeoJSON.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw all paths, and the profiles of two (PNG).")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Find the **energy-optimal path** on a cost map, and say what it saves against the shortest one.

    Examples:

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --picture path.png`

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --planner bitstar --time-limit 10 --json -`
    """
    from joulemap.model.terrain.heightmap import Heightmap
    from joulemap.planner.lattice_io import load_lattice
    from joulemap.planner.plan import RoutePlanner
    from joulemap.service.schemas.answers import path_geojson, path_out

    answer = Answer(json_file)
    lattice = load_lattice(costmap)
    plan = RoutePlanner(lattice).plan(
        start,
        goal,
        planner=planner,
        neighbours=neighbours,
        refine=refine,
        time_limit_s=time_limit,
        seed=seed,
        alternatives=alternatives,
    )
    known = lattice.provenance.get("warnings", [])
    found = path_out(plan, None, known).model_dump(mode="json")
    answer.say(f"[bold]Path[/] for {lattice.robot.name}, planner {plan.planner}")
    answer.table(
        {
            "energy-optimal": route_words(found),
            **{f"alternative {k}": route_words(other) for k, other in enumerate(found["alternatives"], 1)},
            "shortest": route_words(found["shortest"]),
            "saved": saving_words(found, found["shortest"]),
        }
    )
    answer.warn(found["warnings"])
    if geojson is not None:
        write_file(geojson, json.dumps(path_geojson(plan, None, known)).encode())
    if picture is not None:
        from joulemap.service.pictures import route_picture

        ground = Heightmap(lattice.elevation_m, lattice.frame, source=str(costmap))
        title = f"{lattice.robot.name} on {costmap.stem}"
        write_file(picture, route_picture(ground, plan.route, plan.shortest, title=title, alternatives=plan.others))
    answer.document(found)


def feasibility(
    costmap: MapFolder,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to start [m].")] = None,
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to go [m].")] = None,
    path: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=there,
            help="A path instead: GeoJSON, the JSON of `joulemap path`, or CSV with x,y lines.",
        ),
    ] = None,
    round_trip: Annotated[bool, typer.Option("--round-trip", help="There and back.")] = False,
    capacity_wh: Annotated[
        float | None, typer.Option(help="Energy of the full battery [Wh]. [default: the robot's battery_wh]")
    ] = None,
    charge: Annotated[float, typer.Option(min=0.0, max=1.0, help="State of charge now, 0..1.")] = 1.0,
    reserve: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share that must remain at the end, 0..1.")] = 0.0,
    json_file: JsonFile = None,
) -> None:
    """Tell whether the **battery lasts**, for the best route between two points or for a given path.

    Ends with 0 in both cases: that the battery does not last is an answer (`feasible` in the JSON).

    Examples:

    `joulemap feasibility dem.zarr --start 12,40 --goal 180,95 --round-trip --charge 0.6 --reserve 0.2`

    `joulemap feasibility dem.zarr --path survey.geojson --charge 0.8`
    """
    from joulemap.model.robot import Battery
    from joulemap.planner.lattice_io import load_lattice
    from joulemap.service.commands.path_files import read_path
    from joulemap.service.schemas.answers import feasibility_out
    from joulemap.service.workflows import assess

    answer = Answer(json_file)
    lattice = load_lattice(costmap)
    battery = Battery(
        capacity_wh=capacity_wh if capacity_wh is not None else lattice.robot.battery_wh, charge=charge, reserve=reserve
    )
    points = read_path(path) if path is not None else None
    assessment = assess(lattice, battery=battery, path=points, start=start, goal=goal, round_trip=round_trip)
    found = feasibility_out(assessment, lattice.provenance.get("warnings", [])).model_dump(mode="json")
    answer.say(f"[bold {'green' if found['feasible'] else 'red'}]{found['message']}[/]")
    rows = {"way out": route_words(found["out"])}
    if found["back"] is not None:
        rows["way back"] = route_words(found["back"])
    answer.table(rows)
    answer.warn(dict.fromkeys(found["warnings"]))
    answer.document({**found, "round_trip": round_trip})
