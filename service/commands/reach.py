"""`joulemap reach`: where the battery lasts to, and where it lasts to and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.battery_file import BatteryFile, battery_values
from joulemap.service.commands.console import JsonFile, Output, parse_point, parse_share, write_file
from joulemap.service.commands.maps import MapFolder
from joulemap.service.commands.options import Avoid, Reserve, Snap

_SUFFIXES = (".geojson", ".tif", ".png")


def reach(
    costmap: MapFolder,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where the robot is.")],
    charge: Annotated[
        str, typer.Option(metavar="0..1[,0..1...]", help="State of charge there; several give nested outlines.")
    ] = "1.0",
    reserve: Reserve = 0.0,
    capacity_wh: Annotated[
        float | None,
        typer.Option(metavar="WH", help="Energy of the full battery [Wh]. [default: the robot's battery_wh]"),
    ] = None,
    battery_file: BatteryFile = None,
    round_trip: Annotated[
        bool, typer.Option("--return", "--round-trip", help="It must come back too, by the best way back.")
    ] = False,
    confidence: Annotated[
        float | None,
        typer.Option(
            metavar="0.5..0.99",
            help="With what probability the battery is to last. [default: the expected energy decides]",
        ),
    ] = None,
    avoid: Avoid = None,
    snap: Snap = False,
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
    from joulemap.model.battery import Battery
    from joulemap.service.commands.path_files import read_areas
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.schemas.reach import reach_geojson, reach_out

    charges = _charges(charge)
    if out is not None and out.suffix.lower() not in _SUFFIXES:
        raise typer.BadParameter(f"{out} must end in one of {', '.join(_SUFFIXES)}", param_hint="--out")
    if coordinates not in ("wgs84", "map"):
        raise typer.BadParameter(f"{coordinates!r} is neither wgs84 nor map", param_hint="--coordinates")
    output = Output(json_file)
    ground = open_costmap(costmap)
    given = battery_values(battery_file, capacity_wh)
    battery = Battery.from_mapping({"capacity_wh": ground.robot.battery_wh, **given, "reserve": reserve})
    areas, notes = read_areas(avoid, ground.lattice.frame)
    found = ground.reach(
        start, charge=charges, battery=battery, round_trip=round_trip, confidence=confidence, avoid=areas, snap=snap
    )
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
    sure = "" if confidence is None else f" with a probability of {confidence:.0%}"
    output.say(f"{'there and back' if round_trip else 'one way'}{sure}", head="Reach")
    rows = {f"from {100 * level:g} % charge": f"{found.area_m2(k):,.0f} m2" for k, level in enumerate(found.charges)}
    output.table(rows | ({} if out is None else {"written": str(out)}))
    output.warn([*notes, *found.notes, *ground.warnings])
    answer = reach_out(found, ground.warnings).model_dump(mode="json")
    output.document({**answer, "out": None if out is None else str(out)})


def _charges(text: str) -> tuple[float, ...]:
    return tuple(parse_share(part) for part in text.split(","))
