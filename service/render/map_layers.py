"""Pictures that lie on a map, without axes: ground, energy per metre in colour, blocked ground."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.image import imsave
from scipy import ndimage

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.windows import Ground
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.service.render.energy_colours import arrays_of, colour_scale, energy_image, free_values
from joulemap.service.render.ground_drawing import REASONS, blocked_everywhere, tinted_relief
from joulemap.service.render.raster_shading import Extent, Image, block_means, hillshade, thinned, thinning

_FINE_PIXELS = 900  # small maps are enlarged to about so many, so that hatching and relief are fine
_HATCH = 8  # pixels between two lines of a hatch
_STRIP_CELLS = 8_000_000  # of a heightmap that are in memory at a time
_PARTLY = 255  # code of what is blocked in some headings
_STRIP_VALUES = 500_000  # of a cost map that are worked on at a time: they stay in the processor's cache
_PARTLY_ALPHA = 0.35


def overview(stored: StoredLattice) -> CostLattice:
    """Return a coarse cost map of one that is too large for memory: of each square of cells, the one in the middle."""
    step = thinning(stored.frame.shape)
    rows, cols = (range(step // 2, max(n // step, 1) * step, step) for n in stored.frame.shape)
    return sampled(stored, rows, cols)


def sampled(lattice: CostLattice | StoredLattice, rows: range, cols: range) -> CostLattice:
    """Return every n-th cell of a part of a cost map as a coarse cost map."""
    frame, step = lattice.frame, rows.step
    if isinstance(lattice, CostLattice):
        part = np.s_[rows.start : rows.stop : step, cols.start : cols.stop : step]
        arrays = tuple(array[part] for array in arrays_of(lattice))
    else:
        strips = []
        for top in range(rows.start - rows.start % lattice.chunk, rows.stop, lattice.chunk):
            here = np.array([row - top for row in rows if top <= row < top + lattice.chunk], dtype=np.int64)
            if here.size:
                strip = lattice.window(top, min(top + lattice.chunk, frame.rows), cols.start, cols[-1] + 1)
                strips.append([part[here, ::step] for part in arrays_of(strip)])
        arrays = tuple(np.concatenate(parts) for parts in zip(*strips, strict=True))
    traction, elevation, gradient, blocked = arrays
    corner = frame.window(rows.start - step // 2, rows.stop, cols.start - step // 2, cols.stop)
    side = frame.resolution_m * step
    coarse = GridFrame(corner.west_m, corner.north_m, side, len(rows), len(cols), frame.crs)
    return CostLattice(coarse, lattice.robot, traction, elevation, gradient, blocked, lattice.provenance)


def coarse_heights(ground: Ground) -> tuple[Image, Extent]:
    """Return the heights of a heightmap of any size, with as many cells as a layer has pixels.

    Returns `heights` (rows, cols): as of `thinned`; `extent`: west, east, south, north [m].
    """
    frame, step = ground.frame, thinning(ground.frame.shape)
    strip = max(2, _STRIP_CELLS // (frame.cols * step)) * step
    parts = []
    for row in range(0, max(frame.rows // step, 1) * step, strip):
        end = min(row + strip, frame.rows)
        begin = row if end - row > 1 else row - 1  # a window has two rows at least
        heights = ground.window(begin, end, 0, frame.cols).heights[row - begin :]
        parts.append(block_means(heights, step))
    west, south, east, north = layer_bounds(frame)
    return np.concatenate(parts), (west, east, south, north)


def ground_layer(heights: Image, extent: Extent) -> bytes:
    """Draw shaded ground, tinted by height; what is unknown is transparent.

    `heights` (rows, cols): thinned, NaN where unknown; `extent`: west, east, south, north [m].
    """
    ground = heights
    times = _times(ground)
    known = np.isfinite(ground)
    if times > 1:
        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        filled = ground[tuple(nearest)] if known.any() else np.zeros(ground.shape)
        fine = ndimage.zoom(filled, times, order=3, grid_mode=True, mode="nearest")
        ground = np.where(_enlarged(known, times), fine, np.nan)
    alpha = np.isfinite(ground).astype(np.float64)
    return png(np.dstack([tinted_relief(ground, extent), alpha]))


def energy_layer(lattice: CostLattice, *, view: str = "mean", heading_deg: float | None = None) -> bytes:
    """Draw energy per metre, or how much the heading matters, in colour; what is blocked is transparent.

    `heading_deg`: the heading of the view "heading", clockwise from north. Result: a PNG over the map's bounds, in the
    colours of `colour_scale`.
    """

    def _priced(strip: CostLattice) -> Image:
        return free_values(strip, view, heading_deg)

    shown, extent = thinned(_by_strips(lattice, _priced), lattice.frame)
    ground, _ = thinned(lattice.elevation_m, lattice.frame)
    return png(energy_image(shown, hillshade(ground, extent), colour_scale(lattice, view), view))


def blocked_layer(lattice: CostLattice, *, heading_deg: float | None = None) -> bytes:
    """Draw what may not be driven, hatched in the colour of its reason; the rest is transparent.

    Result: a PNG over the map's bounds.
    """

    codes = _by_strips(lattice, lambda strip: blocked_codes(strip, heading_deg))
    step = thinning(codes.shape)
    rows, cols = (max(n // step, 1) * step for n in codes.shape)
    codes = codes[:rows:step, :cols:step]
    return png(blocked_image(_enlarged(codes, _times(codes))))


def blocked_codes(lattice: CostLattice, heading_deg: float | None) -> Image:
    """Return why cells may not be driven.

    Result (rows, cols): `Blocked` codes, and one for what is blocked in some headings.
    """
    if heading_deg is not None:
        return lattice.blocked_at(np.array([np.deg2rad(heading_deg)]))[..., 0]
    codes = blocked_everywhere(lattice)
    some = (lattice.blocked_by_heading() != Blocked.FREE).any(axis=2)
    return np.where((codes == Blocked.FREE) & some, np.uint8(_PARTLY), codes)


def blocked_image(codes: Image) -> Image:
    """Return blocked ground, hatched in the colour of its reason.

    `codes` (rows, cols): as of `blocked_codes`. Result (rows, cols, 4): red, green, blue and opacity, 0 to 1.
    """
    row, col = np.indices(codes.shape)
    image = np.zeros((*codes.shape, 4))
    image[codes == _PARTLY] = (*to_rgb(REASONS[Blocked.CROSS_SLOPE][0]), _PARTLY_ALPHA)
    for reason, (face, hatch, line) in REASONS.items():
        here = codes == reason
        image[here] = (*to_rgb(face), 0.92)
        falling = (row - col) % _HATCH < 2
        lines = falling | ((row + col) % _HATCH < 2) if "x" in hatch else falling
        image[here & lines] = (*(to_rgb(line) if hatch else _darker(face)), 1.0)
    return image


def layer_bounds(frame: GridFrame) -> tuple[float, float, float, float]:
    """Return where the layers of a map lie.

    Result: west, south, east, north [m]; of a map with more cells than a layer has pixels, what fills whole pixels.
    """
    step = thinning(frame.shape)
    rows, cols = (max(n // step, 1) * step for n in frame.shape)
    return frame.window(0, min(rows, frame.rows), 0, min(cols, frame.cols)).bounds


def _by_strips(lattice: CostLattice, value: Callable[[CostLattice], Image]) -> Image:
    rows = max(1, _STRIP_VALUES // (lattice.frame.cols * lattice.headings))
    tops = range(0, lattice.frame.rows, rows)
    return np.concatenate([value(lattice.window(top, min(top + rows, lattice.frame.rows))) for top in tops])


def _times(values: Image) -> int:
    return max(1, _FINE_PIXELS // max(values.shape))


def _enlarged(values: Image, times: int) -> Image:
    return values.repeat(times, axis=0).repeat(times, axis=1)


def _darker(colour: str) -> tuple[float, ...]:
    return tuple(0.8 * part for part in to_rgb(colour))


def png(image: Image) -> bytes:
    """Return an image as a file. `image` (rows, cols, 4): red, green, blue and opacity, 0 to 1."""
    sink = io.BytesIO()
    imsave(sink, image, format="png", pil_kwargs={"compress_level": 2})
    return sink.getvalue()
