"""`joulemap costmap`, `path` and `feasibility`: from a heightmap to a route and a verdict, without a service."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import TooLargeError
from joulemap.model.terrain.formats import formats_in_words
from joulemap.service.commands.arguments import RUNNING, with_option_names
from joulemap.service.commands.battery_file import BatteryFile, battery_values
from joulemap.service.commands.cluster import Scheduler, costmap_there
from joulemap.service.commands.console import (
    JsonFile,
    Output,
    leaves_nothing_behind,
    parse_point,
    progress_bar,
    write_file,
)
from joulemap.service.commands.options import (
    DEFAULT_QUANTILE,
    Avoid,
    MaxPower,
    ModelName,
    ObjectiveName,
    Overwrite,
    Quantile,
    Reading,
    Reserve,
    RobotFile,
    Snap,
    StateOfCharge,
    png,
    reads_heightmap,
    refuse_to_replace,
    robot_of,
    there,
    weighed_options,
)
from joulemap.service.commands.remote import Key, MapOrId, Server, refuse_local, served, service_at, unpack
from joulemap.service.commands.route_files import PLACE, RouteCoordinates, RouteFiles, RouteFormatName, wanted_files
from joulemap.service.words import duration_words, energy_words, objective_rows, route_words, saving_words

if TYPE_CHECKING:
    from joulemap.model.frames import GridFrame
    from joulemap.service.schemas.maps import CostmapOut

MOST_VALUES = 400_000_000
"""Most rows x columns x headings of a cost map unless the user allows more: the limit of `planner.lattice.build` for a
lattice in memory, so that `joulemap path` can read what was made."""

FROM_DISK = 2_000_000
"""Cells above which one question is answered from the cost map's folder: reading all of it would take longer."""

_BYTES_PER_VALUE = 8  # a price and its uncertainty, float32 each
_WORTH_SAYING = 20_000_000  # values: more take longer than some seconds

Memory = Annotated[
    float | None,
    typer.Option(
        min=0.05,
        metavar="GB",
        help=f"Plan on the map from disk, in so much memory. [default: 1.5 for maps above {FROM_DISK:,} cells]",
    ),
]
MapFolder = Annotated[
    Path, typer.Argument(metavar="MAP.zarr", callback=there, help="A cost map made by `joulemap costmap`.")
]


@reads_heightmap
def costmap(
    heightmap: Annotated[
        Path,
        typer.Argument(metavar="HEIGHTMAP", callback=there, help=f"{formats_in_words()}."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="MAP.zarr", help="Folder to write the cost map to; optional with --server."),
    ] = None,
    robot: RobotFile = None,
    model: ModelName = "default",
    spacing: Annotated[float, typer.Option(min=0.01, metavar="M", help="Side of a cell of the cost map [m].")] = 1.0,
    headings: Annotated[
        int, typer.Option(min=4, max=360, metavar="N", help="Number of headings of each cell, evenly spaced.")
    ] = 16,
    max_values: Annotated[
        int,
        typer.Option(
            min=1,
            metavar="N",
            help="Most values (rows x columns x headings) of the cost map, up to 8 bytes each on disk.",
        ),
    ] = MOST_VALUES,
    geotiff: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also write a GeoTIFF: by heading, energies [J/m] and blocked reasons."),
    ] = None,
    npz: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write a NumPy .npz.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=png, help="Also draw it, mean over headings (PNG).")
    ] = None,
    overwrite: Overwrite = False,
    scheduler: Scheduler = None,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Make a **cost map**: energy per metre for every cell and heading, where the robot cannot go, and why.

    Examples:

    `joulemap costmap dem.tif --robot robot.toml --out dem.zarr`

    `joulemap costmap heights.png --resolution 0.5 --scale 0.01 --model physics --out heights.zarr`
    """
    from joulemap.model.terrain.plausible import heightmap_warnings
    from joulemap.model.terrain.readers import ASKED_FOR, open_ground
    from joulemap.planner.lattice.io import LatticeFolder

    output = Output(json_file)
    if out is not None:
        refuse_to_replace(out, overwrite=overwrite)
        LatticeFolder(out).check_place()
    if server is not None:
        refuse_local(geotiff=geotiff, npz=npz, picture=picture, scheduler=scheduler)
        with service_at(server, key) as service, progress_bar("Cost map") as report:
            sent = service.heightmap(heightmap, **reading)
            output.warn(sent.notes)
            map_there = service.costmap(
                sent.id, robot=robot, model=model, spacing_m=spacing, headings=headings, progress=report
            )
            if out is not None:
                unpack(map_there.data("zarr"), out)
        _say_served(output, map_there.about, sent.name, out)
        return
    if out is None:
        raise typer.BadParameter("--out is missing: name the folder to write the cost map to")
    ground = open_ground(heightmap, **reading)
    for note in ground.notes:
        if note.startswith(ASKED_FOR):
            output.say(with_option_names(note, RUNNING.get()), head="Heightmap")
        else:
            output.warn([note])
    rover = robot_of(robot)
    with ThreadPoolExecutor(1) as reader:
        warned = reader.submit(heightmap_warnings, ground)
        from joulemap.service.cost_lattices import load_kernels, write_cost_lattice  # slowly; the map is read meanwhile

        _say_size(output, ground.frame, spacing, headings, max_values)
        if scheduler is None:
            load_kernels(model, rover)
    output.warn(warned.result())
    with leaves_nothing_behind(), progress_bar("Cost map") as report:
        how: dict[str, Any] = {"model": model, "spacing_m": spacing, "headings": headings, "progress": report}
        if scheduler is not None:
            made = costmap_there(scheduler, out, heightmap, reading=reading, robot=rover.as_dict(), **how)
        else:
            made = write_cost_lattice(out, ground, rover, **how)
    if made.frame.rows * made.frame.cols > FROM_DISK:
        from joulemap.planner.stored_planner import StoredPlanner

        with progress_bar("Coarse level") as report:
            StoredPlanner(out).prepare(progress=report)
    _also_as(out, geotiff, npz, picture)
    frame, warnings = made.frame, made.provenance["warnings"]
    price, blocked = made.figures["energy_per_m"], made.figures["blocked"]
    words = ", ".join(f"{share:.1%} {reason.replace('_', ' ')}" for reason, share in blocked.items() if share > 0)
    output.say(f"of {ground.source} for {rover.name}, model {made.provenance['model']['name']}", head="Cost map")
    output.table(
        {
            "cells": f"{frame.rows} rows x {frame.cols} columns of {frame.resolution_m:g} m, {headings} headings",
            "energy": "{min:.1f} .. {max:.1f} J/m, mean {mean:.1f} J/m".format(**price) if price else "nothing is free",
            "ground": words,
            "written": str(out),
        }
    )
    output.warn(warnings)
    output.document(
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


def _say_served(output: Output, made: CostmapOut, source: str, out: Path | None) -> None:
    """What a service says of a cost map that it made, as the command says it of its own."""
    found = made.model_dump(mode="json")
    frame, price, blocked = found.pop("frame"), found["energy_per_m"], found["blocked"]
    words = ", ".join(f"{share:.1%} {reason.replace('_', ' ')}" for reason, share in blocked.items() if share > 0)
    output.say(f"{made.id} of {source} for {made.robot.name}, model {made.model}", head="Cost map")
    output.table(
        {
            "cells": "{rows} rows x {cols} columns of {spacing_m:g} m".format(**frame) + f", {made.headings} headings",
            "energy": "{min:.1f} .. {max:.1f} J/m, mean {mean:.1f} J/m".format(**price) if price else "nothing is free",
            "ground": words,
            **({} if out is None else {"written": str(out)}),
        }
    )
    output.warn(made.warnings)
    output.document({**found, **frame, "costmap_id": made.id, "out": None if out is None else str(out)})


def _say_size(output: Output, ground: GridFrame, spacing: float, headings: int, max_values: int) -> None:
    """Say how large a large cost map will be. Raises TooLargeError above `max_values`."""
    from joulemap.service.cost_lattices import check_lattice

    tiling = check_lattice(ground, spacing_m=spacing, headings=headings)
    size = (
        f"{tiling.frame.rows:,} x {tiling.frame.cols:,} cells of {spacing:g} m with {headings} headings: "
        f"{tiling.values:,} values, up to {_BYTES_PER_VALUE * tiling.values / 1e9:.1f} GB on disk"
    )
    if tiling.values > max_values:
        coarser = spacing * (tiling.values / max_values) ** 0.5
        raise TooLargeError(
            f"{size}. The limit is {max_values:,} values: choose a coarser --spacing (about {coarser:.2g} m), fewer "
            f"--headings, or allow it with --max-values {tiling.values}",
            values=tiling.values,
            limit=max_values,
        )
    if tiling.values > _WORTH_SAYING:
        output.say(size)


def _also_as(folder: Path, geotiff: Path | None, npz: Path | None, picture: Path | None) -> None:
    """Other files of a cost map; it is only read, as a whole, when one is wanted."""
    if geotiff is None and npz is None and picture is None:
        return
    from joulemap.planner.lattice.io import export_npz, load_lattice
    from joulemap.service.exports.maps import save_map
    from joulemap.service.pictures import lattice_image

    lattice = load_lattice(folder)
    if geotiff is not None:
        save_map(lattice, geotiff, "geotiff")
    for place, make in ((npz, export_npz), (picture, lattice_image)):
        if place is not None:
            write_file(place, make(lattice))


def _proven(found: dict[str, Any], *, bound: bool) -> dict[str, str]:
    """What is known of better paths, as rows of the answer; the bound where it was asked for."""
    rows = {}
    if bound and found["gap"] is not None:
        less = 100 * found["gap"] / (1.0 + found["gap"])
        rows["lower bound"] = f"{energy_words(found['bound_j'])}: no path takes less by more than {less:.2g} %"
    if (gap := found["details"].get("grid_gap")) is not None:
        rows["proven"] = f"the grid's path is at most {100 * gap:.2g} % above the best over its moves"
    return rows


def _memory_for(costmap: Path) -> float | None:
    """Memory [GB] for a question to a map that is better not read as a whole; None for a smaller one."""
    from joulemap.planner.lattice.stored_lattice import StoredLattice
    from joulemap.planner.on_disk.tiled_search import DEFAULT_MEMORY

    return DEFAULT_MEMORY / 1e9 if StoredLattice(costmap).cells > FROM_DISK else None


def path(
    costmap: MapOrId,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help=f"Where to start: {PLACE}.")],
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to go.")],
    planner: Annotated[
        str,
        typer.Option(help="astar or dijkstra (exact on the grid); rrtstar, informed_rrtstar or bitstar (sampling)."),
    ] = "astar",
    neighbours: Annotated[
        int,
        typer.Option(
            metavar="N", help="Directions of a step with --no-refine: 8, 16 or 32. A refined path begins with 32."
        ),
    ] = 16,
    refine: Annotated[bool, typer.Option(help="Improve the grid path at any angle.")] = True,
    time_limit: Annotated[float, typer.Option(min=0.01, metavar="S", help="Time for the sampling planners [s].")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the sampling planners.")] = 0,
    alternatives: Annotated[int, typer.Option(min=0, metavar="K", help="Most other good routes to look for.")] = 0,
    snap: Snap = False,
    avoid: Avoid = None,
    objective: ObjectiveName = "mean",
    quantile: Quantile = DEFAULT_QUANTILE,
    max_power: MaxPower = None,
    bound: Annotated[
        bool,
        typer.Option(
            help="Search for a lower bound of the energy of all paths, and say how far this one may lie above it."
        ),
    ] = False,
    memory: Memory = None,
    out: RouteFiles = None,
    format: RouteFormatName = None,
    coordinates: RouteCoordinates = None,
    geojson: Annotated[Path | None, typer.Option(metavar="FILE", help="Write all paths as GeoJSON.")] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=png,
            help="Draw all paths, and the profiles of the energy-optimal and the shortest one (PNG).",
        ),
    ] = None,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
) -> None:
    """Find the **energy-optimal path** on a cost map, and what it saves against the shortest path.

    Examples:

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --picture path.png`

    `joulemap path dem.zarr --start 36.7201,-4.4903 --goal 36.7215,-4.4871 --out path.gpx --out path.plan`

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --objective quantile --quantile 0.95 --max-power 250`

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --planner bitstar --time-limit 10 --json -`
    """
    from joulemap.service.commands.path_files import read_areas
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.schemas.answers import path_values

    output, files = Output(json_file), wanted_files(out, format, coordinates, geojson)
    asked: dict[str, Any] = {
        "planner": planner,
        "neighbours": neighbours,
        "refine": refine,
        "time_limit_s": time_limit,
        "seed": seed,
        "alternatives": alternatives,
        "snap": snap,
        "bound": bound,
        **weighed_options(objective, quantile, max_power),
    }
    if objective == "arrival":
        raise typer.BadParameter("arriving depends on the battery: ask `joulemap feasibility --objective arrival`")
    if server is not None:
        refuse_local(memory=memory, picture=picture)
        with served(server, key, costmap) as map_there, progress_bar("Path") as report:
            for file in files:
                file.check(map_there.crs)
            asked["avoid"], notes = read_areas(avoid, map_there.grid)
            answer = map_there.plan(start, goal, progress=report, **asked)
            for file in files:
                write_file(file.path, map_there.plan_file(start, goal, **file.query, **asked))
        output.warn(notes)
        _say_path(output, answer.model_dump(mode="json"), map_there.about.robot.name, bound=bound)
        return
    whole = bound or objective != "mean" or max_power is not None
    in_parts = planner == "astar" and alternatives == 0 and picture is None and not whole
    ground = open_costmap(costmap, memory_gb=_memory_for(costmap) if in_parts and memory is None else memory)
    for file in files:
        file.check(ground.crs)
    asked["avoid"], notes = read_areas(avoid, ground.planner.lattice.frame)
    output.warn(notes)
    with progress_bar("Path") as report:
        route = ground.plan(start, goal, progress=report, **asked)
    plan = route.found
    _say_path(output, path_values(plan, None, ground.warnings), ground.robot.name, bound=bound)
    for file in files:
        write_file(file.path, file.content(route.track))
    if picture is not None:
        from joulemap.service.pictures import route_picture

        source = ground.lattice.provenance.get("heightmap", {}).get("source")
        title = f"Path for {ground.robot.name}" + (f" on {source}" if source not in (None, "memory") else "")
        drawn = route_picture(ground.lattice, plan.route, plan.shortest, title=title, alternatives=plan.others)
        write_file(picture, drawn)


def _say_path(output: Output, found: dict[str, Any], robot: str, *, bound: bool) -> None:
    output.say(f"for {robot}, planner {found['planner']}", head="Path")
    output.table(
        {
            "energy-optimal": route_words(found),
            **{f"alternative {k}": route_words(other) for k, other in enumerate(found["alternatives"], 1)},
            "shortest": route_words(found["shortest"]),
            "saved": saving_words(found, found["shortest"]),
            **objective_rows(found["objective"]),
            **_proven(found, bound=bound),
        }
    )
    output.warn(found["warnings"])
    output.document(found)


def feasibility(
    costmap: MapOrId,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help=f"Where to start: {PLACE}.")] = None,
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to go.")] = None,
    path: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=there,
            help="A path instead: GeoJSON, GPX, KML, a mission (.plan, .waypoints), the JSON of `joulemap path` or "
            "`tour`, or CSV with lines x,y. Several lines are driven one after another.",
        ),
    ] = None,
    round_trip: Annotated[bool, typer.Option("--round-trip", help="There and back.")] = False,
    snap: Snap = False,
    avoid: Avoid = None,
    objective: ObjectiveName = "mean",
    quantile: Quantile = DEFAULT_QUANTILE,
    max_power: MaxPower = None,
    memory: Memory = None,
    capacity_wh: Annotated[
        float | None,
        typer.Option(metavar="WH", help="Energy of the full battery [Wh]. [default: the robot's battery_wh]"),
    ] = None,
    charge: StateOfCharge = 1.0,
    reserve: Reserve = 0.0,
    battery_file: BatteryFile = None,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
) -> None:
    """Say whether the **battery lasts**, for the best route between two points or for a given path.

    The verdict is yes (95 % likely, or more), likely (two thirds), marginal (one third) or no. The exit code is 0 for
    all of them: "no" is an answer, not an error (`verdict` and `feasible` in the JSON).

    Examples:

    `joulemap feasibility dem.zarr --start 12,40 --goal 180,95 --round-trip --charge 0.6 --reserve 0.2`

    `joulemap feasibility dem.zarr --path survey.geojson --charge 0.8`

    `joulemap feasibility dem.zarr --path survey.geojson --charge 0.8 --battery pack.toml`

    `joulemap feasibility dem.zarr --start 12,40 --goal 180,95 --charge 0.3 --objective arrival`
    """
    from joulemap.model.battery import Battery
    from joulemap.service.commands.path_files import read_areas, read_path
    from joulemap.service.feasibility import assess
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.objectives import Objective, limited
    from joulemap.service.schemas.answers import feasibility_values

    output = Output(json_file)
    given = battery_values(battery_file, capacity_wh)
    chosen_by = weighed_options(objective, quantile, max_power)
    if path is not None and chosen_by:
        raise typer.BadParameter("--objective and --max-power choose a route: give --start and --goal, not --path")
    if server is not None:
        refuse_local(memory=memory)
        with served(server, key, costmap) as map_there:
            points, notes = (None, []) if path is None else read_path(path, map_there.grid)
            areas, more = read_areas(avoid, map_there.grid)
            verdict = map_there.feasibility(
                points,
                start=start,
                goal=goal,
                round_trip=round_trip,
                snap=snap,
                avoid=areas,
                charge=charge,
                reserve=reserve,
                capacity_wh=capacity_wh,
                battery=given,
                **chosen_by,
            )
        output.warn(notes + more)
        _say_verdict(output, verdict.model_dump(mode="json"), round_trip=round_trip)
        return
    ground = open_costmap(costmap, memory_gb=_memory_for(costmap) if memory is None and not chosen_by else memory)
    battery = Battery.from_mapping(
        {"capacity_wh": ground.robot.battery_wh, **given, "charge": charge, "reserve": reserve}
    )
    planner = ground.planner
    points, notes = (None, []) if path is None else read_path(path, planner.lattice.frame)
    areas, more = read_areas(avoid, planner.lattice.frame)
    output.warn(notes + more)
    task: dict[str, Any] = {"path": points, "start": start, "goal": goal, "round_trip": round_trip, "snap": snap}
    router = limited(planner.avoiding(areas), max_power)
    assessment = assess(router, battery=battery, objective=Objective(objective, quantile), **task)
    _say_verdict(output, feasibility_values(assessment, ground.warnings), round_trip=round_trip)


def _say_verdict(output: Output, found: dict[str, Any], *, round_trip: bool) -> None:
    colour = {"yes": "green", "likely": "green", "marginal": "yellow", "no": "red"}[found["verdict"]]
    output.say(head=found["message"], style=f"bold {colour}")
    output.say(found["verdict_text"])
    rows = {"way out": route_words(found["out"])}
    if found["back"] is not None:
        rows["way back"] = route_words(found["back"])
    if (place := found["reserve_at"]) is not None:
        rows["reserve touched"] = f"after {place['distance_m']:.0f} m, {duration_words(place['time_s'])}"
    rows |= objective_rows(found["objective"])
    if found["least_voltage_v"] is not None:
        rows["least voltage"] = f"{found['least_voltage_v']:.1f} V under load"
    output.table(rows)
    output.warn(dict.fromkeys(found["warnings"]))
    output.document({**found, "round_trip": round_trip})
