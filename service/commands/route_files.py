"""The options by which commands write routes for other programs: `--out`, `--format`, `--coordinates`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from joulemap.service.commands.console import check_origin

if TYPE_CHECKING:
    from joulemap.service.exports.formats import Format
    from joulemap.service.exports.routes import RouteFile

PLACE = "x,y in metres of the map's CRS, or latitude,longitude where that cannot be meant; 36.72N,4.49W always is"
"""How a place is typed, for the help of commands."""

_SUFFIXES = ".geojson, .gpx, .kml, .csv, .plan (QGroundControl), .waypoints (ArduPilot), .mcap, .path.json (ROS)"


@dataclass(frozen=True)
class RouteFiles:
    """Files of routes for other programs, as the options name them."""

    out: Annotated[
        list[Path] | None,
        typer.Option(
            "--out", metavar="FILE", help=f"Write it for another program, by suffix: {_SUFFIXES}. Repeatable."
        ),
    ] = None
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Format of `--out`, whatever its suffix: geojson, gpx, kml, csv, qgc-plan, waypoints, mcap, ros-path.",
        ),
    ] = None
    coordinates: Annotated[
        str | None,
        typer.Option(
            "--coordinates",
            metavar="wgs84|map",
            help="Of GeoJSON: longitude and latitude, or x and y in the map's CRS [m]. [default: wgs84]",
        ),
    ] = None

    origin: Annotated[
        str | None,
        typer.Option(
            "--origin",
            metavar="X,Y|start",
            callback=check_origin,
            help="Of ROS formats: the place that gets the coordinates 0,0 [m], or the start of the route.",
        ),
    ] = None

    def wanted(self) -> list[tuple[Path, RouteFile]]:
        """The files that are named, and how each is written. Raises InputError where a name does not say a format."""
        from joulemap.service.exports.formats import FORMATS, format_of
        from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile

        chosen = [(path, format_of(ROUTE_FORMATS, path, self.format)) for path in self.out or []]
        geojson = getattr(self, "geojson", None)
        chosen += [] if geojson is None else [(geojson, ROUTE_FORMATS["geojson"])]
        if not chosen and not (self.format is self.coordinates is self.origin is None):
            raise typer.BadParameter("--format, --coordinates and --origin go with --out: name the file to write")
        if self.origin is not None and not any(kind.name in FORMATS for _, kind in chosen):
            raise typer.BadParameter(f"--origin is for {', '.join(FORMATS[:2])}: name one by --out or --format")

        def _written(kind: Format) -> RouteFile:
            coordinates = self.coordinates if kind.name == "geojson" else None
            return RouteFile(kind, coordinates, self.origin if kind.name in FORMATS else None)

        return [(path, _written(kind)) for path, kind in chosen]


@dataclass(frozen=True)
class PlannedFiles(RouteFiles):
    """The same of routes that were planned."""

    geojson: Annotated[Path | None, typer.Option(metavar="FILE", help="Write all routes as GeoJSON.")] = None
