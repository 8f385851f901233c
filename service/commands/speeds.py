"""`joulemap speeds`: the cheapest cruising speed of a route, and energy against time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, parse_point
from joulemap.service.commands.options import ModelName, Reading, Snap, reads_heightmap, there
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.commands.route_files import PLACE
from joulemap.service.words import duration_words, energy_words

_SHOWN = 9  # rows of the table, of all speeds


@reads_heightmap
def speeds(
    costmap: MapOrId,
    heightmap: Annotated[
        Path | None,
        typer.Argument(metavar="[HEIGHTMAP]", callback=there, help="What the cost map was made of; not with --server."),
    ] = None,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help=f"Where to start: {PLACE}.")] = None,
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to go.")] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", callback=there, help="A path instead, as for `joulemap feasibility`."),
    ] = None,
    model: ModelName = "default",
    snap: Snap = False,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Find the **cheapest cruising speed** of a route, and what time costs in energy.

    Only speeds that the model learned from are tried. `--model` is that of the cost map.

    Examples:

    `joulemap speeds dem.zarr dem.tif --start 12,40 --goal 180,95`

    `joulemap speeds dem.zarr dem.tif --path survey.geojson --model calibrated/ --json -`
    """
    import numpy as np

    from joulemap.model.terrain.readers import open_ground
    from joulemap.service.commands.path_files import read_path
    from joulemap.service.exports.clearance import price_given_path
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.models import find_predictor
    from joulemap.service.schemas.speeds import speeds_out
    from joulemap.service.speeds import speeds_along

    output = Output(json_file)
    if (path is None) == (start is None and goal is None) or (start is None) != (goal is None):
        raise typer.BadParameter("give either --path, or --start and --goal")
    if server is not None:
        if heightmap is not None:
            raise typer.BadParameter("the service has the heightmap of its cost map: leave it out with --server")
        with served(server, key, costmap) as map_there:
            points, notes = (None, []) if path is None else read_path(path, map_there.grid)
            answer = map_there.speeds(points, start=start, goal=goal, snap=snap)
    else:
        if heightmap is None:
            raise typer.BadParameter("name the heightmap that the cost map was made of after the cost map")
        ground = open_costmap(costmap)
        points, notes = (None, []) if path is None else read_path(path, ground.lattice.frame)
        if points is None:
            driven = ground.plan(start, goal, snap=snap).route
        else:
            driven = price_given_path(ground.lattice, np.asarray(points, dtype=np.float64)[:, :2])
        found = speeds_along(driven, ground.lattice, open_ground(heightmap, **reading), find_predictor(model))
        answer = speeds_out(found, driven, ground.warnings)
    output.warn(notes)
    _say(output, answer.model_dump(mode="json"))


def _say(output: Output, found: dict[str, Any]) -> None:
    output.say(found["text"])
    curve = found["curve"]
    step = max(1, (len(curve) - 1) // (_SHOWN - 1))
    output.table(
        {
            f"{one['speed_mps']:.2f} m/s": f"{energy_words(one['energy_j'])}, {duration_words(one['duration_s'])}"
            for one in curve[::step]
        }
    )
    output.warn(found["warnings"])
    output.document(found)
