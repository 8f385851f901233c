"""`joulemap reach`, `field` and `return`: where the battery lasts to, energies everywhere, the way home."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, parse_point, write_file
from joulemap.service.commands.options import there
from joulemap.service.commands.remote import MapOrId, Remote
from joulemap.service.words import duration_words, energy_words

if TYPE_CHECKING:
    from joulemap.model.frames import GridFrame


MapFolder = Annotated[
    Path, typer.Argument(metavar="MAP.zarr", callback=there, help="A cost map made by `joulemap costmap`.")
]
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
    from joulemap.service.questions import reach as question

    if out is not None and out.suffix.lower() not in _SUFFIXES:
        raise typer.BadParameter(f"{out} must end in one of {', '.join(_SUFFIXES)}", param_hint="--out")
    if coordinates not in ("wgs84", "map"):
        raise typer.BadParameter(f"{coordinates!r} is neither wgs84 nor map", param_hint="--coordinates")
    output = Output(json_file)
    said = Remote().answer(question, costmap, wanted, output)
    found, ground = said.found, said.ground
    if out is not None:
        if out.suffix.lower() == ".geojson":
            document = question.reach_geojson(found, ground.warnings, coordinates=coordinates)
            content = (json.dumps(document, allow_nan=False) + "\n").encode()
        elif out.suffix.lower() == ".tif":
            content = found.geotiff()
        else:
            from joulemap.service.render.pictures import reach_image

            content = reach_image(ground.lattice, found)
        write_file(out, content)
    sure = "" if found.confidence is None else f" with a probability of {found.confidence:.0%}"
    output.say(f"{'there and back' if found.round_trip else 'one way'}{sure}", head="Reach")
    rows = {f"from {100 * level:g} % charge": f"{found.area_m2(k):,.0f} m2" for k, level in enumerate(found.charges)}
    output.table(rows | ({} if out is None else {"written": str(out)}))
    output.warn(said.values["warnings"])
    output.document({**said.values, "out": None if out is None else str(out)})


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
    from joulemap.service.questions import field as question

    output = Output(json_file)
    said = Remote().answer(question, costmap, wanted, output)
    found, figures = said.found, said.values | {"out": str(out)}
    output.warn(figures.pop("warnings"))
    write_file(out, found.energies.geotiff(within=found.within))
    output.say(figures["kind"], head="Energy field")
    rows = {"cells reached": f"{figures['reached']:,} of {figures['cells']:,}", "written": str(out)}
    rows["energy"] = f"{figures['least_j'] / 1e3:.2f} .. {figures['most_j'] / 1e3:.2f} kJ"
    if (corridor := figures["corridor_cells"]) is None:
        del figures["corridor_cells"]
    else:
        rows["corridor"] = f"{corridor:,} cells within {wanted.typed['within_percent']:g} % of the best route"
    output.table(rows)
    output.document(figures)


def point_of_no_return(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.homeward:ReturnRequest -position"],
    position: Annotated[
        Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where the robot is. [default: the path's start]")
    ] = None,
    json_file: JsonFile = None,
    *,
    remote: Remote,
) -> None:
    """Say until where a robot may follow its path and **still come home**: the point of no return.

    Ways home are counted over grid moves, as by `joulemap path --no-refine`: a refined path may need less energy.

    Examples:

    `joulemap return dem.zarr --path survey.geojson --home 12,40 --charge 0.5 --reserve 0.2`

    `joulemap return dem.zarr --position 80,60 --home 12,40 --charge 0.1 --charging 60,20`
    """
    from joulemap.service.questions import homeward

    output = Output(json_file)
    if "path" not in wanted and position is None:
        raise typer.BadParameter("give --path, --position or both")

    def _placed(values: dict[str, Any], _frame: GridFrame) -> list[str]:
        values["position"] = [float(v) for v in values["path"][0][:2]] if position is None else position
        return []

    _say_return(output, remote.answer(homeward, costmap, wanted, output, also=_placed).values)


def _say_return(output: Output, found: dict[str, Any]) -> None:
    output.say(head=found["text"], style="bold green" if found["still_home"] else "bold red")
    rows = {}
    if (place := found["point_of_no_return"]) is not None:
        ahead = f"{place['distance_m']:.0f} m, {duration_words(place['time_s'])}"
        rows["point of no return"] = f"({place['x']:.2f}, {place['y']:.2f}), {ahead} ahead"
    for k, bail in enumerate(found["charging"], 1):
        if not bail["reachable"]:
            rows[f"charging place {k}"] = "out of reach"
            continue
        leave = bail["last"]
        until = "" if leave is None else f", leave the path after {leave['distance_m']:.0f} m at the latest"
        rows[f"charging place {k}"] = f"{energy_words(bail['energy_j'])} from here{until}"
    output.table(rows)
    output.warn(dict.fromkeys(found["warnings"]))
    output.document(found)
