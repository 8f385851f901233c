"""`joulemap export`: a cost map for another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.console import JsonFile, Output, check_origin, progress_bar, write_file
from joulemap.service.commands.remote import MapOrId, Remote


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
    origin: Annotated[
        str | None,
        typer.Option(
            "--origin",
            metavar="X,Y",
            callback=check_origin,
            help="Of Nav2 formats: the place that gets the coordinates 0,0 [m].",
        ),
    ] = None,
    json_file: JsonFile = None,
    *,
    remote: Remote,
) -> None:
    """Write a **cost map for another program**: GIS (GeoTIFF), Nav2 (map, route graph).

    Examples:

    `joulemap export dem.zarr --out site.yaml`

    `joulemap export dem.zarr --out site.cog.tif`
    """
    from joulemap.planner.lattice.loading import load_lattice
    from joulemap.service.exports.formats import format_of
    from joulemap.service.exports.maps import MAP_FORMATS, ZIP, save_map

    output, chosen = Output(json_file), format_of(MAP_FORMATS, out, format)
    if remote.server is not None:
        if chosen.media_type == ZIP and out.suffix != ".zip":
            raise typer.BadParameter(f"a service answers {chosen.name} as a zip: let --out end with .zip")
        with remote.client() as service:
            write_file(out, service.open_costmap(str(costmap)).data(chosen.name, origin=origin))
        written = [out]
    else:
        with progress_bar("Export"):
            written = save_map(load_lattice(costmap), out, chosen.name, origin=origin)
    output.say(f"{', '.join(map(str, written))}: {chosen.words}", head="Written")
    output.document({"format": chosen.name, "written": [str(path) for path in written]})
