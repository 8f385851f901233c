"""`joulemap info`: what a heightmap holds and can show; `joulemap heightmap`: one of the positions that were driven."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.options import (
    HeightmapArgument,
    Overwrite,
    ReadingWithLayers,
    RobotFile,
    find_runs,
    png,
    refuse_to_replace,
    robot_of,
    stem_of,
)
from joulemap.service.words import runs_words

if TYPE_CHECKING:
    from joulemap.model.runs.driven_surface import DrivenSurface

CAMPAIGN_FILE = "campaign.toml"
"""What `--each` writes beside the maps: which run belongs to which map."""


def info(
    heightmap: HeightmapArgument,
    robot: RobotFile = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=png, help="Draw the ground with its layers (PNG).")
    ] = None,
    json_file: JsonFile = None,
    *,
    reading: ReadingWithLayers,
) -> None:
    """Say **what a heightmap holds**: cells, place, heights, holes, the noise of its survey, and what it can show.

    With layers it also says which share of it is of each kind of ground.

    Whether slopes, bumps and kerbs can be seen depends on cells, noise and the robot's wheels.

    Examples:

    `joulemap info dem.tif --robot robot.toml`

    `joulemap info heights.png --resolution 0.5 --scale 0.01`

    `joulemap info dem.tif --layer kinds=land.tif --legend land.toml --picture land.png`
    """
    from dataclasses import asdict

    from joulemap.model.terrain.plausible import heightmap_warnings
    from joulemap.model.terrain.readers import open_ground
    from joulemap.model.terrain.windows import overview
    from joulemap.planner.lattice.visible import visible_features
    from joulemap.service.storage.stats import frame_values

    output = Output(json_file)
    rover, ground = robot_of(robot), open_ground(heightmap, **reading)
    frame, seen = ground.frame, visible_features(ground, rover)
    low, high = overview(ground).height_range
    warnings = [*heightmap_warnings(ground), *ground.layers.warnings(frame)]
    kinds = ground.layers.kind_shares(frame)
    if picture is not None:
        from joulemap.service.render.pictures import layers_picture

        write_file(picture, layers_picture(ground))
        output.say(f"Drawn: {picture}")
    output.say(ground.source, head="Heightmap")
    output.table(
        {
            "cells": f"{frame.rows} rows x {frame.cols} columns of {frame.resolution_m:g} m",
            "place": "{:.9g}, {:.9g} to {:.9g}, {:.9g}".format(*frame.bounds) + f", {frame.crs_in_words}",
            "heights": f"{low:.2f} to {high:.2f} m",
            "unknown": f"{1.0 - ground.known_share:.2%}",
            "noise": seen.noise_in_words,
            **({"kinds": ", ".join(f"{name} {share:.1%}" for name, share in kinds.items())} if kinds else {}),
            **dict(zip(("slopes", "bumps", "steps"), seen.in_words(rover), strict=True)),
        }
    )
    output.warn([*ground.notes, *warnings])
    output.document(
        {
            "source": ground.source,
            **frame_values(frame),
            "heights_m": [low, high],
            "known_share": ground.known_share,
            **asdict(seen),
            **({"layers": ground.layers.as_list(), "kinds": kinds} if ground.layers else {}),
            "notes": list(ground.notes),
            "warnings": warnings,
        }
    )


def heightmap(
    from_runs: Annotated[
        list[str],
        typer.Option(
            "--from-runs",
            metavar="FILE...",
            help="Measured runs (CSV, Parquet, MCAP, bags, flight logs) with positions and heights `z`: files, folders "
            "or patterns.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="GeoTIFF to write; with `--each` a folder for all of them.")
    ],
    each: Annotated[
        bool,
        typer.Option(
            "--each",
            help=f"One map for each run, for runs that are each in a frame of their own, and {CAMPAIGN_FILE} for "
            "`train --campaign`.",
        ),
    ] = False,
    *,
    wanted: Annotated[dict[str, Any], "joulemap.service.questions.surface:SurfaceOptions"],
    overwrite: Overwrite = False,
    json_file: JsonFile = None,
) -> None:
    """Make a **heightmap of driven positions**, where there is no survey.

    It shows the ground as the body of the robot followed it, and only near the driven positions: good enough to train
    and to judge models on, less good than a survey (see the reproduction of the paper).

    Examples:

    `joulemap heightmap --from-runs logs/*.csv --out dem.tif --crs EPSG:32630`

    `joulemap heightmap --from-runs logs/*.csv --each --out maps`
    """
    from joulemap.model.runs.driven_surface import driven_surface
    from joulemap.model.terrain.writers import write_geotiff
    from joulemap.service.library.run_files import read_runs

    output = Output(json_file)
    refuse_to_replace(out, overwrite=overwrite, mark=CAMPAIGN_FILE if each else "")
    files = find_runs(from_runs)
    runs = read_runs(files, crs=wanted["crs"]).runs
    groups = [[run] for run in runs] if each else [list(runs)]
    places = [out / f"{stem_of(run.name)}.tif" for run in runs] if each else [out]
    maps: list[dict[str, Any]] = []
    with progress_bar("Heightmap") as report:
        for number, (group, place) in enumerate(zip(groups, places, strict=True), start=1):
            found = driven_surface(group, **wanted)
            place.parent.mkdir(parents=True, exist_ok=True)
            write_geotiff(place, found.heightmap)
            maps.append(_document(place, found, [run.name for run in group]))
            report(number / len(groups))
    if each:
        write_file(out / CAMPAIGN_FILE, _campaign(places, files).encode())
    for made in maps:
        rows, cols = made["rows"], made["cols"]
        low, high = made["heights_m"]
        output.say(f"{made['out']} of {runs_words(len(made['runs']))}", head="Heightmap")
        output.table(
            {
                "cells": f"{rows} x {cols} of {wanted['resolution_m']:g} m, {100 * made['known_share']:.0f} % known",
                "heights": f"{low:.2f} .. {high:.2f} m",
                "fit": f"{100 * made['fit_m']:.1f} cm root mean square over {made['points']:,} positions",
            }
        )
        output.warn(made["warnings"])
    if each:
        output.say(f"{out / CAMPAIGN_FILE}: which run belongs to which map", head="Campaign")
    output.document({"maps": maps, "campaign": str(out / CAMPAIGN_FILE) if each else None})


def _document(place: Path, found: DrivenSurface, names: list[str]) -> dict[str, Any]:
    from joulemap.service.storage.stats import frame_values

    ground = found.heightmap
    known = ground.heights[ground.heights == ground.heights]
    return {
        "out": str(place),
        "runs": names,
        **frame_values(ground.frame),
        "heights_m": [float(known.min()), float(known.max())],
        "known_share": ground.known_share,
        "points": found.points,
        "fit_m": found.fit_m,
        "height_differences_m": found.height_differences_m,
        "warnings": found.warnings,
    }


def _campaign(maps: list[Path], files: list[Path]) -> str:
    """A campaign file with a site for each run. JSON's texts are TOML's too."""
    import json

    sites = (
        f"[[site]]\nheightmap = {json.dumps(place.name)}\nruns = [{json.dumps(str(file.resolve()))}]\n"
        for place, file in zip(maps, files, strict=True)
    )
    return "\n".join(sites)
