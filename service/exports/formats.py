"""What the registries of formats hold, which one a file means, and the local origin that ROS formats may have.

Parts of ROS keep positions as float32: at a northing of 4,000,000 m that has steps of 0.25 m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import InputError, nearest_name
from joulemap.planner.lattice import CostLattice
from joulemap.service.exports.track import Line, Track


@dataclass(frozen=True)
class Format:
    """A format that routes or cost maps are written in.

    Attributes
    ----------
    name : str
        Value of `format`.
    suffix : str
        How its file ends, or the first of its files.
    media_type : str
        For HTTP; of several files, a zip.
    words : str
        What it is for.
    home : str
        Module of this package and function that writes it, "module:function".
    degrees : bool
        Whether it needs longitude and latitude, WGS 84.
    """

    name: str
    suffix: str
    media_type: str
    words: str
    home: str
    degrees: bool = False

    def write(self, *what: Any, **how: Any) -> Any:
        """Return what its function writes."""
        module, function = self.home.split(":")
        return getattr(import_module(f"{__package__}.{module}"), function)(*what, **how)


def format_of(formats: Mapping[str, Format], file: str | Path, name: str | None = None) -> Format:
    """Return the format of a name, or of a file that is to be written. Raises InputError where neither says one."""
    if name is not None:
        if name in formats:
            return formats[name]
        near = nearest_name(name, formats)
        hint = f"; did you mean {near}?" if near else "."
        raise InputError(f"there is no format {name!r}{hint} Known are {', '.join(formats)}", format=name)
    found = [known for known in formats.values() if str(file).lower().endswith(known.suffix)]
    if not found:
        suffixes = ", ".join(f"{known.suffix} ({known.words})" for known in formats.values())
        raise InputError(
            f"the name {Path(file).name!r} does not say what to write: let it end with one of {suffixes}, or give "
            "`format`",
            path=str(file),
        )
    return max(found, key=lambda known: len(known.suffix))


FORMATS = ("mcap", "ros-path", "nav2-map", "nav2-graph")
"""Formats that are in metres of the map, for ROS."""
START = "start"
WORDS = f"of {', '.join(FORMATS)}: the place that gets the coordinates 0,0, as x,y in metres of the map"


def check_origin(origin: str | Sequence[float] | None, format: str) -> None:
    """Refuse an origin of a format that has its own."""
    if origin is not None and format not in FORMATS:
        raise InputError(f"`origin` is for {', '.join(FORMATS)}: leave it out for {format}", format=format)


def track_from(track: Track, origin: str | Sequence[float]) -> Track:
    """Return a track whose coordinates count from an origin: x, y [m], or "start"."""
    x, y = track.driven[0].points[0, :2] if origin == START else _numbers(origin)

    def _moved(line: Line) -> Line:
        profile = line.profile and replace(line.profile, x=line.profile.x - x, y=line.profile.y - y)
        return replace(line, points=line.points - np.array([x, y, 0.0]), profile=profile)

    return replace(track, lines=tuple(map(_moved, track.lines)), crs=None, lattice=None)


def lattice_from(lattice: CostLattice, origin: str | Sequence[float]) -> CostLattice:
    """Return a lattice whose coordinates count from an origin: x, y [m]."""
    x, y = _numbers(origin)
    frame = replace(lattice.frame, west_m=lattice.frame.west_m - x, north_m=lattice.frame.north_m - y, crs=None)
    return replace(lattice, frame=frame)


def _numbers(origin: str | Sequence[float]) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in (origin.split(",") if isinstance(origin, str) else origin))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(
            f"`origin` is {origin!r}: give x,y in metres of the map, or the word {START} for the start of a route"
        )
    return x, y
