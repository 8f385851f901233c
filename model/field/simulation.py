"""Simulate a drive over a site: the power along the path, and the true energy of its segments of 1 m."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.field.conditions import Conditions, Halts
from joulemap.model.field.drives import Drive
from joulemap.model.field.effects import Effect, Ride
from joulemap.model.field.electrics import wheel_power_w
from joulemap.model.field.robot_dynamics import move
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.sites import Site
from joulemap.model.frames import heading_of

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """What truly happened, one entry per station."""

    t: FloatArray  # (n,): Time since the start [s]
    x: FloatArray  # (n,): World positions [m]
    y: FloatArray
    z: FloatArray  # (n,): Height of the ground under the body [m]
    heading_rad: FloatArray  # (n,): Headings [rad]
    speed_mps: FloatArray  # (n,): Speeds [m/s]
    pitch_rad: FloatArray  # (n,): Pitch, > 0 nose up [rad]
    roll_rad: FloatArray  # (n,): Roll, > 0 right side down [rad]
    power_w: FloatArray  # (n,): Power at the battery [W]
    explained_w: FloatArray  # (n,): The same without the spread that does not follow from any height [W]
    wheels_w: FloatArray  # (n,): The part of `power_w` that both drives take [W]
    standing_w: float  # Power during a halt [W]

    def energy_j(self, power_w: FloatArray | None = None) -> FloatArray:
        """Return the energy since the start; the power of a station holds over the step that ends there.

        `power_w` (n,): another power than that at the battery [W]. Result (n,): energy [J].
        """
        power = self.power_w if power_w is None else power_w
        return np.cumsum(power * np.diff(self.t, prepend=self.t[0]))


@dataclass(frozen=True)
class TrueSegments:
    """Consecutive segments of 1 m of a trace, without any error of measurement."""

    x: FloatArray  # (n,): World position of the centre [m]
    y: FloatArray
    heading_rad: FloatArray  # (n,): Heading from p to q [rad]
    energy_j: FloatArray  # (n,): Energy drawn from the battery [J]
    explained_j: FloatArray  # (n,): The same without the spread that does not follow from any height [J]
    duration_s: FloatArray  # (n,): Duration [s]
    driven_m: FloatArray  # (n,): Horizontal length of the path [m]
    heading_change_rad: FloatArray  # (n,): Net turn, > 0 to the right [rad]

    def __len__(self) -> int:
        return int(self.x.size)


def simulate_trace(
    site: Site,
    robot: FieldRobot,
    drive: Drive,
    *,
    rng: np.random.Generator,
    effects: Sequence[Effect] = (),
    conditions: Conditions | None = None,
) -> Trace:
    """Drive over the true terrain of a site, with hidden effects if there are any.

    Result: what truly happened, without halts.
    """
    ride, wheels = take_ride(site, robot, drive, effects=effects, conditions=conditions)
    _, explained = take_ride(
        replace(site, mu_factor=site.mu_factor_explained), robot, drive, effects=effects, conditions=conditions
    )
    factor = _spread(ride.path_m, site.ground.spread, site.ground.spread_length_m, rng)
    power, wheels = _battery_w(ride, factor * wheels, effects)
    return Trace(
        t=ride.t,
        x=ride.drive.x,
        y=ride.drive.y,
        z=ride.motion.z,
        heading_rad=ride.drive.heading_rad,
        speed_mps=ride.drive.speed_mps,
        pitch_rad=ride.motion.pitch_rad,
        roll_rad=ride.motion.roll_rad,
        power_w=power,
        explained_w=_battery_w(ride, explained, effects)[0],
        wheels_w=wheels,
        standing_w=reduce(lambda power, effect: effect.standing_w(power), effects, robot.idle_w),
    )


def take_ride(
    site: Site,
    robot: FieldRobot,
    drive: Drive,
    *,
    effects: Sequence[Effect] = (),
    conditions: Conditions | None = None,
) -> tuple[Ride, FloatArray]:
    """Drive, and return the power of both drives before the losses that an effect adds to it.

    Returns `ride`: the drive in progress; `wheels_w` (n,): power of both drives [W].
    """
    conditions = conditions or Conditions()
    for effect in effects:
        site = effect.on_site(site)
        robot = effect.on_robot(robot, conditions)
        drive = effect.on_drive(drive, conditions)
    motion = move(
        site.terrain,
        site.mu_factor,
        site.ground,
        robot,
        x=drive.x,
        y=drive.y,
        heading_rad=drive.heading_rad,
        speed_mps=drive.speed_mps,
    )
    surface = np.sqrt(np.diff(drive.x) ** 2 + np.diff(drive.y) ** 2 + np.diff(motion.z) ** 2)
    t = np.concatenate([[0.0], np.cumsum(surface / drive.speed_mps[1:])])
    ride = Ride(drive, motion, robot, conditions, t, np.concatenate([[0.0], np.cumsum(surface)]))
    if effects:
        half = 0.5 * np.sum([np.broadcast_to(effect.force_n(ride), t.shape) for effect in effects], axis=0)
        motion = replace(motion, force_left_n=motion.force_left_n + half, force_right_n=motion.force_right_n + half)
    return ride, wheel_power_w(motion, robot, drive.speed_mps, drive.curvature)


def simulate_segments(
    site: Site, robot: FieldRobot, drive: Drive, *, rng: np.random.Generator, max_driven_m: float = 1.05
) -> TrueSegments:
    """Simulate a drive and return its true segments: many exact ones quickly, without a logger."""
    return true_segments(simulate_trace(site, robot, drive, rng=rng), max_driven_m=max_driven_m)


def with_halts(trace: Trace, halts: Halts) -> Trace:
    """Return the same drive with halts, each of which adds a station."""
    after, waited = halts.stations, halts.waited_s(trace.t.size + 1)
    columns = {}
    for item in fields(Trace):
        values = getattr(trace, item.name)
        if item.name == "standing_w":
            columns[item.name] = values
            continue
        halted = values[after]
        if item.name == "t":
            values = values + waited[:-1]
            halted = trace.t[after] + waited[after + 1]
        elif item.name == "speed_mps" or item.name == "wheels_w":
            halted = np.zeros(after.size)
        elif item.name in ("power_w", "explained_w"):
            halted = np.full(after.size, trace.standing_w)
        columns[item.name] = np.insert(values, after + 1, halted)
    return Trace(**columns)


def segment_gains(trace: Trace, *cumulated: FloatArray, length_m: float = 1.0) -> list[FloatArray]:
    """Return how much cumulated quantities grow over consecutive segments.

    `*cumulated` (n,): quantities cumulated along the path.
    """
    at = _cut(trace.x, trace.y, length_m)  # fractional station of every end
    station = np.arange(trace.x.size, dtype=np.float64)
    return [np.diff(np.interp(at, station, values)) for values in cumulated]


def true_segments(trace: Trace, *, length_m: float = 1.0, max_driven_m: float = 1.05) -> TrueSegments:
    """Cut a trace into consecutive segments whose ends have a given horizontal distance."""
    if length_m <= 0:
        raise InputError(f"the length of a segment must be positive, got {length_m} m", length_m=length_m)
    at = _cut(trace.x, trace.y, length_m)
    station = np.arange(trace.x.size, dtype=np.float64)
    x, y = np.interp(at, station, trace.x), np.interp(at, station, trace.y)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(trace.x), np.diff(trace.y)))])
    energy, explained, duration, driven, turned = segment_gains(
        trace,
        trace.energy_j(),
        trace.energy_j(trace.explained_w),
        trace.t,
        path,
        np.unwrap(trace.heading_rad),
        length_m=length_m,
    )
    heading = heading_of(np.diff(x), np.diff(y))
    columns = ((x[:-1] + x[1:]) / 2, (y[:-1] + y[1:]) / 2, heading, energy, explained, duration, driven, turned)
    keep = driven <= max_driven_m * length_m
    return TrueSegments(*(np.ascontiguousarray(c[keep]) for c in columns))


def _battery_w(ride: Ride, wheels_w: FloatArray, effects: Sequence[Effect]) -> tuple[FloatArray, FloatArray]:
    """Power at the battery and of the drives [W], (n,) each, after all effects."""
    for effect in effects:
        wheels_w = effect.wheels_w(ride, wheels_w)
    power = ride.robot.idle_w + wheels_w
    for effect in effects:
        power = effect.power_w(ride, power)
    return power, wheels_w


def _spread(path_m: FloatArray, sigma: float, length_m: float, rng: np.random.Generator) -> FloatArray:
    """Log-normal factor of mean 1 along a path, correlation exp(-distance / length_m). Shape (n,)."""
    shock = rng.standard_normal(path_m.size)
    if sigma == 0.0:
        return np.ones(path_m.size)
    decay = np.exp(-np.diff(path_m, prepend=path_m[0]) / length_m)
    return np.exp(sigma * _walk(shock, decay) - 0.5 * sigma**2)


@njit(cache=True)
def _walk(shock: FloatArray, decay: FloatArray) -> FloatArray:
    out = np.empty(shock.size)
    out[0] = shock[0]
    for k in range(1, shock.size):
        out[k] = decay[k] * out[k - 1] + math.sqrt(1.0 - decay[k] ** 2) * shock[k]
    return out


@njit(cache=True)
def _cut(x: FloatArray, y: FloatArray, length: float) -> FloatArray:
    """Fractional stations of consecutive points at a straight distance of `length`, from station 0."""
    out = np.empty(x.size)
    out[0] = 0.0
    count = 1
    px = x[0]
    py = y[0]
    before = 0.0
    k = 1
    while k < x.size:
        far = math.hypot(x[k] - px, y[k] - py)
        if far >= length:
            f = (length - before) / (far - before)
            px = x[k - 1] + f * (x[k] - x[k - 1])
            py = y[k - 1] + f * (y[k] - y[k - 1])
            out[count] = k - 1 + f
            count += 1
            before = -1.0
            far = math.hypot(x[k] - px, y[k] - py)
        before = far
        k += 1
    return out[:count].copy()
