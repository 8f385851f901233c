"""`joulemap reach`: where the battery lasts to, and where it lasts to and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, write_file
from joulemap.service.commands.maps import MapFolder

_SUFFIXES = (".geojson", ".tif", ".png")


def reach(
    costmap: MapFolder,
    wanted: Annotated[Wanted, "joulemap.service.questions.reach:ReachRequest"],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Outlines (`.geojson`, longitude and latitude), what is left at every cell (`.tif` [J]), or a picture "
            "(`.png`).",
        ),
    ] = None,
    coordinates: Annotated[
        str, typer.Option(metavar="wgs84|map", help="Of `.geojson`: degrees, or the map's own x and y.")
    ] = "wgs84",
    json_file: JsonFile = None,
) -> None:
    """Show where the **battery lasts to**: one way, or there and back.

    On the border, a route over grid moves (`joulemap path --no-refine`) needs all of the charge above the reserve. A
    refined path may need less, so somewhat more can be reached than is shown.

    Examples:

    `joulemap reach dem.zarr --start 12,40 --charge 0.6 --reserve 0.2 --return --out reach.png`

    `joulemap reach dem.zarr --start 12,40 --charge 0.4,0.6,0.8 --confidence 0.95 --out reach.geojson`
    """
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.reach import ReachRequest, answer, ask, reach_geojson

    if out is not None and out.suffix.lower() not in _SUFFIXES:
        raise typer.BadParameter(f"{out} must end in one of {', '.join(_SUFFIXES)}", param_hint="--out")
    if coordinates not in ("wgs84", "map"):
        raise typer.BadParameter(f"{coordinates!r} is neither wgs84 nor map", param_hint="--coordinates")
    output = Output(json_file)
    ground = open_costmap(costmap)
    values, notes = wanted.on(ground.lattice.frame)
    found = ask(ground.planner, ReachRequest.of(**values))
    if out is not None:
        if out.suffix.lower() == ".geojson":
            document = reach_geojson(found, ground.warnings, coordinates=coordinates)
            content = (json.dumps(document, allow_nan=False) + "\n").encode()
        elif out.suffix.lower() == ".tif":
            content = found.geotiff()
        else:
            from joulemap.service.pictures import reach_image

            content = reach_image(ground.lattice, found)
        write_file(out, content)
    sure = "" if found.confidence is None else f" with a probability of {found.confidence:.0%}"
    output.say(f"{'there and back' if found.round_trip else 'one way'}{sure}", head="Reach")
    rows = {f"from {100 * level:g} % charge": f"{found.area_m2(k):,.0f} m2" for k, level in enumerate(found.charges)}
    output.table(rows | ({} if out is None else {"written": str(out)}))
    output.warn([*notes, *found.notes, *ground.warnings])
    written = answer(found, ground.warnings).model_dump(mode="json")
    output.document({**written, "out": None if out is None else str(out)})
