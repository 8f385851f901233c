"""Paths that a driver takes: parallel lines, random waypoints and any polyline, driven a little imperfectly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d

from joulemap.model.errors import PointError
from joulemap.model.frames import TAU, heading_of, wrap_angle

FloatArray = NDArray[np.float64]

STEP_M = 0.025
"""Distance between the stations of a drive [m]: half a cell of the true terrain."""


@dataclass(frozen=True)
class Drive:
    """The path as driven, one entry per station, `STEP_M` from one to the next."""

    x: FloatArray  # (n,): World positions [m]
    y: FloatArray
    heading_rad: FloatArray  # (n,): Headings [rad]
    speed_mps: FloatArray  # (n,): Speeds [m/s]

    @property
    def length_m(self) -> float:
        """Horizontal length [m]."""
        return float(np.hypot(np.diff(self.x), np.diff(self.y)).sum())

    @property
    def curvature(self) -> FloatArray:
        """Curvature of the path [rad/m], > 0 to the right, (n,)."""
        step = np.maximum(np.hypot(np.diff(self.x), np.diff(self.y)), 1e-9)
        turn = wrap_angle(np.diff(self.heading_rad)) / step
        return np.concatenate([turn[:1], turn])


def drive_along(
    points: ArrayLike,
    *,
    speed_mps: float,
    rng: np.random.Generator | None = None,
    wander_m: float = 0.08,
    wander_length_m: float = 2.0,
    corner_m: float = 0.5,
    speed_spread: float = 0.03,
) -> Drive:
    """Follow a polyline. `points` (k, 2): corners in world x, y [m]."""
    nodes = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    legs = np.hypot(*np.diff(nodes, axis=0).T) if len(nodes) > 1 else np.empty(0)
    if not np.isfinite(nodes).all() or not (legs > 0).any():
        raise PointError(f"a drive needs at least two distinct finite points, got {nodes.tolist()[:3]}")
    x, y = _resample(nodes[:, 0], nodes[:, 1])
    if corner_m > 0:
        sigma = corner_m / STEP_M
        x, y = (gaussian_filter1d(_extended(v, sigma), sigma)[_pad(sigma) : -_pad(sigma)] for v in (x, y))
        x, y = _resample(x, y)
    if rng is not None and wander_m > 0:
        heading = _track_heading(x, y)
        sideways = smooth_noise(rng, x.size, wander_length_m / STEP_M) * wander_m
        x, y = _resample(x + sideways * np.cos(heading), y - sideways * np.sin(heading))
    heading = _track_heading(x, y)
    drive = Drive(x, y, heading, np.full(x.size, float(speed_mps)))
    turning = gaussian_filter1d(np.abs(drive.curvature), 2.0, mode="nearest")
    speed = speed_mps / np.sqrt(1.0 + (turning / 1.5) ** 2)
    if rng is not None and speed_spread > 0:
        speed = speed * np.exp(speed_spread * smooth_noise(rng, x.size, 1.5 / STEP_M))
    return Drive(x, y, heading, gaussian_filter1d(speed, 2.0, mode="nearest"))


def lawnmower(
    bounds: tuple[float, float, float, float], *, spacing_m: float, heading_rad: float = 0.0
) -> list[tuple[float, float]]:
    """Return the corners of parallel lines that cover an area, driven to and fro.

    `bounds`: west, south, east, north of the area [m]; `heading_rad`: heading of the lines [rad], 0 is the paper's
    north-south pattern. Result: world x, y [m], inside the bounds.
    """
    west, south, east, north = bounds
    centre = np.array([(west + east) / 2, (south + north) / 2])
    along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
    across = np.array([along[1], -along[0]])
    reach = math.hypot(east - west, north - south) / 2
    points: list[tuple[float, float]] = []
    for k, offset in enumerate(np.arange(-reach + spacing_m / 2, reach, spacing_m)):
        span = _clip(centre + offset * across, along, bounds)
        if span is None or span[1] - span[0] < spacing_m:
            continue
        ends = [centre + offset * across + s * along for s in (span if k % 2 == 0 else span[::-1])]
        points += [(float(p[0]), float(p[1])) for p in ends]
    return points


def random_waypoints(
    bounds: tuple[float, float, float, float], count: int, rng: np.random.Generator, *, least_leg_m: float = 4.0
) -> list[tuple[float, float]]:
    """Draw points that are uniform in an area.

    `bounds`: west, south, east, north of the area [m]. Result: world x, y [m].
    """
    west, south, east, north = bounds
    least = min(least_leg_m, 0.4 * math.hypot(east - west, north - south))
    points = [(float(rng.uniform(west, east)), float(rng.uniform(south, north)))]
    while len(points) < count:
        new = (float(rng.uniform(west, east)), float(rng.uniform(south, north)))
        if math.dist(new, points[-1]) >= least:
            points.append(new)
    return points


def _clip(
    origin: FloatArray, along: FloatArray, bounds: tuple[float, float, float, float]
) -> tuple[float, float] | None:
    """Range of s in which origin + s * along lies inside the bounds."""
    low, high = -math.inf, math.inf
    for o, d, a, b in zip(origin, along, bounds[:2], bounds[2:], strict=True):
        if abs(d) < 1e-12:
            if not a <= o <= b:
                return None
            continue
        s0, s1 = sorted(((a - o) / d, (b - o) / d))
        low, high = max(low, s0), min(high, s1)
    return (float(low), float(high)) if high > low else None


def _resample(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same polyline with points every `STEP_M` (stretched a little so that the ends stay)."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    fresh = np.concatenate([[True], np.diff(s) > 0])
    at = np.linspace(0.0, s[-1], max(round(s[-1] / STEP_M), 1) + 1)
    return np.interp(at, s[fresh], x[fresh]), np.interp(at, s[fresh], y[fresh])


def _pad(sigma: float) -> int:
    return int(4 * sigma) + 1


def _extended(values: FloatArray, sigma: float) -> FloatArray:
    """Continued by point reflection, so that smoothing leaves a straight line and both ends where they are."""
    return np.pad(values, _pad(sigma), mode="reflect", reflect_type="odd")


def _track_heading(x: FloatArray, y: FloatArray) -> FloatArray:
    heading = heading_of(np.diff(x), np.diff(y))
    return np.concatenate([heading[:1], heading])


def smooth_noise(rng: np.random.Generator, n: int, sigma: float) -> FloatArray:
    """Draw smooth Gaussian noise of unit variance.

    `sigma`: standard deviation of the Gaussian that smooths white noise [samples]. The result is (n,).
    """
    pad = _pad(sigma)
    rough = rng.standard_normal(n + 2 * pad)
    return gaussian_filter1d(rough, sigma)[pad:-pad] * math.sqrt(2.0 * sigma * math.sqrt(TAU / 2.0))
