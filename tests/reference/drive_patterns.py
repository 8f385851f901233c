"""Drives of a given length over a site: parallel lines, legs from point to point, curves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from joulemap.model.field.drives import Drive, drive_along, lawnmower, random_waypoints, smooth_noise
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.sites import Site
from joulemap.model.frames import wrap_angle

PATTERNS = ("lawnmower", "waypoints", "winding")


def drive_of(pattern: str, site: Site, robot: FieldRobot, length_m: float, rng: np.random.Generator) -> Drive:
    """Draw a drive at the robot's declared speed."""
    west, south, east, north = site.drivable
    inside = (west + 1.0, south + 1.0, east - 1.0, north - 1.0)
    if pattern == "lawnmower":
        spacing = (inside[2] - inside[0]) * (inside[3] - inside[1]) / length_m
        heading = float(rng.uniform(0.0, math.pi))
        points = lawnmower(inside, spacing_m=spacing, heading_rad=heading)
        while _length(points) < length_m:
            spacing *= 0.95
            points = lawnmower(inside, spacing_m=spacing, heading_rad=heading)
        return drive_along(_cut_to(points, length_m), speed_mps=robot.declared.speed_mps, rng=rng, corner_m=0.8)
    if pattern == "winding":
        points = winding(inside, length_m, rng)
        return drive_along(points, speed_mps=robot.declared.speed_mps, rng=rng, corner_m=0.3)
    points = _without_reversals(random_waypoints(inside, int(length_m / 2.0), rng, least_leg_m=8.0))
    return drive_along(_cut_to(points, 1.05 * length_m), speed_mps=robot.declared.speed_mps, rng=rng, corner_m=0.8)


def winding(
    bounds: tuple[float, float, float, float],
    length_m: float,
    rng: np.random.Generator,
    *,
    curvature_per_m: float = 0.25,
) -> list[tuple[float, float]]:
    """Draw a path of one curve after another, which turns back before the bounds.

    `bounds`: west, south, east, north of the area [m]. Result: world x, y [m], every 0.25 m.
    """
    west, south, east, north = bounds
    x, y = float(rng.uniform(west, east)), float(rng.uniform(south, north))
    centre = (west + east) / 2, (south + north) / 2
    step = 0.25
    curvatures = curvature_per_m * smooth_noise(rng, max(int(length_m / step), 2), 2.0 / step)
    heading = math.atan2(centre[0] - x, centre[1] - y)
    points = [(x, y)]
    for curvature in curvatures:
        ahead = x + 3.5 * math.sin(heading), y + 3.5 * math.cos(heading)
        if not (west <= ahead[0] <= east and south <= ahead[1] <= north):
            inward = float(wrap_angle(math.atan2(centre[0] - x, centre[1] - y) - heading))
            curvature = math.copysign(0.8, inward)
        heading += curvature * step
        x, y = x + step * math.sin(heading), y + step * math.cos(heading)
        points.append((x, y))
    return points


def _without_reversals(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those of the points that can be driven to one after another without a turn of more than 110 degrees."""
    kept = list(points[:2])
    for point in points[2:]:
        before = math.atan2(kept[-1][0] - kept[-2][0], kept[-1][1] - kept[-2][1])
        ahead = math.atan2(point[0] - kept[-1][0], point[1] - kept[-1][1])
        if abs(wrap_angle(ahead - before)) < math.radians(110.0) and math.dist(kept[-1], point) > 3.0:
            kept.append(point)
    return kept


def _length(points: Sequence[tuple[float, float]]) -> float:
    return sum(math.dist(a, b) for a, b in zip(points, points[1:], strict=False))


def _cut_to(points: Sequence[tuple[float, float]], length_m: float) -> list[tuple[float, float]]:
    """The first `length_m` of a polyline, to 2 m."""
    kept = [points[0]]
    left = length_m
    for a, b in zip(points, points[1:], strict=False):
        leg = math.dist(a, b)
        share = min(left / leg, 1.0)
        kept.append((a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])))
        left -= leg
        if left < 2.0:
            break
    return kept
