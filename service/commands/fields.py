"""`joulemap field`: least energies of all cells from a start, to a goal, or over each cell between both."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, parse_point, write_file
from joulemap.service.commands.maps import MapFolder
from joulemap.service.commands.options import Snap


def field(
    costmap: MapFolder,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.tif", help="GeoTIFF to write [J].")],
    start: Annotated[
        Any, typer.Option(metavar="X,Y", parser=parse_point, help="Energy from here to each cell.")
    ] = None,
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Energy from each cell to here.")] = None,
    within: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            metavar="PERCENT",
            help="With start and goal: a second band, 1 where routes lie that cost at most so much more than the best.",
        ),
    ] = None,
    neighbours: Annotated[int, typer.Option(metavar="N", help="Directions of a step: 8, 16 or 32.")] = 16,
    snap: Snap = False,
    json_file: JsonFile = None,
) -> None:
    """Write the **least energy** from a start to all cells, from all cells to a goal, or over each cell between both.

    The energies are those of paths over grid moves, as of `joulemap path --no-refine`: mostly 1 to 3 % above a refined
    path, and far more where only such a path fits through a passage.

    Examples:

    `joulemap field dem.zarr --goal 180,95 --out to_base.tif`

    `joulemap field dem.zarr --start 12,40 --goal 180,95 --within 5 --out corridor.tif`
    """
    import numpy as np

    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.places import Places

    output = Output(json_file)
    ground = open_costmap(costmap)
    places = Places(ground.lattice.frame)
    ends = {name: None if place is None else places(place, name) for name, place in (("start", start), ("goal", goal))}
    output.warn(places.notes)
    found = ground.field(**ends, neighbours=neighbours, snap=snap)
    share = None if within is None else within / 100.0
    write_file(out, found.geotiff(within=share))
    reached = np.isfinite(found.energy_j)
    figures: dict[str, Any] = {
        "kind": str(found.kind),
        "cells": int(found.energy_j.size),
        "reached": int(reached.sum()),
        "least_j": found.least_j if reached.any() else None,
        "most_j": float(found.energy_j[reached].max()) if reached.any() else None,
        "out": str(out),
    }
    if share is not None:
        figures["corridor_cells"] = int(found.corridor(share).sum())
    output.say(found.kind, head="Energy field")
    rows = {"cells reached": f"{figures['reached']:,} of {figures['cells']:,}", "written": str(out)}
    if reached.any():
        rows["energy"] = f"{figures['least_j'] / 1e3:.2f} .. {figures['most_j'] / 1e3:.2f} kJ"
    if share is not None:
        rows["corridor"] = f"{figures['corridor_cells']:,} cells within {within:g} % of the best route"
    output.table(rows)
    output.document(figures)
