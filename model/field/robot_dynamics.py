"""The simulated robot: a four-wheel skid-steer on compliant wheels, driven quasi-statically over the true terrain.

Everything here follows from mechanics, station by station (2.5 cm) along the driven path:

- *Pose.* A wheel of radius R rests on the terrain: its centre is the highest circle that touches the ground anywhere
  on its contact arc. Four equal springs under a rigid chassis give mean height, pitch and roll; what a plane cannot
  follow (the twist) shifts load between the diagonals.
- *Load of a wheel* from the components of gravity in the body's frame, the height of the centre of mass, and twist.
- *Force to move:* rise of the centre of mass, rolling loss of each wheel (grows a little faster than its load), energy
  lost when a wheel climbs relative to the chassis and drops again, side slip on a cross slope, scrubbing of the
  tyres in turns, inertia.
- *Drivetrain* per side: gear efficiency, constant friction, copper loss with the square of the force; a side that is
  pushed gives back only the robot's regenerated share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from model.errors import PointError, RobotError
from model.frames import GridFrame
from model.robot import GRAVITY_MPS2, Robot
from model.terrain.heightmap import Heightmap, bilinear

FloatArray = NDArray[np.float64]

_ARC = 9  # points of a wheel's contact arc
_EPS = 1e-12


@dataclass(frozen=True)
class FieldRobot:
    """The robot as it truly is: what the owner declares, and what nobody measured.

    declared : what the owner's file says. mass_kg : true mass. wheelbase_m, track_m : between wheel centres.
    wheel_width_m : of the contact. com_height_m : above the ground. twist_n_per_m : load moved to a wheel per metre of
    twist. friction_factor : true rolling loss of this robot's tyres over the ground's own. gear_efficiency : 0..1.
    drag_n : constant friction of the drivetrain [N at the ground, both sides together]. copper_w_per_n2 : copper loss
    per squared force of a side [W/N2]. idle_w : electronics. lateral_grip : side force of the tyres per radian of slip
    and newton of load. lag_m : distance over which wheels, chassis and speed controller even the force out.
    """

    declared: Robot
    mass_kg: float
    wheelbase_m: float
    track_m: float
    wheel_width_m: float
    com_height_m: float
    twist_n_per_m: float
    friction_factor: float = 1.0
    gear_efficiency: float = 0.8
    drag_n: float = 4.0
    copper_w_per_n2: float = 0.0008
    idle_w: float = 12.0
    lateral_grip: float = 5.0
    lag_m: float = 0.12
    regeneration: float = 0.0

    def __post_init__(self) -> None:
        for key in ("mass_kg", "wheelbase_m", "track_m", "lateral_grip", "gear_efficiency"):
            value = getattr(self, key)
            if not (math.isfinite(value) and value > 0):
                raise RobotError(f"simulated robot: {key} must be a positive number, got {value}", key=key)
        if self.gear_efficiency > 1.0:
            raise RobotError(
                f"simulated robot: gear_efficiency {self.gear_efficiency} is above 1", key="gear_efficiency"
            )

    @classmethod
    def nominal(cls, declared: Robot) -> FieldRobot:
        """The middle of what `drawn` draws: no surprise in the hidden parameters."""
        weight = declared.weight_n
        return cls(
            declared=declared,
            mass_kg=declared.mass_kg,
            wheelbase_m=0.64 * declared.length_m,
            track_m=0.80 * declared.width_m,
            wheel_width_m=0.15 * declared.width_m,
            com_height_m=declared.wheel_radius_m + 0.10 * declared.length_m,
            twist_n_per_m=5.0 * weight,
            drag_n=0.010 * weight,
            copper_w_per_n2=1.4 * declared.speed_mps / weight,
            idle_w=declared.idle_power_w,
            regeneration=declared.regeneration,
        )

    @classmethod
    def drawn(cls, declared: Robot, rng: np.random.Generator) -> FieldRobot:
        """A robot whose hidden parameters are drawn around `nominal`."""
        base = cls.nominal(declared)

        def spread(value: float, share: float) -> float:
            return float(value * math.exp(share * rng.standard_normal()))

        return replace(
            base,
            mass_kg=spread(base.mass_kg, 0.02),
            wheelbase_m=spread(base.wheelbase_m, 0.06),
            track_m=spread(base.track_m, 0.04),
            wheel_width_m=spread(base.wheel_width_m, 0.2),
            com_height_m=spread(base.com_height_m, 0.15),
            twist_n_per_m=spread(base.twist_n_per_m, 0.4),
            friction_factor=spread(1.0, 0.10),
            gear_efficiency=float(np.clip(base.gear_efficiency + 0.05 * rng.standard_normal(), 0.6, 0.95)),
            drag_n=spread(base.drag_n, 0.3),
            copper_w_per_n2=spread(base.copper_w_per_n2, 0.3),
            idle_w=spread(base.idle_w, 0.04),
            lateral_grip=spread(base.lateral_grip, 0.25),
            lag_m=spread(base.lag_m, 0.2),
        )

    @classmethod
    def random(cls, rng: np.random.Generator) -> FieldRobot:
        """Another robot altogether, about 12 to 130 kg, for pre-training; its hidden parameters are drawn too."""
        mass = float(np.clip(35.0 * math.exp(0.6 * rng.standard_normal()), 12.0, 130.0))
        size = (mass / 35.0) ** (1.0 / 3.0)
        length = 0.60 * size * math.exp(0.15 * rng.standard_normal())
        width = length * float(rng.uniform(0.7, 1.0))
        declared = Robot(
            name="simulated",
            mass_kg=mass,
            length_m=length,
            width_m=width,
            wheel_radius_m=length * float(rng.uniform(0.15, 0.27)),
            speed_mps=float(rng.uniform(0.3, 1.0)),
            battery_wh=8.0 * mass,
            idle_power_w=float(rng.uniform(0.15, 0.5)) * mass,
        )
        return cls.drawn(declared, rng)

    def kernel_parameters(self) -> FloatArray:
        """The numbers the compiled kernels read, in their order. Shape (15,)."""
        return np.array(
            [
                self.mass_kg * GRAVITY_MPS2, self.mass_kg, self.wheelbase_m, self.track_m, self.wheel_width_m,
                self.declared.wheel_radius_m, self.com_height_m, self.twist_n_per_m, self.friction_factor,
                self.lateral_grip, self.lag_m, self.gear_efficiency, self.drag_n, self.copper_w_per_n2,
                self.regeneration,
            ]
        )  # fmt: skip


@dataclass(frozen=True)
class Ground:
    """What the ground is made of.

    mu : rolling loss over load, at a quarter of the robot's weight per wheel. load_exponent : how much faster than the
    load the loss grows. bump_loss : share of the lifted energy that a wheel loses when it climbs relative to the
    chassis and drops. bump_speed_mps : speed at which that loss has doubled. scrub : side friction of the tyres when
    turning. hollow_share : rolling loss added in hollows (softer, wetter), per 0.1 m of depth below the 3 m around.
    patchiness : spread of mu from place to place (about 6 m) that no height explains. spread : multiplicative spread
    of the power at the wheels, correlated over spread_length_m, that nothing explains. tussock_m : rms of the relief
    finer than a survey sees.
    """

    name: str = "grass"
    mu: float = 0.065
    load_exponent: float = 0.25
    bump_loss: float = 0.9
    bump_speed_mps: float = 1.0
    scrub: float = 0.12
    hollow_share: float = 0.30
    patchiness: float = 0.02
    spread: float = 0.12
    spread_length_m: float = 1.0
    tussock_m: float = 0.006

    def kernel_parameters(self) -> FloatArray:
        """The numbers the compiled kernels read, in their order. Shape (6,)."""
        return np.array([self.mu, self.load_exponent, self.bump_loss, self.bump_speed_mps, self.scrub, 0.4])


@dataclass(frozen=True)
class Motion:
    """What driving a path asks of the robot; every array has one entry per station.

    z : height of the body above the datum, at wheel-contact level [m]. pitch_rad > 0 nose up; roll_rad > 0 right side
    down. force_left_n, force_right_n : what each side's wheels must push with [N]. loads_n : (n, 4) front left, front
    right, rear left, rear right.
    """

    z: FloatArray
    pitch_rad: FloatArray
    roll_rad: FloatArray
    force_left_n: FloatArray
    force_right_n: FloatArray
    loads_n: FloatArray


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
    """Drive over stations (n,) of a path. Raises PointError where a wheel would leave the terrain."""
    z, pitch, roll, left, right, loads = _move(
        terrain.heights, *_grid(terrain.frame), mu_factor.heights, *_grid(mu_factor.frame),
        np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(heading_rad),
        np.ascontiguousarray(speed_mps), robot.kernel_parameters(), ground.kernel_parameters(),
    )  # fmt: skip
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
    values: NDArray[np.float32], west: float, north: float, res: float, x: float, y: float, sx: float, cy: float,
    radius: float, width: float,
) -> float:  # fmt: skip
    """Height of the lowest point of a wheel that stands on the terrain: max over the arc of ground + circle, minus R.

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
    terrain: NDArray[np.float32], west: float, north: float, res: float, mu_factor: NDArray[np.float32],
    mu_west: float, mu_north: float, mu_res: float, x: FloatArray, y: FloatArray, heading: FloatArray,
    speed: FloatArray, robot: FloatArray, ground: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
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
                aside = -half_track if i % 2 == 0 else half_track
                wheel[i] = _wheel(
                    terrain, west, north, res, x[k] + ahead * sx + aside * cy, y[k] + ahead * cy - aside * sx,
                    sx, cy, radius, width,
                )  # fmt: skip
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
