"""`joulemap info`: what a heightmap holds and can show; `joulemap heightmap`: one of the positions that were driven."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.terrain.formats import formats_in_words
from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.options import (
    Overwrite,
    Reading,
    RobotFile,
    find_runs,
    refuse_to_replace,
    robot_of,
    there,
)
from joulemap.service.words import runs_words

if TYPE_CHECKING:
    from joulemap.model.runs.driven_surface import DrivenSurface

CAMPAIGN_FILE = "campaign.toml"
"""What `--each` writes beside the maps: which run belongs to which map."""


def info(
    heightmap: Annotated[Path, typer.Argument(metavar="HEIGHTMAP", callback=there, help=f"{formats_in_words()}.")],
    robot: RobotFile = None,
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Say **what a heightmap holds**: cells, place, heights, holes, the noise of its survey, and what it can show.

    Whether slopes, bumps and kerbs can be seen depends on cells, noise and the robot's wheels.

    Examples:

    `joulemap info dem.tif --robot robot.toml`

    `joulemap info heights.png --resolution 0.5 --scale 0.01`
    """
    from dataclasses import asdict

    from joulemap.model.terrain.plausible import heightmap_warnings
    from joulemap.model.terrain.readers import open_ground
    from joulemap.model.terrain.windows import overview
    from joulemap.planner.lattice.visible import visible_features

    output = Output(json_file)
    rover, ground = robot_of(robot), open_ground(heightmap, **reading)
    frame, seen = ground.frame, visible_features(ground, rover)
    low, high = overview(ground).height_range
    warnings = heightmap_warnings(ground)
    output.say(ground.source, head="Heightmap")
    output.table(
        {
            "cells": f"{frame.rows} rows x {frame.cols} columns of {frame.resolution_m:g} m",
            "place": "{:.9g}, {:.9g} to {:.9g}, {:.9g}".format(*frame.bounds) + f", {frame.crs_in_words}",
            "heights": f"{low:.2f} to {high:.2f} m",
            "unknown": f"{1.0 - ground.known_share:.2%}",
            "noise": f"{1000.0 * seen.noise_m:.1f} mm, "
            + (
                f"given, alike over {seen.noise_length_m:g} m"
                if seen.noise_given
                else "estimated from what differs from cell to cell. Noise that is alike over some cells, as of a "
                "drone, looks like ground: give --noise and --noise-length"
            ),
            **dict(zip(("slopes", "bumps", "steps"), seen.in_words(rover), strict=True)),
        }
    )
    output.warn([*ground.notes, *warnings])
    output.document(
        {
            "source": ground.source,
            "rows": frame.rows,
            "cols": frame.cols,
            "resolution_m": frame.resolution_m,
            "bounds": list(frame.bounds),
            "crs": frame.crs,
            "heights_m": [low, high],
            "known_share": ground.known_share,
            **asdict(seen),
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
    resolution: Annotated[float, typer.Option(min=0.01, metavar="M", help="Side of a cell [m].")] = 0.1,
    smoothing: Annotated[
        float, typer.Option(min=0.01, metavar="M", help="Waves shorter than this lose more than half their height [m].")
    ] = 0.5,
    max_gap: Annotated[
        float,
        typer.Option(min=0.01, metavar="M", help="Ground farther than this from a driven position is unknown [m]."),
    ] = 2.0,
    antenna_height: Annotated[float, typer.Option(metavar="M", help="Height of `z` above the ground [m].")] = 0.0,
    crs: Annotated[
        str | None,
        typer.Option(metavar="CRS", help="Coordinate system in metres, like EPSG:32630; `lat` and `lon` need it."),
    ] = None,
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
    runs = read_runs(files, crs=crs).runs
    groups = [[run] for run in runs] if each else [list(runs)]
    places = [out / f"{_stem(run.name)}.tif" for run in runs] if each else [out]
    maps: list[dict[str, Any]] = []
    with progress_bar("Heightmap") as report:
        for number, (group, place) in enumerate(zip(groups, places, strict=True), start=1):
            found = driven_surface(
                group,
                resolution_m=resolution,
                smoothing_m=smoothing,
                max_gap_m=max_gap,
                antenna_height_m=antenna_height,
                crs=crs,
            )
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
                "cells": f"{rows} x {cols} of {resolution:g} m, {100 * made['known_share']:.0f} % known",
                "heights": f"{low:.2f} .. {high:.2f} m",
                "fit": f"{100 * made['fit_m']:.1f} cm root mean square over {made['points']:,} positions",
            }
        )
        output.warn(made["warnings"])
    if each:
        output.say(f"{out / CAMPAIGN_FILE}: which run belongs to which map", head="Campaign")
    output.document({"maps": maps, "campaign": str(out / CAMPAIGN_FILE) if each else None})


def _document(place: Path, found: DrivenSurface, names: list[str]) -> dict[str, Any]:
    ground = found.heightmap
    known = ground.heights[ground.heights == ground.heights]
    return {
        "out": str(place),
        "runs": names,
        "rows": ground.frame.rows,
        "cols": ground.frame.cols,
        "resolution_m": ground.resolution_m,
        "bounds": list(ground.frame.bounds),
        "crs": ground.frame.crs,
        "heights_m": [float(known.min()), float(known.max())],
        "known_share": ground.known_share,
        "points": found.points,
        "fit_m": found.fit_m,
        "height_differences_m": found.height_differences_m,
        "warnings": found.warnings,
    }


def _stem(name: str) -> str:
    """A run's name as a file name: `monday/run_01.csv` is `monday_run_01`."""
    return "_".join(Path(name).with_suffix("").parts)


def _campaign(maps: list[Path], files: list[Path]) -> str:
    """A campaign file with a site for each run. JSON's texts are TOML's too."""
    import json

    sites = (
        f"[[site]]\nheightmap = {json.dumps(place.name)}\nruns = [{json.dumps(str(file.resolve()))}]\n"
        for place, file in zip(maps, files, strict=True)
    )
    return "\n".join(sites)
