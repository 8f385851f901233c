"""Routes on matplotlib axes: their lines on a map, and their height and energy over the distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator

from joulemap.planner.route import Route
from joulemap.service.render.raster_shading import INK, OPTIMAL, SHORTEST, quiet


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
