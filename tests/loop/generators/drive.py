"""Kinematic drives over a site: a unicycle that steers from one random waypoint to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.loop.generators.config import DriveConfig
from tests.loop.generators.site import Site

FloatArray = NDArray[np.float64]

SIDE_M = 0.25
"""Half distance of the two points that give the slope across the motion [m]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The true motion of one run, one row per 1 / rate seconds, (n,) each.

    Attributes
    ----------
    t : ndarray of float
        Time since the start of the run [s].
    x, y : ndarray of float
        Position [m].
    z : ndarray of float
        Height of the ground [m].
    heading_rad : ndarray of float
        Of the body, clockwise from north.
    speed_mps : ndarray of float
        Along the body; negative is backwards.
    yaw_rate : ndarray of float
        Positive to the right [rad/s].
    driven_m : ndarray of float
        Length of the track so far.
    acceleration_mps2 : ndarray of float
        Rate of change of the speed's magnitude.
    grade : ndarray of float
        Tangent of the slope along the motion, positive uphill, between the axles.
    cross : ndarray of float
        Tangent of the slope across the body, positive where the right side is lower.
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    heading_rad: FloatArray
    speed_mps: FloatArray
    yaw_rate: FloatArray
    driven_m: FloatArray
    acceleration_mps2: FloatArray
    grade: FloatArray
    cross: FloatArray

    @property
    def rolling_mps(self) -> FloatArray:
        """Magnitude of the speed [m/s]."""
        return np.abs(self.speed_mps)

    @property
    def course_rad(self) -> FloatArray:
        """Direction of the motion, clockwise from north [rad]."""
        return self.heading_rad + np.where(self.speed_mps < 0.0, np.pi, 0.0)

    def __len__(self) -> int:
        return int(self.t.size)


def drive_over(
    site: Site, config: DriveConfig, *, cruising_mps: float, wheelbase_m: float, rng: np.random.Generator
) -> Motion:
    """Drive over a site.

    Parameters
    ----------
    site : Site
        The ground.
    config : DriveConfig
        How to drive.
    cruising_mps : float
        Cruising speed [m/s].
    wheelbase_m : float
        Distance of the axles, over which the grade is felt [m].
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    Motion
        Of one run.
    """
    west, south, east, north = site.bounds
    legs = int(4.0 * config.length_m / config.leg_m[0]) + 10
    low = np.array([west, south]) + config.margin_m
    high = np.array([east, north]) - config.margin_m
    points = _waypoints(low, high, config.leg_m, legs, rng)
    plan = np.column_stack(
        [
            points[1:],
            rng.uniform(*config.radius_m, legs),
            rng.uniform(0.0, config.weave_per_m, legs),
            2 * np.pi / rng.uniform(3.0, 8.0, legs),
            cruising_mps * rng.uniform(*config.speed_factor, legs),
            np.where(rng.random(legs) < config.reverse_share, -1.0, 1.0),
        ]
    )  # (legs, 7): x, y, radius, curvature of weaving, its wave number, speed, direction
    apart = 100.0 / config.stops_per_100m if config.stops_per_100m > 0 else np.inf
    stops = np.cumsum(rng.exponential(apart, 64)) if np.isfinite(apart) else np.full(64, np.inf)
    rows = _drive(
        plan,
        points[0],
        rng.uniform(0.0, 2 * np.pi),
        stops,
        rng.uniform(3.0, 8.0, 64),
        config.length_m,
        1.0 / config.rate_hz,
        config.acceleration_mps2,
    )
    x, y, heading, speed, driven, accel = rows.T
    t = np.arange(x.size) / config.rate_hz
    course = heading + np.where(speed < 0.0, np.pi, 0.0)
    east_m, north_m = np.sin(course), np.cos(course)
    half = 0.5 * wheelbase_m
    ahead = site.height_m(x + half * east_m, y + half * north_m)
    behind = site.height_m(x - half * east_m, y - half * north_m)
    side_x, side_y = SIDE_M * np.cos(heading), -SIDE_M * np.sin(heading)  # to the right of the body
    right, left = site.height_m(x + side_x, y + side_y), site.height_m(x - side_x, y - side_y)
    return Motion(
        t=t,
        x=x,
        y=y,
        z=site.height_m(x, y),
        heading_rad=np.mod(heading, 2 * np.pi),
        speed_mps=speed,
        yaw_rate=np.gradient(heading) * config.rate_hz,
        driven_m=driven,
        acceleration_mps2=accel,
        grade=(ahead - behind) / wheelbase_m,
        cross=(left - right) / (2.0 * SIDE_M),
    )


def _waypoints(
    low: FloatArray, high: FloatArray, leg_m: tuple[float, float], legs: int, rng: np.random.Generator
) -> FloatArray:
    """(legs + 1, 2) points in the box, each at a drawn distance from the one before."""
    points = np.empty((legs + 1, 2))
    points[0] = rng.uniform(low, high)
    for k in range(legs):
        for _ in range(100):
            distance, direction = rng.uniform(*leg_m), rng.uniform(0.0, 2 * np.pi)
            point = points[k] + distance * np.array([np.sin(direction), np.cos(direction)])
            if np.all(point >= low) and np.all(point <= high):
                break
        points[k + 1] = np.clip(point, low, high)
    return points


@njit(cache=True)
def _drive(
    plan: FloatArray,
    start: FloatArray,
    heading: float,
    stops_at: FloatArray,
    stop_s: FloatArray,
    length: float,
    dt: float,
    rate: float,
) -> FloatArray:
    """(n, 6): x, y, heading (not wrapped), signed speed, driven, acceleration of the magnitude."""
    most = int(8.0 * length / (plan[:, 5].min() * dt)) + 1000
    out = np.empty((most, 6))
    x, y = start
    leg, stop = 0, 0
    driven, waiting = 0.0, 0.0
    speed, accel = plan[0, 5], 0.0
    sign = plan[0, 6]
    n = 0
    while n < most and driven < length and leg < plan.shape[0]:
        dx, dy = plan[leg, 0] - x, plan[leg, 1] - y
        distance = np.hypot(dx, dy)
        if distance < max(0.8, 1.5 * plan[leg, 2]) and leg + 1 < plan.shape[0]:
            leg += 1
            continue
        target = plan[leg, 5]
        if sign != plan[leg, 6]:
            target = 0.0
            if speed == 0.0:
                sign = plan[leg, 6]
        if driven >= stops_at[stop]:
            target = 0.0
            if speed == 0.0:
                waiting += dt
                if waiting >= stop_s[stop]:
                    waiting = 0.0
                    stop += 1
        before = speed
        speed = min(target, speed + rate * dt) if target > speed else max(target, speed - rate * dt)
        accel = (speed - before) / dt
        aim = np.arctan2(dx, dy) + (np.pi if sign < 0.0 else 0.0)
        error = (aim - heading + np.pi) % (2 * np.pi) - np.pi
        limit = 1.0 / plan[leg, 2]
        curvature = plan[leg, 3] * np.sin(plan[leg, 4] * driven) + 0.8 * error
        curvature = min(max(curvature, -limit), limit)
        heading += curvature * speed * dt
        x += sign * speed * dt * np.sin(heading)
        y += sign * speed * dt * np.cos(heading)
        driven += speed * dt
        out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4], out[n, 5] = x, y, heading, sign * speed, driven, accel
        n += 1
    return out[:n]
