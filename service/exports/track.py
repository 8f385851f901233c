"""What a route's file is written from: priced lines on a map, of a path, a tour or a suggested drive; and degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, world_points
from joulemap.planner.route import Profile, Route
from joulemap.service.exports.clearance import FURTHEST_M, cleared
from joulemap.service.places.coordinates import DECIMALS, from_wgs84, to_wgs84

if TYPE_CHECKING:  # it takes its time to load
    from joulemap.planner.answers import Plan, RoundTrip


OPTIMAL, SHORTEST, ALTERNATIVE, TOUR_LEG, DRIVE = "energy_optimal", "shortest", "alternative", "tour_leg", "drive"
WAY_OUT, WAY_BACK = "way_out", "way_back"
BESIDE = (SHORTEST, ALTERNATIVE)
"""Kinds of lines that are shown beside what is driven."""


@dataclass(frozen=True, eq=False)
class Line:
    """A polyline.

    Attributes
    ----------
    kind : str
        One of this module's kinds.
    points : ndarray of float, (n, 3)
        World x, y, z [m]; z is NaN where unknown.
    properties : dict
        JSON-able: `energy_j`, `length_m`, `duration_s` and more.
    profile : Profile or None
        The line metre by metre; None where it was not priced.
    """

    kind: str
    points: NDArray[np.float64]
    properties: dict[str, Any] = field(default_factory=dict)
    profile: Profile | None = None

    @property
    def along_m(self) -> NDArray[np.float64]:
        """Distance of each corner from the start [m]."""
        return np.append(0.0, np.cumsum(np.hypot(*np.diff(self.points[:, :2], axis=0).T)))

    @property
    def title(self) -> str:
        """The kind in words."""
        number = self.properties.get("number")
        return self.kind.replace("_", " ") + (f" {number}" if number is not None else "")


@dataclass(frozen=True, eq=False)
class Track:
    """Lines for a file.

    Attributes
    ----------
    name : str
        What the file calls itself.
    lines : tuple of Line
        Those that are driven first, in their order.
    crs : str or None
        Coordinate reference system of the points.
    speed_mps : float
        How fast they are driven [m/s].
    lattice : CostLattice or None
        With which missions are simplified; None: they keep all corners.
    extra : dict
        JSON-able members of a GeoJSON document.
    stretches : tuple of (float, float)
        Where each stretch of the one line that is driven ends, from the start [m], and its speed [m/s]; empty where all
        is driven at `speed_mps`.
    """

    name: str
    lines: tuple[Line, ...]
    crs: str | None
    speed_mps: float
    lattice: CostLattice | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    stretches: tuple[tuple[float, float], ...] = ()

    @property
    def driven(self) -> tuple[Line, ...]:
        """The lines that are driven one after another."""
        return tuple(line for line in self.lines if line.kind not in BESIDE)


def line_of(route: Route, kind: str, **properties: Any) -> Line:
    """Return a route as a line. Result: with energy, length and duration among its properties."""
    own = {"energy_j": route.energy_j, "length_m": route.length_m, "duration_s": route.duration_s}
    return Line(kind, route.points, {"kind": kind, **own, **properties}, route.profile)


def track_of_plan(plan: Plan, lattice: CostLattice, *, warnings: Sequence[str] = (), battery: Any = None) -> Track:
    """Return a path, the shortest one and the alternatives as a track."""
    best = line_of(plan.route, OPTIMAL, planner=plan.planner, saving_j=plan.saving_j)
    others = (line_of(other, ALTERNATIVE, number=k) for k, other in enumerate(plan.others, start=1))
    extra = {"warnings": [*warnings, *plan.route.notes], "battery": battery}
    lines = (best, line_of(plan.shortest, SHORTEST), *others)
    return Track("joulemap path", lines, plan.route.crs, lattice.robot.speed_mps, lattice, extra)


def track_of_tour(trip: RoundTrip, lattice: CostLattice, *, warnings: Sequence[str] = ()) -> Track:
    """Return a tour as a track. Result: a line for each leg, in the order of driving."""
    lines = tuple(
        line_of(leg, TOUR_LEG, number=k, from_stop=here, to_stop=there)
        for k, (leg, (here, there)) in enumerate(zip(trip.legs, trip.hops, strict=True), start=1)
    )
    extra = {"warnings": [*warnings, *trip.notes]}
    return Track("joulemap tour", lines, trip.legs[0].crs, lattice.robot.speed_mps, lattice, extra)


def track_of_task(
    routes: Sequence[Route], lattice: CostLattice, *, warnings: Sequence[str] = (), battery: Any = None
) -> Track:
    """Return the way out, and the way back of a round trip, as a track."""
    lines = tuple(line_of(route, kind) for route, kind in zip(routes, (WAY_OUT, WAY_BACK), strict=False))
    extra = {"warnings": [*warnings, *routes[0].notes], "battery": battery}
    name = "joulemap there and back" if len(lines) > 1 else "joulemap path"
    return Track(name, lines, routes[0].crs, lattice.robot.speed_mps, lattice, extra)


def track_of_drive(drive: Mapping[str, Any]) -> Track:
    """Return a suggested drive as a track.

    Result: one line; what it takes is not known, and its heights are not either.
    """
    if "why_not" in drive:
        raise InputError(f"no drive is suggested: {drive['why_not']}")
    if not drive.get("placed", True):
        raise InputError(
            "the corners of this drive are no places: its runs have no positions, so only its shape counts. "
            "`points` of the answer has them, with 0,0 wherever there is room"
        )
    points = np.array(drive["points"], dtype=np.float64)
    speeds = drive["speeds_mps"]
    keys = ("effect", "label", "length_m", "total_length_m", "speeds_mps")
    line = Line(
        DRIVE,
        np.column_stack([points, np.full(len(points), np.nan)]),
        {"kind": DRIVE, **{key: drive[key] for key in keys}},
    )
    return Track(f"joulemap drive for {drive['label']}", (line,), drive.get("crs"), float(speeds[0]))


def degrees_of(track: Track, line: Line) -> NDArray[np.float64]:
    """Return the corners of a line as a file has them.

    Result (n, 2): longitude, latitude [degrees], rounded, within 1 cm of the corners. Read again, all legs may be
    driven that may be driven, unless a passage is as narrow as a line.
    """
    plain = to_wgs84(track.crs, line.points)
    if track.lattice is None:
        return np.round(plain, DECIMALS)
    lattice = track.lattice
    places = cleared(
        lattice,
        world_points(lattice, line.points),
        furthest_m=FURTHEST_M,
        quantise=lambda points: read_again(lattice, points),
    )
    x, y = lattice.frame.xy(places[:, 0], places[:, 1])
    return np.round(to_wgs84(track.crs, np.column_stack([x, y])), DECIMALS)


def read_again(lattice: CostLattice, points: Points) -> Points:
    """Return places of a lattice after they were written in degrees and read again.

    `points` (n, 2): fractional (row, col). The result is (n, 2).
    """
    frame = lattice.frame
    lonlat = np.round(to_wgs84(frame.crs, np.column_stack(frame.xy(points[:, 0], points[:, 1]))), DECIMALS)
    return world_points(lattice, from_wgs84(frame.crs, lonlat))


def degree_text(value: float) -> str:
    """Return degrees as text. `value`: longitude or latitude [degrees]."""
    return f"{value:.{DECIMALS}f}"
