"""The options by which commands write routes for other programs: `--out`, `--format`, `--coordinates`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from joulemap.service.exports.routes import RouteFormat
    from joulemap.service.exports.track import Track

PLACE = "x,y in metres of the map's CRS, or latitude,longitude where that cannot be meant; 36.72N,4.49W always is"
"""How a place is typed, for the help of commands."""

_SUFFIXES = ".geojson, .gpx, .kml, .csv, .plan (QGroundControl), .waypoints (ArduPilot), .mcap, .path.json (ROS)"

RouteFiles = Annotated[
    list[Path] | None,
    typer.Option("--out", metavar="FILE", help=f"Write it for another program, by suffix: {_SUFFIXES}. Repeatable."),
]
RouteFormatName = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="NAME",
        help="Format of `--out`, whatever its suffix: geojson, gpx, kml, csv, qgc-plan, waypoints, mcap, ros-path.",
    ),
]
RouteCoordinates = Annotated[
    str | None,
    typer.Option(
        "--coordinates",
        metavar="wgs84|map",
        help="Of GeoJSON: longitude and latitude, or x and y in the map's CRS [m]. [default: wgs84]",
    ),
]


@dataclass(frozen=True)
class WantedFile:
    """A file that a command is to write.

    Attributes
    ----------
    path : Path
        Where.
    chosen : RouteFormat
        In which format.
    coordinates : str or None
        Of GeoJSON.
    """

    path: Path
    chosen: RouteFormat
    coordinates: str | None

    @property
    def query(self) -> dict[str, Any]:
        """What a service is asked for."""
        return {"format": self.chosen.name} | ({} if self.coordinates is None else {"coordinates": self.coordinates})

    def check(self, crs: str | None) -> None:
        """Refuse what cannot be written on a map with this CRS, before anything is computed. Raises InputError."""
        from joulemap.service.exports.routes import check_route_format

        check_route_format(self.chosen, crs, self.coordinates)

    def content(self, track: Track) -> bytes:
        """The file of a track."""
        from joulemap.service.exports.routes import route_file

        return route_file(track, self.chosen, coordinates=self.coordinates)


def wanted_files(
    out: list[Path] | None, format: str | None, coordinates: str | None, geojson: Path | None = None
) -> list[WantedFile]:
    """The files that a command line names. Raises InputError where a name does not say a format."""
    from joulemap.service.exports.routes import route_format, route_format_of

    chosen = [(path, route_format_of(path, format)) for path in out or []]
    chosen += [] if geojson is None else [(geojson, route_format("geojson"))]
    if not chosen and (format is not None or coordinates is not None):
        raise typer.BadParameter("--format and --coordinates go with --out: name the file to write")
    return [WantedFile(path, kind, coordinates if kind.name == "geojson" else None) for path, kind in chosen]
