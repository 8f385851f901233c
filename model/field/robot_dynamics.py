"""The simulated robot: a four-wheel skid-steer on compliant wheels, driven quasi-statically over the true terrain.

Everything here follows from mechanics, station by station (2.5 cm) along the driven path:

- *Pose.* A wheel of radius R rests on the terrain: its centre is the highest circle that touches the ground anywhere
  on its contact arc. Four equal springs under a rigid chassis determine mean height, pitch and roll. What a plane
  cannot follow (the twist) moves load between the diagonals.
- *Load of a wheel* from the components of gravity in the body's frame, the height of the centre of mass, and twist.
- *Force to move:* rise of the centre of mass, rolling loss of each wheel (grows a little faster than its load), energy
  lost when a wheel climbs relative to the chassis and drops again, side slip on a cross slope, scrubbing of the
  tyres in turns, inertia.
- *Drivetrain* per side: gear efficiency, constant friction, copper loss with the square of the force; a side that is
  pushed gives back only the robot's regenerated share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import PointError
from joulemap.model.field.robots import FieldRobot, Ground
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap, bilinear

FloatArray = NDArray[np.float64]

_ARC = 9  # points of a wheel's contact arc
_EPS = 1e-12


@dataclass(frozen=True)
class Motion:
    """What driving a path requires of the robot; every array has one entry per station."""

    z: FloatArray  # (n,): Height of the body above the datum, at the level of the wheels' contact [m]
    pitch_rad: FloatArray  # (n,): Pitch, > 0 nose up [rad]
    roll_rad: FloatArray  # (n,): Roll, > 0 right side down [rad]
    force_left_n: FloatArray  # (n,): Force of the wheels of each side [N]
    force_right_n: FloatArray
    loads_n: FloatArray  # (n, 4): Load of the wheels: front left, front right, rear left, rear right [N]


def move(
    terrain: Heightmap,
    mu_factor: Heightmap,
    ground: Ground,
    robot: FieldRobot,
    *,
    x: FloatArray,
    y: FloatArray,
    heading_rad: FloatArray,
    speed_mps: FloatArray,
) -> Motion:
    """Drive over the stations of a path, quasi-statically.

    `x`, `y` (n,): world positions [m]; `heading_rad` (n,); `speed_mps` (n,): speeds [m/s].
    """
    z, pitch, roll, left, right, loads = _move(
        terrain.heights,
        *_grid(terrain.frame),
        mu_factor.heights,
        *_grid(mu_factor.frame),
        np.ascontiguousarray(x),
        np.ascontiguousarray(y),
        np.ascontiguousarray(heading_rad),
        np.ascontiguousarray(speed_mps),
        robot.kernel_parameters(),
        ground.kernel_parameters(),
    )
    bad = np.flatnonzero(~np.isfinite(left + right))
    if bad.size:
        k = int(bad[0])
        raise PointError(f"the simulated robot leaves the known terrain at ({x[k]:.2f}, {y[k]:.2f})", x=x[k], y=y[k])
    return Motion(z=z, pitch_rad=pitch, roll_rad=roll, force_left_n=left, force_right_n=right, loads_n=loads)


def _grid(frame: GridFrame) -> tuple[float, float, float]:
    return float(frame.west_m), float(frame.north_m), float(frame.resolution_m)


@njit(cache=True)
def _height(values: NDArray[np.float32], west: float, north: float, res: float, x: float, y: float) -> float:
    return bilinear(values, (north - y) / res - 0.5, (x - west) / res - 0.5)


@njit(cache=True)
def _wheel(
    values: NDArray[np.float32],
    west: float,
    north: float,
    res: float,
    x: float,
    y: float,
    sx: float,
    cy: float,
    radius: float,
    width: float,
) -> float:
    """Height of the lowest point of a wheel that rests on the terrain: max over the arc of ground + circle, minus R.

    Across its width the tyre bears on the mean of three lines (edges a quarter each, middle a half).
    """
    best = -math.inf
    for k in range(_ARC):
        along = radius * math.sin(0.5 * math.pi * (2.0 * k / (_ARC - 1) - 1.0) * 0.8)
        px = x + along * sx
        py = y + along * cy
        ground = 0.5 * _height(values, west, north, res, px, py)
        ground += 0.25 * _height(values, west, north, res, px + 0.5 * width * cy, py - 0.5 * width * sx)
        ground += 0.25 * _height(values, west, north, res, px - 0.5 * width * cy, py + 0.5 * width * sx)
        if math.isnan(ground):
            return math.nan
        best = max(best, ground + math.sqrt(radius * radius - along * along))
    return best - radius


@njit(cache=True)
def _move(
    terrain: NDArray[np.float32],
    west: float,
    north: float,
    res: float,
    mu_factor: NDArray[np.float32],
    mu_west: float,
    mu_north: float,
    mu_res: float,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    robot: FloatArray,
    ground: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    weight, mass, base, track, width, radius, com, twist_k, factor, grip, lag, _, _, _, _ = robot
    mu, exponent, bump_loss, bump_speed, scrub, scrub_curvature = ground
    n = x.size
    z = np.empty(n)
    pitches = np.empty(n)
    rolls = np.empty(n)
    left = np.empty(n)
    right = np.empty(n)
    loads = np.empty((n, 4))
    wheel = np.empty(4)
    before = np.empty(4)
    pitch = 0.0
    roll = 0.0
    com_z_before = 0.0
    smooth_left = 0.0
    smooth_right = 0.0
    for k in range(n):
        sx = math.sin(heading[k])
        cy = math.cos(heading[k])
        for _again in range(6 if k == 0 else 1):
            half_base = 0.5 * base * math.cos(pitch)
            half_track = 0.5 * track * math.cos(roll)
            for i in range(4):
                ahead = half_base if i < 2 else -half_base
                sideways = -half_track if i % 2 == 0 else half_track
                wheel[i] = _wheel(
                    terrain,
                    west,
                    north,
                    res,
                    x[k] + ahead * sx + sideways * cy,
                    y[k] + ahead * cy - sideways * sx,
                    sx,
                    cy,
                    radius,
                    width,
                )
            mean = 0.25 * (wheel[0] + wheel[1] + wheel[2] + wheel[3])
            pitch = math.atan2(0.5 * (wheel[0] + wheel[1] - wheel[2] - wheel[3]), 2.0 * half_base)
            roll = math.atan2(0.5 * (wheel[0] + wheel[2] - wheel[1] - wheel[3]), 2.0 * half_track)
        z[k] = mean
        pitches[k] = pitch
        rolls[k] = roll
        twist = 0.25 * (wheel[0] - wheel[1] - wheel[2] + wheel[3])

        down = weight * math.cos(pitch) * math.cos(roll)
        back = weight * math.sin(pitch)
        side = weight * math.cos(pitch) * math.sin(roll)
        total = 0.0
        for i in range(4):
            load = 0.25 * down
            load += (-0.5 if i < 2 else 0.5) * back * com / base
            load += (-0.5 if i % 2 == 0 else 0.5) * side * com / track
            load += (1.0 if i == 0 or i == 3 else -1.0) * twist * twist_k
            loads[k, i] = max(load, 0.0)
            total += loads[k, i]
        for i in range(4):
            loads[k, i] *= down / max(total, _EPS)

        com_z = mean + com * math.cos(pitch) * math.cos(roll)
        j = max(k - 1, 0)
        step = math.hypot(x[k] - x[j], y[k] - y[j])
        surface = math.hypot(step, z[k] - z[j])
        if k == 0:
            com_z_before = com_z
        soil = mu * factor * _height(mu_factor, mu_west, mu_north, mu_res, x[k], y[k])
        slide = abs(math.sin(roll)) / grip
        force_left = 0.0
        force_right = 0.0
        for i in range(4):
            load = loads[k, i]
            drag = soil * load * (load / (0.25 * weight)) ** exponent
            if k > 0 and surface > _EPS:
                climb = (wheel[i] - before[i]) - (mean - z[j])
                if climb > 0.0:
                    drag += bump_loss * (1.0 + (speed[k] / bump_speed) ** 2) * load * climb / surface
            if i % 2 == 0:
                force_left += drag
            else:
                force_right += drag
            before[i] = wheel[i]
        if k > 0 and surface > _EPS:
            body = weight * (com_z - com_z_before) / surface
            body += abs(side) * math.sin(slide)
            body += mass * 0.5 * (speed[k] ** 2 - speed[j] ** 2) / surface
            turn = (heading[k] - heading[j] + math.pi) % (2.0 * math.pi) - math.pi
            curvature = turn / surface
            gripping = curvature * curvature / math.sqrt(curvature * curvature + scrub_curvature**2)
            moment = scrub * down * 0.5 * base * gripping / max(abs(curvature), _EPS)
            if turn < 0.0:
                moment = -moment
            force_left += 0.5 * body + moment / track
            force_right += 0.5 * body - moment / track
            share = 1.0 - math.exp(-surface / lag) if lag > 0.0 and k > 1 else 1.0
            smooth_left += share * (force_left - smooth_left)
            smooth_right += share * (force_right - smooth_right)
        else:
            smooth_left = force_left
            smooth_right = force_right
        com_z_before = com_z
        left[k] = smooth_left
        right[k] = smooth_right
    left[0] = left[min(1, n - 1)]
    right[0] = right[min(1, n - 1)]
    return z, pitches, rolls, left, right, loads
