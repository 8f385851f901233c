"""`joulemap costmap`, `path` and `feasibility`: from a heightmap to a route and a verdict, without a service."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import TooLargeError
from joulemap.model.terrain.formats import formats_in_words
from joulemap.service.commands.arguments import RUNNING, with_option_names
from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.cluster import Scheduler, costmap_there
from joulemap.service.commands.console import (
    JsonFile,
    Output,
    leaves_nothing_behind,
    progress_bar,
    write_file,
)
from joulemap.service.commands.options import (
    ModelName,
    Overwrite,
    ReadingWithLayers,
    RobotFile,
    png,
    refuse_to_replace,
    robot_of,
    robot_words,
    there,
)
from joulemap.service.commands.remote import Key, MapOrId, Server, refuse_local, served, service_at, unpack
from joulemap.service.commands.route_files import RouteCoordinates, RouteFiles, RouteFormatName, wanted_files
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
    reading: ReadingWithLayers,
) -> None:
    """Make a **cost map**: energy per metre for every cell and heading, where the robot cannot go, and why.

    Examples:

    `joulemap costmap dem.tif --robot robot.toml --out dem.zarr`

    `joulemap costmap heights.png --resolution 0.5 --scale 0.01 --model physics --out heights.zarr`

    `joulemap costmap dem.tif --layer kinds=land.tif --legend land.toml --layer obstacles=map.yaml --out dem.zarr`
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
            over = _to_send(reading.pop("layers"), reading.pop("legend"))
            sent = service.heightmap(heightmap, **reading)
            output.warn(sent.notes)
            map_there = service.costmap(
                sent.id, robot=robot, model=model, spacing_m=spacing, headings=headings, progress=report, **over
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
            "robot": robot_words([rover]),
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


def _to_send(layers: dict[str, list[str]] | None, legend: Path | None) -> dict[str, Any]:
    """Layers as a service takes them: polygons."""
    from joulemap.model.terrain.layers.kinds import read_legend
    from joulemap.model.terrain.layers.polygons import read_document

    found = {}
    for role, files in (layers or {}).items():
        if len(files) > 1 or Path(files[0]).suffix.lower() not in (".geojson", ".json"):
            raise typer.BadParameter(
                f"a service takes one GeoJSON of each kind of layer, and got {', '.join(files)}: make the cost map "
                "without --server, or draw polygons (gdal_polygonize.py does it)",
                param_hint="--layer",
            )
        found[role] = dict(read_document(files[0]))
    return {"layers": found, "legend": None if legend is None else read_legend(legend).as_dict()}


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
    wanted: Annotated[Wanted, "joulemap.service.questions.path:PathRequest -battery"],
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
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.path import PathRequest, answer, ask, track

    output, files = Output(json_file), wanted_files(out, format, coordinates, geojson)
    _check_objective(wanted)
    if wanted.typed["objective"] == "arrival":
        raise typer.BadParameter("arriving depends on the battery: ask `joulemap feasibility --objective arrival`")
    bound = wanted.typed["bound"]
    if server is not None:
        refuse_local(memory=memory, picture=picture)
        with served(server, key, costmap) as map_there, progress_bar("Path") as report:
            for file in files:
                file.check(map_there.crs)
            values, notes = wanted.on(map_there.grid)
            there_found = map_there.plan(**values, progress=report)
            for file in files:
                write_file(file.path, map_there.plan_file(**values, **file.query))
        output.warn(notes)
        _say_path(output, there_found.model_dump(mode="json"), map_there.about.robot.name, bound=bound)
        return
    in_parts = picture is None and not wanted.changed & {"planner", "alternatives", "bound", "objective", "max_power_w"}
    ground = open_costmap(costmap, memory_gb=_memory_for(costmap) if in_parts and memory is None else memory)
    for file in files:
        file.check(ground.crs)
    values, notes = wanted.on(ground.planner.lattice.frame)
    output.warn(notes)
    with progress_bar("Path") as report:
        found = ask(ground.planner, PathRequest.of(**values), progress=report)
    _say_path(output, answer(found, ground.warnings), ground.robot.name, bound=bound)
    for file in files:
        write_file(file.path, file.content(track(found, ground.warnings)))
    if picture is not None:
        from joulemap.service.pictures import route_picture

        source = ground.lattice.provenance.get("heightmap", {}).get("source")
        title = f"Path for {ground.robot.name}" + (f" on {source}" if source not in (None, "memory") else "")
        plan = found.plan
        drawn = route_picture(ground.lattice, plan.route, plan.shortest, title=title, alternatives=plan.others)
        write_file(picture, drawn)


def _check_objective(wanted: Wanted) -> None:
    """Refuse what does not go together."""
    typed = wanted.typed
    if "quantile" in wanted and "objective" not in wanted:
        raise typer.BadParameter(
            f"a quantile of {typed['quantile']:g} counts with --objective quantile only: give both",
            param_hint="--quantile",
        )
    if "path" in wanted and wanted.changed & {"objective", "max_power_w"}:
        raise typer.BadParameter("--objective and --max-power choose a route: give --start and --goal, not --path")


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
    wanted: Annotated[Wanted, "joulemap.service.questions.feasibility:FeasibilityRequest"],
    memory: Memory = None,
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
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.feasibility import FeasibilityRequest, answer, ask

    output = Output(json_file)
    _check_objective(wanted)
    if server is not None:
        refuse_local(memory=memory)
        with served(server, key, costmap) as map_there:
            values, notes = wanted.on(map_there.grid)
            found = map_there.feasibility(values.pop("path", None), **values).model_dump(mode="json")
    else:
        whole = memory is not None or wanted.changed & {"objective", "max_power_w"}
        ground = open_costmap(costmap, memory_gb=memory if whole else _memory_for(costmap))
        values, notes = wanted.on(ground.planner.lattice.frame)
        found = answer(ask(ground.planner, FeasibilityRequest.of(**values)), ground.warnings)
    output.warn(notes)
    _say_verdict(output, found, round_trip=wanted.typed["round_trip"])


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
