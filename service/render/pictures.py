"""Pictures for people, as bytes of PNG: a cost map in colour, routes with their profile, the layers of a map, a run."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import offset_copy
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers.layer import COST, FACTOR, HEIGHT
from joulemap.model.terrain.windows import Ground
from joulemap.planner.areas.energy_map import EnergyMap, FieldKind
from joulemap.planner.areas.reach_map import ReachMap
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.route import Route
from joulemap.service.render.energy_colours import draw_costmap
from joulemap.service.render.ground_drawing import (
    REASONS,
    draw_ground,
    draw_lattice_ground,
    hatch_area,
    tinted_relief,
)
from joulemap.service.render.map_layers import coarse_heights
from joulemap.service.render.raster_shading import FAINT, INK, OPTIMAL, SHORTEST, centres, hillshade, quiet, style_map


def draw_routes(
    axes: Axes,
    best: Route,
    other: Route | None = None,
    *,
    names: tuple[str, str] = ("energy-optimal", "shortest"),
    alternatives: Sequence[Route] = (),
) -> None:
    """Draw routes between the same places, with start and goal; their labels give energy and length."""
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

    `quantity`: "elevation" [m] or "energy" [kJ] spent since the start.
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
    quiet(axes)
    axes.grid(axis="y", color="#e3e6e9", lw=0.8)
    axes.margins(x=0.01, y=0.12)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    if quantity != "elevation":
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def _energy(energy_j: float) -> str:
    return f"{energy_j / 1000.0:.2f} kJ" if abs(energy_j) < 1e6 else f"{energy_j / 3600.0:.0f} Wh"


_MARKED = {HEIGHT: ("heights of a layer [m]", "////", "#0072B2"), FACTOR: ("factor", "\\\\\\\\", "#7a4a00"),
           COST: ("added J/m", "++", "#5b2a86")}  # fmt: skip
_KIND_SHARE = 0.75  # of the colour of a kind, over that of heights


def draw_layers(axes: Axes, ground: Ground) -> list[Patch]:
    """Draw the ground of a map with its layers. Result: legend handles of what is to be seen."""
    heights, extent = coarse_heights(ground)
    x, y = np.broadcast_arrays(*(a[None, :] if k == 0 else a[:, None] for k, a in enumerate(centres(heights, extent))))
    layers, light = ground.layers, hillshade(heights, extent)
    image = tinted_relief(heights, extent)
    style_map(axes, ground.frame)
    handles, at = list[Patch](), layers.kind_at(x, y)
    for number, kind in enumerate(layers.kinds):
        here, colour = at == number, colormaps["Set3"](number % 12)[:3]
        if here.any() and not kind.blocked:
            shaded = np.array(colour) * (0.72 + 0.28 * np.nan_to_num(light, nan=1.0)[here, None])
            image[here] = _KIND_SHARE * shaded + (1.0 - _KIND_SHARE) * image[here]
            handles.append(Patch(facecolor=colour, label=f"{kind.name}, {here.mean():.1%}"))
    closed = np.zeros(heights.shape, dtype=np.bool_)
    for layer in layers.closing:
        closed |= layer.is_closed(x, y)
    if closed.any():
        face, hatch, line = REASONS[Blocked.OBSTACLE]
        image[closed] = to_rgb(face)
        hatch_area(axes, closed, extent, hatch, line)
        handles.append(Patch(facecolor=face, edgecolor=line, hatch=hatch, linewidth=0.5, label="obstacle"))
    axes.imshow(np.clip(image, 0.0, 1.0), extent=extent, interpolation="nearest")
    for layer in layers.of(*_MARKED):
        label, hatch, line = _MARKED[layer.role]
        if layer.function is not None:
            handles.append(Patch(facecolor="none", label=f"{label}: {layer.source}"))
            continue
        here = layer.knows(x, y)
        if here.any():
            hatch_area(axes, here, extent, hatch, line)
            handles.append(Patch(facecolor="none", edgecolor=line, hatch=hatch, linewidth=0.5,
                                 label=f"{label}: {_between(layer.at(x, y)[here])}"))  # fmt: skip
    return handles


def _between(values: NDArray[np.float32]) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"


_NAME_LETTERS = 60  # of a name that is drawn


def lattice_image(lattice: CostLattice, *, view: str = "mean", heading_deg: float | None = None) -> bytes:
    """Draw a cost map. `heading_deg`: the heading of the view "heading", clockwise from north."""
    figure, axes = _map_figure(lattice.frame, extra_in=1.5)
    drawn = draw_costmap(axes, lattice, view=view, heading_deg=heading_deg)
    bar = figure.colorbar(drawn.scale, ax=axes, shrink=0.86, pad=0.02, extend=drawn.extend)
    bar.set_label(drawn.label, color=INK)
    bar.outline.set_visible(False)
    model = lattice.provenance.get("model", {}).get("name", "unnamed model")
    rows, cols = lattice.frame.shape
    axes.set_title(drawn.title, loc="left", fontsize=13, fontweight="bold", color=INK, pad=22)
    names = _literal(f"{lattice.robot.name[:_NAME_LETTERS]}  ·  model {model[:_NAME_LETTERS]}")
    about = f"{names}  ·  {cols} x {rows} cells of {lattice.frame.resolution_m:g} m"
    axes.annotate(about, (0, 1), (0, 6), xycoords="axes fraction", textcoords="offset points", fontsize=9, color=FAINT)
    if drawn.handles:
        below_axes = offset_copy(axes.transAxes, figure, 0.0, -0.5)
        axes.legend(
            handles=drawn.handles,
            loc="upper center",
            ncols=3,
            frameon=False,
            fontsize=9,
            bbox_to_anchor=(0.5, 0.0),
            bbox_transform=below_axes,
        )
    return _png(figure)


_FIELD_TITLES = {
    FieldKind.FROM: "Least energy from the start",
    FieldKind.TO: "Least energy to the goal",
    FieldKind.THROUGH: "Least energy from start to goal over each cell",
}


def field_image(field: EnergyMap, *, within: float | None = None) -> bytes:
    """Draw an energy field."""
    figure, axes = _map_figure(field.frame, extra_in=1.5)
    west, south, east, north = field.frame.bounds
    drawn = axes.imshow(
        field.energy_j / 1e3, extent=(west, east, south, north), cmap="viridis", interpolation="nearest"
    )
    if within is not None:
        x, y = field.frame.centres()
        axes.contour(x, y, field.corridor(within).astype(float), levels=[0.5], colors=[INK], linewidths=0.8)
    bar = figure.colorbar(drawn, ax=axes, shrink=0.86, pad=0.02)
    bar.set_label("energy [kJ]", color=INK)
    bar.outline.set_visible(False)
    axes.set_title(_FIELD_TITLES[field.kind], loc="left", fontsize=13, fontweight="bold", color=INK)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    return _png(figure)


def reach_image(lattice: CostLattice, reach: ReachMap) -> bytes:
    """Draw where a battery lasts to, over the terrain.

    Result: a PNG: a filled outline for each charge, the largest charge below.
    """
    figure, axes = _map_figure(lattice.frame, extra_in=1.2)
    patches = draw_lattice_ground(axes, lattice)
    shades = colormaps["viridis"](np.linspace(0.15, 0.9, len(reach.charges)))
    handles: list[Patch] = []
    for shade, k in zip(shades, np.argsort(reach.charges)[::-1], strict=True):
        rings = [ring for part in reach.polygons(int(k)) for ring in part]
        if rings:
            codes = [[Path.MOVETO, *[Path.LINETO] * (len(ring) - 2), Path.CLOSEPOLY] for ring in rings]
            outline = Path(np.concatenate(rings), np.concatenate(codes))
            axes.add_patch(PathPatch(outline, facecolor=(*shade[:3], 0.25), edgecolor=shade, linewidth=1.6))
        label = f"from {100 * reach.charges[k]:g} % charge: {reach.area_m2(int(k)):,.0f} m²"
        handles.append(Patch(facecolor=(*shade[:3], 0.25), edgecolor=shade, label=label))
    axes.plot(*reach.start, marker="o", markersize=7, color="white", markeredgecolor=INK, linestyle="none", zorder=5)
    how = "Reach, there and back" if reach.round_trip else "Reach"
    sure = "" if reach.confidence is None else f", {reach.confidence:.0%} likely"
    axes.set_title(how + sure, loc="left", fontsize=13, fontweight="bold", color=INK)
    figure.legend(handles=[*handles, *patches], loc="outside lower center", ncols=2, frameon=False, fontsize=9.5)
    return _png(figure)


def route_picture(
    ground: Heightmap | CostLattice,
    best: Route,
    other: Route,
    *,
    title: str,
    names: tuple[str, str] = ("energy-optimal", "shortest"),
    alternatives: Sequence[Route] = (),
) -> bytes:
    """Draw two paths between the same places on the terrain, and under it their heights and the energy they take."""
    frame = ground.frame
    width, height = _map_inches(frame)
    figure = _figure(width + 1.2, height + 4.4)
    grid = figure.add_gridspec(3, 1, height_ratios=[height, 1.35, 1.35])
    axes, climb, spent = (figure.add_subplot(grid[k]) for k in range(3))
    spent.sharex(climb)
    if isinstance(ground, Heightmap):
        patches = draw_ground(axes, ground.heights, frame)
    else:
        patches = draw_lattice_ground(axes, ground)
    draw_routes(axes, best, other, names=names, alternatives=alternatives)
    for route, colour in ((other, SHORTEST), (best, OPTIMAL)):
        draw_profile(climb, route, quantity="elevation", colour=colour)
        draw_profile(spent, route, quantity="energy", colour=colour)
    handles = [*axes.get_legend_handles_labels()[0], *patches]
    figure.legend(
        handles,
        [str(handle.get_label()) for handle in handles],
        loc="outside lower center",
        ncols=len(handles) if width > 6.5 and len(handles) < 6 else 2,
        frameon=False,
        fontsize=9.5,
    )
    spent.set_xlabel("distance along the path [m]")
    climb.tick_params(labelbottom=False)
    axes.set_title(_literal(title), loc="left", fontsize=13, fontweight="bold", color=INK, pad=10)
    figure.align_ylabels([climb, spent])
    return _png(figure)


def layers_picture(ground: Ground) -> bytes:
    """Draw the layers of a heightmap of any size over its shaded ground."""
    figure, axes = _map_figure(ground.frame, extra_in=0.0)
    handles = draw_layers(axes, ground)
    axes.set_title(_literal(ground.source[:_NAME_LETTERS]), loc="left", fontsize=13, fontweight="bold", color=INK)
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return _png(figure)


def _literal(text: str) -> str:
    """A text in which matplotlib sees no formula."""
    return text.replace("$", r"\$")


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
    return figure, axes


def _png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", bbox_inches="tight", pad_inches=0.15)
    return out.getvalue()
