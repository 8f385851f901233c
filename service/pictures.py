"""Pictures for people, as bytes of PNG: a cost map in colour, and a plan on its terrain with its profile."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Affine2D, offset_copy
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.edges import interpolation_matrix
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.route import Route

Image = NDArray[Any]
Extent = tuple[float, float, float, float]

VIEWS = ("mean", "directionality", "heading")
MAX_PIXELS = 1400  # longest side of a raster that is drawn; finer ones are averaged first
_TERRAIN = LinearSegmentedColormap.from_list("terrain", ["#9dbb94", "#d5d5a4", "#ead9b0", "#f4ead8"])
OPTIMAL, SHORTEST = "#0072B2", "#D55E00"  # Okabe & Ito's blue and vermilion: told apart by every kind of sight
_ARROW = [(0, 1), (0.55, 0.1), (0.16, 0.1), (0.16, -1), (-0.16, -1), (-0.16, 0.1), (-0.55, 0.1), (0, 1)]  # to north
INK, FAINT = "#22262b", "#7b838c"
_REASONS = {  # face colour, hatch
    Blocked.OUTSIDE: ("#e4e6e8", ""),
    Blocked.UNKNOWN: ("#ffffff", "////"),
    Blocked.STEP: ("#14161a", ""),
    Blocked.GRADE: ("#b3264a", ""),
    Blocked.CROSS_SLOPE: ("#f2a7b8", ""),
}


def lattice_image(lattice: CostLattice, *, view: str = "mean", heading_deg: float | None = None) -> bytes:
    """A PNG of the cost map.

    view : "mean" over the headings that may be driven, "directionality" (dearest minus cheapest of them), or "heading"
    (at `heading_deg`, clockwise from north, any angle). Raises InputError on another view or a heading that is missing
    or not finite.
    """
    values, codes, title = _view(lattice, view, heading_deg)
    shown, extent = _thinned(np.where(codes == Blocked.FREE, values, np.nan), lattice.frame)
    ground, _ = _thinned(lattice.elevation_m, lattice.frame)
    figure, axes = _map_figure(lattice.frame, extra_in=1.5)
    priced = shown[np.isfinite(shown)]
    low, high = (float(q) for q in np.quantile(priced, [0.02, 0.98])) if priced.size else (0.0, 1.0)
    high = max(high, low + 0.01 * max(1.0, abs(low)))  # an even map is one colour, not its rounding
    norm = Normalize(low, high)
    below, above = (priced < low).any(), (priced > high).any()
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    colours = colormaps["YlGn" if view == "directionality" else "YlGnBu"]
    image = colours(norm(np.nan_to_num(shown, nan=low)))[..., :3] * _faint(_hillshade(ground, extent))
    image[np.isnan(shown)] = 1.0
    axes.imshow(np.clip(image, 0.0, 1.0), extent=extent, interpolation="nearest")
    handles = _mark_blocked(axes, codes, extent)
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=axes, shrink=0.86, pad=0.02, extend=extend)
    bar.set_label(
        f"{'dearest - cheapest heading' if view == 'directionality' else 'energy per metre'} [J/m]", color=INK
    )
    bar.outline.set_visible(False)
    if view == "heading":
        _compass(figure, axes, math.radians(heading_deg or 0.0))
    model = lattice.provenance.get("model", {}).get("name", "unnamed model")
    rows, cols = lattice.frame.shape
    axes.set_title(title, loc="left", fontsize=13, fontweight="bold", color=INK, pad=22)
    about = f"{lattice.robot.name}  ·  model {model}  ·  {cols} x {rows} cells of {lattice.frame.resolution_m:g} m"
    axes.annotate(about, (0, 1), (0, 6), xycoords="axes fraction", textcoords="offset points", fontsize=9, color=FAINT)
    if handles:
        below_axes = offset_copy(axes.transAxes, figure, 0.0, -0.5)
        axes.legend(
            handles=handles,
            loc="upper center",
            ncols=3,
            frameon=False,
            fontsize=9,
            bbox_to_anchor=(0.5, 0.0),
            bbox_transform=below_axes,
        )
    return _png(figure)


def route_picture(
    heightmap: Heightmap,
    best: Route,
    other: Route,
    *,
    title: str,
    names: tuple[str, str] = ("energy-optimal", "shortest"),
    alternatives: Sequence[Route] = (),
) -> bytes:
    """A PNG of the terrain with two paths between the same places, and under it how both climb and spend.

    alternatives : other ways, drawn thin on the terrain alone.
    """
    frame = heightmap.frame
    ground, extent = _thinned(heightmap.heights, frame)
    west, south, east, north = frame.bounds
    width, height = _map_inches(frame)
    figure = _figure(width + 1.2, height + 4.4)
    grid = figure.add_gridspec(3, 1, height_ratios=[height, 1.35, 1.35])
    axes, climb, spent = (figure.add_subplot(grid[k]) for k in range(3))
    spent.sharex(climb)
    _style_map(axes, frame)
    _draw_ground(axes, ground, extent)
    for route, colour, name, line in ((other, SHORTEST, names[1], 2.2), (best, OPTIMAL, names[0], 2.8)):
        halo = [Stroke(linewidth=line + 2.2, foreground="white"), Normal()]
        label = f"{name}: {_energy(route.energy_j)}, {route.length_m:.1f} m"
        axes.plot(*route.points[:, :2].T, color=colour, lw=line, label=label, path_effects=halo, solid_capstyle="round")
        distance, heights, energy = _profile(route)
        climb.plot(distance, heights, color=colour, lw=1.8)
        spent.plot(distance, energy / 1000.0, color=colour, lw=1.8)
        spent.plot(distance[-1:], energy[-1:] / 1000.0, "o", color=colour, ms=4)
    for number, route in enumerate(alternatives, 1):
        label = f"alternative {number}: {_energy(route.energy_j)}, {route.length_m:.1f} m"
        axes.plot(*route.points[:, :2].T, color=INK, lw=1.2, ls=["--", ":", "-."][(number - 1) % 3], label=label)
    for point, marker, name in ((best.points[0], "o", "start"), (best.points[-1], "*", "goal")):
        size = 8 if marker == "o" else 15
        axes.plot(point[0], point[1], marker, ms=size, mfc="white", mec=INK, mew=1.5, ls="none", label=name, zorder=5)
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    handles, labels = axes.get_legend_handles_labels()
    order = [1, 0, *range(2, len(handles))]
    if np.isnan(ground).any():
        handles.append(_patch(Blocked.UNKNOWN))
        labels.append("unknown ground")
        order.append(len(handles) - 1)
    figure.legend(
        [handles[k] for k in order],
        [labels[k] for k in order],
        loc="outside lower center",
        ncols=len(order) if width > 6.5 and len(order) < 6 else 2,
        frameon=False,
        fontsize=9.5,
    )
    climb.set_ylabel("elevation [m]")
    spent.set_ylabel("energy [kJ]")
    spent.set_xlabel("distance along the path [m]")
    climb.tick_params(labelbottom=False)
    for profile in (climb, spent):
        _quiet(profile)
        profile.grid(axis="y", color="#e3e6e9", lw=0.8)
        profile.margins(x=0.01, y=0.12)
        profile.yaxis.set_major_locator(MaxNLocator(4))
    spent.set_ylim(bottom=min(0.0, spent.get_ylim()[0]))
    axes.set_title(title, loc="left", fontsize=13, fontweight="bold", color=INK, pad=10)
    figure.align_ylabels([climb, spent])
    return _png(figure)


def _view(lattice: CostLattice, view: str, heading_deg: float | None) -> tuple[Image, NDArray[np.uint8], str]:
    """(values [J/m], blocked codes, title) of a view; both arrays (rows, cols)."""
    if view == "heading":
        if heading_deg is None or not math.isfinite(heading_deg):
            raise InputError(f"the view of one heading needs heading_deg, a finite number, got {heading_deg}")
        heading = np.array([math.radians(heading_deg)])
        weights = interpolation_matrix(heading, lattice.headings)[0]
        price = lattice.robot.price_per_m(lattice.traction_per_m @ weights.astype(np.float32))
        return price, lattice.blocked_at(heading)[..., 0], f"Energy per metre, heading {heading_deg % 360.0:g}°"
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}", view=view)
    by_heading = lattice.blocked_by_heading()
    free = by_heading == Blocked.FREE
    some = free.any(axis=2)
    codes = np.where(some, 0, by_heading.min(axis=2)).astype(np.uint8)
    if view == "mean":
        return lattice.mean_energy_per_m(), codes, "Energy per metre, mean over headings"
    by_bin = lattice.energy_per_m
    dearest = np.where(free, by_bin, -np.inf).max(axis=2)
    cheapest = np.where(free, by_bin, np.inf).min(axis=2)
    return np.where(some, dearest - cheapest, np.nan), codes, "How much the heading matters"


def _thinned(values: Image, frame: GridFrame) -> tuple[Image, Extent]:
    """At most MAX_PIXELS a side, by means over square blocks (NaN where none is known), and the extent that is left."""
    step = math.ceil(max(values.shape) / MAX_PIXELS)
    rows, cols = (max(n // step, 1) for n in values.shape)
    west, south, east, north = frame.window(0, min(rows * step, frame.rows), 0, min(cols * step, frame.cols)).bounds
    extent = (west, east, south, north)
    if step == 1:
        return values, extent
    blocks = values[: rows * step, : cols * step].reshape(rows, step, cols, step)
    known = np.isfinite(blocks)
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    count = known.sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), extent


def _faint(shade: Image) -> Image:
    """So little of it that a colour is still that of the bar beside it."""
    return (0.75 + 0.25 * shade)[..., None]


def _hillshade(heights: Image, extent: Extent) -> Image:
    """Brightness 0.45..1.2 of ground lit from the north-west, exaggerated so that gentle slopes show; 1 unknown."""
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    pixel = (extent[1] - extent[0]) / heights.shape[1]
    south, east = np.gradient(heights.astype(np.float64), pixel)
    slope = np.hypot(south, east)
    steep = np.nanquantile(slope, 0.95) if np.isfinite(slope).any() else 0.0
    gain = 0.7 / steep if steep > 1e-9 else 0.0
    nx, ny = -east * gain, south * gain
    light = np.array([-0.5, 0.5, math.sqrt(0.5)])
    lit = (nx * light[0] + ny * light[1] + light[2]) / np.sqrt(nx**2 + ny**2 + 1.0)
    return np.nan_to_num(np.clip(0.45 + 0.75 * lit / light[2] * 0.72, 0.45, 1.2), nan=1.0)


def _draw_ground(axes: Axes, ground: Image, extent: Extent) -> None:
    """Tinted hillshade, contour lines with their heights, and a hatch over what is unknown."""
    known = ground[np.isfinite(ground)]
    low, high = (float(q) for q in np.quantile(known, [0.02, 0.98]))
    norm = Normalize(low, max(high, low + 0.1), clip=True)
    image = _TERRAIN(norm(np.nan_to_num(ground, nan=low)))[..., :3] * _hillshade(ground, extent)[..., None]
    image[np.isnan(ground)] = 1.0
    axes.imshow(np.clip(np.asarray(image), 0.0, 1.0), extent=extent, interpolation="bilinear")
    if np.isnan(ground).any():
        _hatch(axes, np.isnan(ground), extent, Blocked.UNKNOWN)
    if min(ground.shape) >= 2 and known.max() - known.min() > 0.05:
        levels: list[float] = list(MaxNLocator(14, steps=[1, 2, 5, 10]).tick_values(known.min(), known.max()))
        lines = axes.contour(
            *_centres(ground, extent), ground, levels=levels, colors="#5d5346", linewidths=0.6, alpha=0.55
        )
        axes.clabel(lines, levels[::2], fontsize=7, fmt="%g m", inline=True)


def _mark_blocked(axes: Axes, codes: NDArray[np.uint8], extent: Extent) -> list[Patch]:
    """Paint blocked cells by reason; returns a legend handle for each reason that occurs."""
    handles = []
    paint = np.zeros((*codes.shape, 4))
    for reason, (colour, hatch) in _REASONS.items():
        here = codes == reason
        if not here.any():
            continue
        paint[here] = (*to_rgb(colour), 1.0)
        if hatch:
            _hatch(axes, here, extent, reason)
        handles.append(_patch(reason))
    axes.imshow(paint, extent=extent, interpolation="nearest", zorder=1)
    return handles


def _hatch(axes: Axes, mask: NDArray[np.bool_], extent: tuple[float, float, float, float], reason: Blocked) -> None:
    padded = np.pad(mask.astype(np.float64), 1)
    dx = (extent[1] - extent[0]) / mask.shape[1]
    dy = (extent[3] - extent[2]) / mask.shape[0]
    wider = (extent[0] - dx, extent[1] + dx, extent[2] - dy, extent[3] + dy)
    area = axes.contourf(
        *_centres(padded, wider), padded, levels=[0.5, 1.5], colors="none", hatches=[_REASONS[reason][1]], zorder=2
    )
    area.set_edgecolor("#9aa1a8")
    area.set_linewidth(0.0)


def _patch(reason: Blocked) -> Patch:
    colour, hatch = _REASONS[reason]
    label = f"blocked: {reason.label.replace('_', ' ')}"
    return Patch(facecolor=colour, edgecolor="#9aa1a8", linewidth=0.5, hatch=hatch, label=label)


def _centres(values: Image | NDArray, extent: Extent) -> tuple[Image, Image]:
    west, east, south, north = extent
    rows, cols = values.shape
    return west + (np.arange(cols) + 0.5) * (east - west) / cols, north - (np.arange(rows) + 0.5) * (
        north - south
    ) / rows


def _profile(route: Route) -> tuple[Image, Image, Image]:
    """(n + 1,) distance [m], elevation [m] and energy spent [J], the start included."""
    profile = route.profile
    return (
        np.append(0.0, profile.distance_m),
        np.append(route.points[0, 2], profile.z),
        np.append(0.0, profile.cumulative_j),
    )


def _energy(energy_j: float) -> str:
    return f"{energy_j / 1000.0:.2f} kJ" if abs(energy_j) < 1e6 else f"{energy_j / 3600.0:.0f} Wh"


def _compass(figure: Figure, axes: Axes, heading_rad: float) -> None:
    """An arrow along the heading on a white badge in the north-east corner."""
    corner = offset_copy(axes.transAxes, figure, -0.32, -0.32)
    axes.plot(1.0, 1.0, "o", ms=34, mfc="white", mec=FAINT, mew=0.6, transform=corner, zorder=5)
    arrow = Path(_ARROW).transformed(Affine2D().rotate(-heading_rad))
    axes.plot(1.0, 1.0, marker=arrow, ms=22, mfc=INK, mew=0.0, transform=corner, zorder=6)


def _map_inches(frame: GridFrame) -> tuple[float, float]:
    """Size of the map on paper: 7.2 inches wide, or narrower where that would make it higher than 7."""
    width = 7.2
    height = width * frame.rows / frame.cols
    if height > 7.0:
        width, height = max(width * 7.0 / height, 4.8), 7.0
    return width, max(height, 1.2)


def _figure(width_in: float, height_in: float) -> Figure:
    figure = Figure(figsize=(width_in, height_in), dpi=120, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _map_figure(frame: GridFrame, *, extra_in: float) -> tuple[Figure, Axes]:
    width, height = _map_inches(frame)
    figure = _figure(width + extra_in, height + 1.5)
    axes = figure.add_subplot()
    _style_map(axes, frame)
    return figure, axes


def _style_map(axes: Axes, frame: GridFrame) -> None:
    """Axes in metres, to scale; large coordinates are counted from a round number, which the label names."""
    west, south, east, north = frame.bounds
    slender = max(frame.shape) > 12 * min(frame.shape)  # to scale, nothing would be seen of it
    axes.set_aspect("auto" if slender else "equal")
    for axis, low, high, name in ((axes.xaxis, west, east, "x"), (axes.yaxis, south, north, "y")):
        origin = math.floor(low / 100.0) * 100.0 if max(abs(low), abs(high)) >= 10_000.0 else 0.0
        axis.set_major_formatter(FuncFormatter(lambda value, _, origin=origin: f"{value - origin:g}"))
        share = 1.0 if slender else (high - low) / max(east - west, north - south)
        axis.set_major_locator(MaxNLocator(max(1, round(7 * share))))
        axis.set_label_text(f"{name} - {origin:,.0f} [m]".replace(",", " ") if origin else f"{name} [m]")
    _quiet(axes)


def _quiet(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#b9bfc5")
    axes.tick_params(colors=FAINT, labelsize=8.5, length=3)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_color(INK)
        label.set_fontsize(9.5)


def _png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", bbox_inches="tight", pad_inches=0.15)
    return out.getvalue()
