"""Cut squares out of a heightmap: the paper's patches along a heading, and north-up squares for the dense network."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import heading_vector
from joulemap.model.terrain.heightmap import FloatArray, Heightmap, bilinear


def cut_patches(
    heightmap: Heightmap, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike, *, size: int = 32, side_m: float = 1.0
) -> NDArray[np.float32]:
    """Cut the patches of segments along their heading.

    `x`, `y` (n,): start p of each segment [m], or what broadcasts to it; `heading_rad` (n,): heading h of each segment
    [rad]. Result (n, size, size): heights [m] above the lowest one of the patch. NaN throughout where a patch leaves
    the map or meets an unknown height.

    p is the middle of the patch's bottom edge (last row) and q = p + side_m (sin h, cos h) the middle of its top edge
    (row 0). Column 0 lies to the left of the motion. Samples include the edges and are bilinear.

    Reference: Wei & Isler 2022, sections IV-B and IV-D (size 256, side 1 m).
    """
    _check_square(size, side_m, "side_m")
    xs, ys, headings = _flat(x, y, heading_rad)
    dx, dy = heading_vector(headings)
    row, col = heightmap.frame.rowcol(xs, ys)
    per_sample = side_m / ((size - 1) * heightmap.resolution_m)
    return _cut_patches(heightmap.heights, row, col, dx * per_sample, dy * per_sample, size)


def cut_squares(
    heightmap: Heightmap,
    x: ArrayLike,
    y: ArrayLike,
    *,
    size: int,
    pixel_m: float,
    pad_m: float = 0.0,
    turned_rad: ArrayLike = 0.0,
) -> NDArray[np.float32]:
    """Cut squares around places, north-up or turned.

    `x`, `y` (n,): centres [m], or what broadcasts to them; `turned_rad` (n,): turn of each square, counter-clockwise:
    its row 0 faces the heading -turned_rad [rad]. Result (n, size, size): heights [m] relative to the centre; row 0 is
    north and column 0 west. NaN throughout where a square meets an unknown height, or leaves the map by more than
    `pad_m`.

    Sample i lies (i - (size - 1) / 2) pixel_m from the centre. Beyond the map's edge the heights are continued by odd
    reflection at the outer cell centres, 2 h(edge) - h(mirror image), as numpy's pad(mode="reflect",
    reflect_type="odd") does. A plane thus stays a plane.
    """
    _check_square(size, pixel_m, "pixel_m")
    if not (math.isfinite(pad_m) and pad_m >= 0):
        raise InputError(f"pad_m must be a distance in metres, got {pad_m}", pad_m=str(pad_m))
    xs, ys, turned = _flat(x, y, turned_rad)
    row, col = heightmap.frame.rowcol(xs, ys)
    resolution = heightmap.resolution_m
    sine, cosine = np.sin(turned), np.cos(turned)
    return _cut_squares(heightmap.heights, row, col, sine, cosine, pixel_m / resolution, size, pad_m / resolution)


def _check_square(size: int, length_m: float, name: str) -> None:
    if size < 2:
        raise InputError(f"a patch needs at least 2 x 2 samples, got size {size}", size=size)
    if not (math.isfinite(length_m) and length_m > 0):
        raise InputError(f"{name} must be a positive number of metres, got {length_m}")


def _flat(*arrays: ArrayLike) -> tuple[FloatArray, ...]:
    broadcast = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in arrays))
    if broadcast[0].ndim != 1:
        raise InputError(f"points must form a list, got an array of shape {broadcast[0].shape}")
    return tuple(np.ascontiguousarray(a) for a in broadcast)


@njit(cache=True, parallel=True, nogil=True)
def _cut_patches(
    heights: NDArray[np.float32], row: FloatArray, col: FloatArray, east: FloatArray, north: FloatArray, size: int
) -> NDArray[np.float32]:
    """row, col : p in cells. east, north : (n,) step along the motion in cells per sample. Returns (n, size, size)."""
    out = np.empty((row.size, size, size), np.float32)
    middle = 0.5 * (size - 1)
    for n in prange(row.size):
        # Relative to p first: float32 keeps millimetres at any altitude only for small numbers.
        base = bilinear(heights, row[n], col[n])
        lowest = math.inf
        known = not math.isnan(base)
        for i in range(size):
            if not known:
                break
            along = size - 1 - i
            for j in range(size):
                right = j - middle  # the motion's right is (north, -east)
                height = bilinear(
                    heights,
                    row[n] - along * north[n] + right * east[n],
                    col[n] + along * east[n] + right * north[n],
                )
                if math.isnan(height):
                    known = False
                    break
                out[n, i, j] = height - base
                lowest = min(lowest, out[n, i, j])
        if known:
            for i in range(size):
                for j in range(size):
                    out[n, i, j] -= lowest
        else:
            out[n] = np.nan
    return out


@njit(cache=True, inline="always")
def _mirror(at: float, last: int) -> tuple[float, float, bool]:
    """(mirror image, edge, outside) of a fractional index beyond 0..last."""
    if at < 0.0:
        return -at, 0.0, True
    if at > last:
        return 2.0 * last - at, float(last), True
    return at, at, False


@njit(cache=True)
def _continued(heights: NDArray[np.float32], row: float, col: float, pad: float) -> float:
    """Bilinear height, continued by odd reflection up to `pad` cells beyond the bounds."""
    rows, cols = heights.shape
    beyond = 0.5 + pad + 1e-6
    if not (-beyond <= row <= rows - 1 + beyond and -beyond <= col <= cols - 1 + beyond):
        return math.nan
    row_in, row_edge, row_out = _mirror(row, rows - 1)
    col_in, col_edge, col_out = _mirror(col, cols - 1)
    inside = bilinear(heights, row_in, col_in)
    if row_out and col_out:
        at_rows = 2.0 * bilinear(heights, row_edge, col_in) - inside
        at_corner = 2.0 * bilinear(heights, row_edge, col_edge) - bilinear(heights, row_in, col_edge)
        return 2.0 * at_corner - at_rows
    if row_out or col_out:
        return 2.0 * bilinear(heights, row_edge, col_edge) - inside
    return inside


@njit(cache=True, parallel=True, nogil=True)
def _cut_squares(
    heights: NDArray[np.float32],
    row: FloatArray,
    col: FloatArray,
    sine: FloatArray,
    cosine: FloatArray,
    pixel: float,
    size: int,
    pad: float,
) -> NDArray[np.float32]:
    """row, col : centres in cells. sine, cosine : of the turn. pixel, pad : in cells. Returns (n, size, size)."""
    out = np.empty((row.size, size, size), np.float32)
    middle = 0.5 * (size - 1)
    for n in prange(row.size):
        centre = _continued(heights, row[n], col[n], pad)
        known = not math.isnan(centre)
        for i in range(size):
            for j in range(size):
                if not known:
                    break
                south, east = (i - middle) * pixel, (j - middle) * pixel
                height = _continued(
                    heights,
                    row[n] + south * cosine[n] - east * sine[n],
                    col[n] + east * cosine[n] + south * sine[n],
                    pad,
                )
                known = not math.isnan(height)
                out[n, i, j] = height - centre
        if not known:
            out[n] = np.nan
    return out
