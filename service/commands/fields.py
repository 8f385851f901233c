"""`joulemap field`: least energies of all cells from a start, to a goal, or over each cell between both."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, write_file
from joulemap.service.commands.maps import MapFolder


def field(
    costmap: MapFolder,
    wanted: Annotated[Wanted, "joulemap.service.questions.field:FieldRequest"],
    out: Annotated[Path, typer.Option("--out", metavar="FILE.tif", help="GeoTIFF to write [J].")],
    json_file: JsonFile = None,
) -> None:
    """Write the **least energy** from a start to all cells, from all cells to a goal, or over each cell between both.

    The energies are those of paths over grid moves, as of `joulemap path --no-refine`: mostly 1 to 3 % above a refined
    path, and far more where only such a path fits through a passage.

    Examples:

    `joulemap field dem.zarr --goal 180,95 --out to_base.tif`

    `joulemap field dem.zarr --start 12,40 --goal 180,95 --within 5 --out corridor.tif`
    """
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.field import FieldRequest, answer, ask

    output = Output(json_file)
    ground = open_costmap(costmap)
    values, notes = wanted.on(ground.lattice.frame)
    output.warn(notes)
    found = ask(ground.planner, FieldRequest.of(**values))
    output.warn(found.notes)
    write_file(out, found.energies.geotiff(within=found.within))
    figures = {name: value for name, value in answer(found).items() if name != "warnings"} | {"out": str(out)}
    output.say(figures["kind"], head="Energy field")
    rows = {"cells reached": f"{figures['reached']:,} of {figures['cells']:,}", "written": str(out)}
    rows["energy"] = f"{figures['least_j'] / 1e3:.2f} .. {figures['most_j'] / 1e3:.2f} kJ"
    if (corridor := figures["corridor_cells"]) is None:
        del figures["corridor_cells"]
    else:
        rows["corridor"] = f"{corridor:,} cells within {wanted.typed['within_percent']:g} % of the best route"
    output.table(rows)
    output.document(figures)
