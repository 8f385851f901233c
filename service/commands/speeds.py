"""`joulemap speeds`: the cheapest cruising speed of a route, and energy against time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output
from joulemap.service.commands.options import ModelName, ReadingWithLayers, there
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.words import duration_words, energy_words

_SHOWN = 9  # rows of the table, of all speeds


def speeds(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.speeds:SpeedsRequest"],
    heightmap: Annotated[
        Path | None,
        typer.Argument(metavar="[HEIGHTMAP]", callback=there, help="What the cost map was made of; not with --server."),
    ] = None,
    model: ModelName = "default",
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
    *,
    reading: ReadingWithLayers,
) -> None:
    """Find the **cheapest cruising speed** of a route, and what time costs in energy.

    Only speeds that the model learned from are tried. `--model` is that of the cost map.

    Examples:

    `joulemap speeds dem.zarr dem.tif --start 12,40 --goal 180,95`

    `joulemap speeds dem.zarr dem.tif --path survey.geojson --model calibrated/ --json -`

    `joulemap speeds dem.zarr dem.tif --start 12,40 --goal 180,95 --deadline 300`
    """
    from joulemap.model.terrain.readers import open_ground
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.models import find_predictor
    from joulemap.service.questions.speeds import SpeedsRequest, answer, ask

    output, ends = Output(json_file), wanted.changed & {"start", "goal"}
    if ("path" in wanted) == bool(ends) or len(ends) == 1:
        raise typer.BadParameter("give either --path, or --start and --goal")
    if server is not None:
        if heightmap is not None:
            raise typer.BadParameter("the service has the heightmap of its cost map: leave it out with --server")
        with served(server, key, costmap) as map_there:
            values, notes = wanted.on(map_there.grid)
            said = map_there.speeds(values.pop("path", None), **values)
    else:
        if heightmap is None:
            raise typer.BadParameter("name the heightmap that the cost map was made of after the cost map")
        ground = open_costmap(costmap)
        values, notes = wanted.on(ground.lattice.frame)
        made_of, predictor = open_ground(heightmap, **reading), find_predictor(model)
        said = answer(ask(ground.planner, SpeedsRequest.of(**values), made_of, predictor), ground.warnings)
    output.warn(notes)
    _say(output, said.model_dump(mode="json"))


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
    if (profile := found["profile"]) is not None:
        begins = [0.0, *profile["until_m"]]
        shown = zip(begins, profile["until_m"], profile["speed_mps"], strict=False)
        output.table({f"{begin:.0f} to {end:.0f} m": f"{speed:.2f} m/s" for begin, end, speed in shown})
    output.warn(found["warnings"])
    output.document(found)
