"""Maps on matplotlib axes: hillshade, contours, what is blocked and why, energy per metre in colour, routes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Affine2D, offset_copy
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.planner.edges import interpolation_matrix
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.route import Route
from joulemap.service.raster_shading import Extent, Image, centres, hillshade, thinned

VIEWS = ("mean", "directionality", "heading")
"""What a cost map can be coloured by."""
OPTIMAL, SHORTEST = "#0072B2", "#D55E00"
"""Colours of the two routes: blue and vermilion of Okabe & Ito, which people with any colour vision distinguish."""
INK, FAINT = "#22262b", "#7b838c"

_TERRAIN = LinearSegmentedColormap.from_list("terrain", ["#9dbb94", "#d5d5a4", "#ead9b0", "#f4ead8"])
_ARROW = [(0, 1), (0.55, 0.1), (0.16, 0.1), (0.16, -1), (-0.16, -1), (-0.16, 0.1), (-0.55, 0.1), (0, 1)]  # to north
REASONS = {  # face colour, hatch, colour of the hatch: none of them is a colour of the price
    Blocked.OUTSIDE: ("#e4e6e8", "", "#9aa1a8"),
    Blocked.UNKNOWN: ("#ffffff", "////", "#9aa1a8"),
    Blocked.STEP: ("#8a8f94", "xxxx", "#f4f5f6"),
    Blocked.GRADE: ("#b3264a", "", "#9aa1a8"),
    Blocked.CROSS_SLOPE: ("#f2a7b8", "", "#9aa1a8"),
}
"""How blocked ground is painted, by reason: face colour, hatch, colour of the hatch."""
_PARTLY = ("#f8d7df", 0.8)
"""Colour and opacity of what is blocked in some headings: pale, because routes cross it."""
_LEAST_SPAN = 0.1
"""Least span of the colours, as a share of the mean price: a map on which all prices are nearly equal looks so."""


@dataclass(frozen=True)
class CostmapDrawing:
    """What was drawn of a cost map.

    Attributes
    ----------
    scale : matplotlib.cm.ScalarMappable
        Prices and their colours, for a colour bar.
    extend : str
        At which ends prices lie beyond the colours: "neither", "min", "max" or "both".
    label : str
        What the colours mean, with the unit.
    title : str
        What is shown.
    handles : list of matplotlib.patches.Patch
        A legend handle for each reason that something is blocked.
    """

    scale: ScalarMappable
    extend: str
    label: str
    title: str
    handles: list[Patch]


def new_axes() -> Axes:
    """Make axes on a new figure of pyplot, so that a notebook shows it."""
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(8.0, 6.0), layout="constrained")[1]


def draw_costmap(
    axes: Axes, lattice: CostLattice, *, view: str = "mean", heading_deg: float | None = None
) -> CostmapDrawing:
    """Draw a cost map in colour, with what is blocked and why.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    lattice : CostLattice
        The cost map.
    view : str, optional
        "mean" over the headings that may be driven, "directionality" (dearest minus cheapest of them), or "heading".
    heading_deg : float, optional
        The heading of the view "heading", clockwise from north, any angle.

    Returns
    -------
    CostmapDrawing
        What a colour bar, a title and a legend need.

    Raises
    ------
    InputError
        On another view, or a heading that is missing or not finite.
    """
    values, codes, title = values_of_view(lattice, view, heading_deg)
    shown, extent = thinned(np.where(codes == Blocked.FREE, values, np.nan), lattice.frame)
    ground, _ = thinned(lattice.elevation_m, lattice.frame)
    style_map(axes, lattice.frame)
    priced = shown[np.isfinite(shown)]
    low, high = (float(q) for q in np.quantile(priced, [0.02, 0.98])) if priced.size else (0.0, 1.0)
    mean = float(np.abs(priced).mean()) if priced.size else 1.0
    high = max(high, low + max(_LEAST_SPAN * mean, 1e-3))
    norm = Normalize(low, high)
    colours = colormaps["YlGn" if view == "directionality" else "YlGnBu"]
    image = colours(norm(np.nan_to_num(shown, nan=low)))[..., :3] * (0.75 + 0.25 * hillshade(ground, extent))[..., None]
    image[np.isnan(shown)] = 1.0
    axes.imshow(np.clip(image, 0.0, 1.0), extent=extent, interpolation="nearest")
    handles = draw_blocked(axes, codes, extent)
    if view == "heading":
        _compass(axes, math.radians(heading_deg or 0.0))
    below, above = bool((priced < low).any()), bool((priced > high).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    label = f"{'dearest - cheapest heading' if view == 'directionality' else 'energy per metre'} [J/m]"
    return CostmapDrawing(ScalarMappable(norm, colours), extend, label, title, handles)


def draw_ground(
    axes: Axes, heights: Image, frame: GridFrame, *, blocked: NDArray[np.uint8] | None = None
) -> list[Patch]:
    """Draw tinted hillshade, contour lines with their heights, and what may not be driven.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    heights : ndarray, (rows, cols) [m]
        NaN where unknown.
    frame : GridFrame
        Where the cells lie.
    blocked : ndarray of uint8, (rows, cols), optional
        `Blocked` codes of cells that may not be driven in any heading.

    Returns
    -------
    list of matplotlib.patches.Patch
        A legend handle for unknown ground and for each reason that occurs.
    """
    ground, extent = thinned(heights, frame)
    style_map(axes, frame)
    known = ground[np.isfinite(ground)]
    axes.imshow(tinted_relief(ground, extent), extent=extent, interpolation="bilinear")
    if min(ground.shape) >= 2 and known.size and known.max() - known.min() > 0.05:
        levels: list[float] = list(MaxNLocator(14, steps=[1, 2, 5, 10]).tick_values(known.min(), known.max()))
        lines = axes.contour(
            *centres(ground, extent), ground, levels=levels, colors="#5d5346", linewidths=0.6, alpha=0.55
        )
        axes.clabel(lines, levels[::2], fontsize=7, fmt="%g m", inline=True)
    if blocked is None:
        codes = np.where(np.isnan(heights), np.uint8(Blocked.UNKNOWN), np.uint8(Blocked.FREE))
    else:
        codes = blocked
    west, south, east, north = frame.bounds
    return draw_blocked(axes, codes, (west, east, south, north))


def tinted_relief(
    ground: Image, extent: Extent, *, between: tuple[float, float] | None = None, steep: float | None = None
) -> Image:
    """Return ground as an image: shaded relief, tinted by height.

    Parameters
    ----------
    ground : ndarray, (rows, cols) [m]
        Heights, NaN where unknown.
    extent : tuple of float
        West, east, south, north [m].
    between : tuple of float, optional
        `tint_range` of the whole, where this is a part of it.
    steep : float, optional
        Its `steepness`.

    Returns
    -------
    ndarray, (rows, cols, 3)
        Red, green and blue, 0 to 1; white where unknown.
    """
    low, high = tint_range(ground) if between is None else between
    norm = Normalize(low, high, clip=True)
    light = hillshade(ground, extent, steep=steep)
    image = _TERRAIN(norm(np.nan_to_num(ground, nan=low)))[..., :3] * light[..., None]
    image[np.isnan(ground)] = 1.0
    return np.clip(np.asarray(image), 0.0, 1.0)


def tint_range(ground: Image) -> tuple[float, float]:
    """Return the heights at the two ends of the tints of `tinted_relief`.

    Parameters
    ----------
    ground : ndarray, (rows, cols) [m]
        Heights, NaN where unknown.

    Returns
    -------
    tuple of float
        2 % and 98 % quantiles [m].
    """
    known = ground[np.isfinite(ground)]
    low, high = (float(q) for q in np.quantile(known, [0.02, 0.98])) if known.size else (0.0, 1.0)
    return low, max(high, low + 0.1)


def draw_lattice_ground(axes: Axes, lattice: CostLattice) -> list[Patch]:
    """Draw the terrain of a cost map, and what may not be driven in any heading, or not in some.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    lattice : CostLattice
        The cost map.

    Returns
    -------
    list of matplotlib.patches.Patch
        As `draw_ground`, and one for what is blocked in some headings.
    """
    codes = blocked_everywhere(lattice)
    handles = draw_ground(axes, lattice.elevation_m, lattice.frame, blocked=codes)
    partly = (codes == Blocked.FREE) & (lattice.blocked_by_heading() != Blocked.FREE).any(axis=2)
    if not partly.any():
        return handles
    colour, opacity = _PARTLY
    paint = np.zeros((*partly.shape, 4))
    paint[partly] = (*to_rgb(colour), opacity)
    west, south, east, north = lattice.frame.bounds
    axes.imshow(paint, extent=(west, east, south, north), interpolation="nearest", zorder=1)
    label = "blocked in some headings"
    return [*handles, Patch(facecolor=colour, edgecolor=REASONS[Blocked.CROSS_SLOPE][0], linewidth=0.5, label=label)]


def blocked_everywhere(lattice: CostLattice) -> NDArray[np.uint8]:
    """Return what may not be driven in any heading, and why.

    Parameters
    ----------
    lattice : CostLattice
        The cost map.

    Returns
    -------
    ndarray of uint8, (rows, cols)
        `Blocked` codes; FREE where some heading may be driven.
    """
    by_heading = lattice.blocked_by_heading()
    some = (by_heading == Blocked.FREE).any(axis=2)
    return np.where(some, np.uint8(Blocked.FREE), by_heading.min(axis=2)).astype(np.uint8)


def draw_blocked(axes: Axes, codes: NDArray[np.uint8], extent: Extent) -> list[Patch]:
    """Paint blocked cells by reason.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    codes : ndarray of uint8, (rows, cols)
        `Blocked` codes.
    extent : tuple of float
        West, east, south, north [m].

    Returns
    -------
    list of matplotlib.patches.Patch
        A legend handle for each reason that occurs.
    """
    handles = []
    paint = np.zeros((*codes.shape, 4))
    for reason, (colour, hatch, _) in REASONS.items():
        here = codes == reason
        if not here.any():
            continue
        paint[here] = (*to_rgb(colour), 1.0)
        if hatch:
            _hatch(axes, here, extent, reason)
        handles.append(_patch(reason))
    if handles:
        axes.imshow(paint, extent=extent, interpolation="nearest", zorder=1)
    return handles


def draw_routes(
    axes: Axes,
    best: Route,
    other: Route | None = None,
    *,
    names: tuple[str, str] = ("energy-optimal", "shortest"),
    alternatives: Sequence[Route] = (),
) -> None:
    """Draw routes between the same places, with start and goal; their labels give energy and length.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    best : Route
        Drawn boldest.
    other : Route, optional
        Drawn under it.
    names : tuple of str, optional
        What the two are called.
    alternatives : sequence of Route, optional
        Drawn thin.
    """
    for route, colour, name, line in ((best, OPTIMAL, names[0], 2.8), (other, SHORTEST, names[1], 2.2)):
        if route is not None:
            halo = [Stroke(linewidth=line + 2.2, foreground="white"), Normal()]
            axes.plot(
                *route.points[:, :2].T,
                color=colour,
                lw=line,
                label=f"{name}: {_energy(route.energy_j)}, {route.length_m:.1f} m",
                path_effects=halo,
                solid_capstyle="round",
                zorder=3.0 + line / 10.0,  # the best one on top
            )
    for number, route in enumerate(alternatives, 1):
        label = f"alternative {number}: {_energy(route.energy_j)}, {route.length_m:.1f} m"
        line_style = ["--", ":", "-."][(number - 1) % 3]
        axes.plot(*route.points[:, :2].T, color=INK, lw=1.2, ls=line_style, label=label, zorder=3)
    for point, marker, name in ((best.points[0], "o", "start"), (best.points[-1], "*", "goal")):
        size = 8 if marker == "o" else 15
        axes.plot(point[0], point[1], marker, ms=size, mfc="white", mec=INK, mew=1.5, ls="none", label=name, zorder=5)


def draw_profile(axes: Axes, route: Route, *, quantity: str, colour: str = OPTIMAL, label: str | None = None) -> None:
    """Draw height or energy over the distance along a route.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    route : Route
        The route.
    quantity : str
        "elevation" [m] or "energy" [kJ] spent since the start.
    colour : str, optional
        Of the line.
    label : str, optional
        For a legend.
    """
    profile = route.profile
    distance = np.append(0.0, profile.distance_m)
    if quantity == "elevation":
        values = np.append(route.points[0, 2], profile.z)
        axes.set_ylabel("elevation [m]")
    else:
        values = np.append(0.0, profile.cumulative_j) / 1000.0
        axes.plot(distance[-1:], values[-1:], "o", color=colour, ms=4)
        axes.set_ylabel("energy [kJ]")
    axes.plot(distance, values, color=colour, lw=1.8, label=label)
    _quiet(axes)
    axes.grid(axis="y", color="#e3e6e9", lw=0.8)
    axes.margins(x=0.01, y=0.12)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    if quantity != "elevation":
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def style_map(axes: Axes, frame: GridFrame) -> None:
    """Make axes a map: in metres of the map's CRS, to scale, over the map's bounds.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        To be styled.
    frame : GridFrame
        Of the map.
    """
    west, south, east, north = frame.bounds
    slender = max(frame.shape) > 12 * min(frame.shape)  # to scale, nothing would be seen of it
    axes.set_aspect("auto" if slender else "equal")
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    for axis, low, high, name in ((axes.xaxis, west, east, "x"), (axes.yaxis, south, north, "y")):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}".replace(",", " ")))
        share = 1.0 if slender else (high - low) / max(east - west, north - south)
        most = 4 if max(abs(low), abs(high)) >= 10_000.0 else 7  # long numbers need room
        axis.set_major_locator(MaxNLocator(max(1, round(most * share))))
        axis.set_label_text(f"{name} [m]")
    _quiet(axes)


def values_of_view(lattice: CostLattice, view: str, heading_deg: float | None) -> tuple[Image, NDArray[np.uint8], str]:
    """Return what a cost map is coloured by.

    Parameters
    ----------
    lattice : CostLattice
        The cost map.
    view : str
        "mean", "directionality" or "heading", as for `draw_costmap`.
    heading_deg : float or None
        The heading of the view "heading".

    Returns
    -------
    values : ndarray, (rows, cols) [J/m]
        To be coloured where nothing is blocked.
    codes : ndarray of uint8, (rows, cols)
        `Blocked` codes.
    title : str
        What is shown.

    Raises
    ------
    InputError
        On another view, or a heading that is missing or not finite.
    """
    if view == "heading":
        if heading_deg is None or not math.isfinite(heading_deg):
            raise InputError(f"the view of one heading needs heading_deg, a finite number, got {heading_deg}")
        heading = np.array([math.radians(heading_deg)])
        weights = interpolation_matrix(heading, lattice.headings)[0]
        price = lattice.robot.price_per_m(lattice.traction_per_m @ weights.astype(np.float32))
        return price, lattice.blocked_at(heading)[..., 0], f"Energy per metre, heading {heading_deg % 360.0:g}°"
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}", view=view)
    codes = blocked_everywhere(lattice)
    if view == "mean":
        return lattice.mean_energy_per_m(), codes, "Energy per metre, mean over headings"
    free = lattice.blocked_by_heading() == Blocked.FREE
    by_bin = lattice.energy_per_m
    dearest = np.where(free, by_bin, -np.inf).max(axis=2)
    cheapest = np.where(free, by_bin, np.inf).min(axis=2)
    return np.where(codes == Blocked.FREE, dearest - cheapest, np.nan), codes, "How much the heading matters"


def _hatch(axes: Axes, mask: NDArray[np.bool_], extent: tuple[float, float, float, float], reason: Blocked) -> None:
    padded = np.pad(mask.astype(np.float64), 1)
    dx = (extent[1] - extent[0]) / mask.shape[1]
    dy = (extent[3] - extent[2]) / mask.shape[0]
    wider = (extent[0] - dx, extent[1] + dx, extent[2] - dy, extent[3] + dy)
    area = axes.contourf(
        *centres(padded, wider), padded, levels=[0.5, 1.5], colors="none", hatches=[REASONS[reason][1]], zorder=2
    )
    area.set_edgecolor(REASONS[reason][2])
    area.set_linewidth(0.0)


def _patch(reason: Blocked) -> Patch:
    colour, hatch, line = REASONS[reason]
    label = f"blocked: {reason.label.replace('_', ' ')}"
    return Patch(facecolor=colour, edgecolor=line, linewidth=0.5, hatch=hatch, label=label)


def _energy(energy_j: float) -> str:
    return f"{energy_j / 1000.0:.2f} kJ" if abs(energy_j) < 1e6 else f"{energy_j / 3600.0:.0f} Wh"


def _compass(axes: Axes, heading_rad: float) -> None:
    """An arrow along the heading on a white badge in the north-east corner."""
    corner = offset_copy(axes.transAxes, axes.get_figure(root=True), -0.32, -0.32)
    axes.plot(1.0, 1.0, "o", ms=34, mfc="white", mec=FAINT, mew=0.6, transform=corner, zorder=5)
    arrow = Path(_ARROW).transformed(Affine2D().rotate(-heading_rad))
    axes.plot(1.0, 1.0, marker=arrow, ms=22, mfc=INK, mew=0.0, transform=corner, zorder=6)


def _quiet(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#b9bfc5")
    axes.tick_params(colors=FAINT, labelsize=8.5, length=3)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_color(INK)
        label.set_fontsize(9.5)
