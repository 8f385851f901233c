"""`joulemap export`: a cost map for another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.remote import Key, MapOrId, Server, served


def export(
    costmap: MapOrId,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Suffix .tif (GeoTIFF), .cog.tif (cloud-optimised), .yaml (Nav2 map, its image beside it) or "
            ".graph.geojson (Nav2 route graph).",
        ),
    ],
    format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Whatever the suffix: geotiff, cog, nav2-map, nav2-graph."),
    ] = None,
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
) -> None:
    """Write a **cost map for another program**: GIS (GeoTIFF), Nav2 (map, route graph).

    Examples:

    `joulemap export dem.zarr --out site.yaml`

    `joulemap export dem.zarr --out site.cog.tif`
    """
    from joulemap.planner.lattice.io import load_lattice
    from joulemap.service.exports.maps import ZIP, map_format_of, save_map

    output, chosen = Output(json_file), map_format_of(out, format)
    if server is not None:
        if chosen.media_type == ZIP and out.suffix != ".zip":
            raise typer.BadParameter(f"a service answers {chosen.name} as a zip: let --out end with .zip")
        with served(server, key, costmap) as map_there:
            write_file(out, map_there.data(chosen.name))
        written = [out]
    else:
        with progress_bar("Export"):
            written = save_map(load_lattice(costmap), out, chosen.name)
    output.say(f"{', '.join(map(str, written))}: {chosen.words}", head="Written")
    output.document({"format": chosen.name, "written": [str(path) for path in written]})
