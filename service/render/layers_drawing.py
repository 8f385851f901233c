"""Layers on matplotlib axes: kinds of ground in colours, obstacles, given heights, factors and costs."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch
from numpy.typing import NDArray

from joulemap.model.terrain.layers.layer import COST, FACTOR, HEIGHT
from joulemap.model.terrain.windows import Ground
from joulemap.planner.lattice import Blocked
from joulemap.service.render.ground_drawing import REASONS, hatch_area, tinted_relief
from joulemap.service.render.map_layers import coarse_heights
from joulemap.service.render.map_style import style_map
from joulemap.service.render.raster_shading import centres, hillshade

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
