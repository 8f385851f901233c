"""Hidden forces: tyre scrub, air, speed, rotors, cold grease, side slip, soft ground, mud, furrows, payload."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from joulemap.model.field.conditions import Conditions
from joulemap.model.field.drives import STEP_M, Drive, smooth_noise
from joulemap.model.field.effects import Effect, Ride
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.sites import Site

FloatArray = NDArray[np.float64]

_AIR_KG_PER_M3 = 1.2
_FIRST_HOUR = 7.5  # tyres are pumped up in the morning


@dataclass(frozen=True)
class Turning(Effect):
    """Tyres scrub sideways in turns."""

    scrub: float  # The moment is scrub x load x half the wheelbase
    sliding_rad_s: float = 0.05  # Rate of turning at which the tyres slide and the moment is full [rad/s]
    name: ClassVar[str] = "turning"
    unit: ClassVar[str] = "J/rad"

    def wheels_w(self, ride: Ride, wheels_w: FloatArray) -> FloatArray:
        rate = np.abs(ride.turn_rate)
        moment = self.scrub * ride.motion.loads_n.sum(axis=1) * 0.5 * ride.robot.wheelbase_m
        return wheels_w + moment * np.tanh(rate / self.sliding_rad_s) * rate / ride.robot.gear_efficiency

    def amount(self, ride: Ride) -> FloatArray:
        return np.cumsum(np.abs(ride.turn_rate) * ride.duration_s)


@dataclass(frozen=True)
class AirDrag(Effect):
    """Drag of the air, by its speed relative to the moving robot.

    F = 0.5 rho c A |v| v_ahead, with rho = 1.2 kg/m3 and v the speed of the air relative to the robot.
    """

    drag_area_m2: float  # Drag coefficient times area [m2]
    name: ClassVar[str] = "wind"
    unit: ClassVar[str] = "J/m per (m/s)^2"

    def force_n(self, ride: Ride) -> FloatArray:
        return 0.5 * _AIR_KG_PER_M3 * self.drag_area_m2 * self._met(ride)

    def amount(self, ride: Ride) -> FloatArray:
        return ride.along_path(self._met(ride))

    @staticmethod
    def _met(ride: Ride) -> FloatArray:
        """Speed of the air against the robot times its part along the motion [m2/s2], > 0 from ahead."""
        wind, source = ride.conditions.wind.at(ride.clock_s)
        ahead = ride.drive.speed_mps + wind * np.cos(ride.drive.heading_rad - source)
        sideways = wind * np.sin(ride.drive.heading_rad - source)
        return np.hypot(ahead, sideways) * ahead


@dataclass(frozen=True)
class Payload(Effect):
    """The payload that the conditions state truly has mass, and raises the centre of mass."""

    name: ClassVar[str] = "payload"

    def on_robot(self, robot: FieldRobot, conditions: Conditions) -> FieldRobot:
        mass = robot.mass_kg + conditions.payload_kg
        deck = 2.2 * robot.com_height_m
        height = (robot.mass_kg * robot.com_height_m + conditions.payload_kg * deck) / mass
        return replace(robot, mass_kg=mass, com_height_m=height)

    def stated(self) -> float:
        return 1.0


@dataclass(frozen=True)
class Speed(Effect):
    """The driver keeps no constant speed, and a viscous loss grows with it."""

    viscous_s_per_m: float  # Viscous force over weight and speed [s/m]
    spread: float  # Standard deviation of the logarithm of the speed
    name: ClassVar[str] = "speed"
    unit: ClassVar[str] = "J/m per m/s"

    def on_drive(self, drive: Drive, conditions: Conditions) -> Drive:
        rng = np.random.default_rng([conditions.seed, 1])
        factor = self.spread * (0.6 * rng.standard_normal() + 0.8 * smooth_noise(rng, drive.x.size, 4.0 / STEP_M))
        return replace(drive, speed_mps=drive.speed_mps * np.exp(np.clip(factor, -0.7, 0.7)))

    def force_n(self, ride: Ride) -> FloatArray:
        return self.viscous_s_per_m * ride.weight_n * ride.drive.speed_mps

    def amount(self, ride: Ride) -> FloatArray:
        return ride.along_path(ride.drive.speed_mps)


@dataclass(frozen=True)
class Acceleration(Effect):
    """Stop-and-go every few metres, with rotors behind the gears that must be accelerated.

    The gears are self-locking: the energy of the rotors is lost when they slow down.
    """

    rotors_kg: float  # Inertia of the rotors, as a mass at the ground [kg]
    every_m: float = 5.0  # Mean distance between two slow places [m]
    name: ClassVar[str] = "acceleration"
    unit: ClassVar[str] = "kg"

    def on_drive(self, drive: Drive, conditions: Conditions) -> Drive:
        rng = np.random.default_rng([conditions.seed, 2])
        at = np.arange(drive.x.size) * STEP_M
        halts = np.cumsum(rng.uniform(0.5, 1.5, max(int(at[-1] / self.every_m), 1)) * self.every_m)
        near = np.abs(at[:, None] - halts[None, :]).min(axis=1)
        return replace(drive, speed_mps=drive.speed_mps * (1.0 - 0.75 * np.exp(-0.5 * (near / 0.5) ** 2)))

    def force_n(self, ride: Ride) -> FloatArray:
        step = np.maximum(np.diff(ride.path_m, prepend=ride.path_m[0]), 1e-6)
        return self.rotors_kg * self._spun_up(ride) / step

    def amount(self, ride: Ride) -> FloatArray:
        return np.cumsum(self._spun_up(ride))

    @staticmethod
    def _spun_up(ride: Ride) -> FloatArray:
        """Half the square of the speed, gained over each step [m2/s2]."""
        return np.maximum(0.5 * np.diff(ride.drive.speed_mps**2, prepend=ride.drive.speed_mps[0] ** 2), 0.0)


@dataclass(frozen=True)
class ColdGrease(Effect):
    """Grease that stiffens in the cold, exponentially.

    F / weight = share (exp((warm_c - T) / scale_k) - 1) / (exp(warm_c / scale_k) - 1), negative above `warm_c`.
    """

    share: float  # Drag over weight at 0 degC
    warm_c: float = 20.0  # Temperature at which there is no drag [degC]
    scale_k: float = 18.0  # The drag grows by a factor e over this many kelvin
    name: ClassVar[str] = "temperature"
    unit: ClassVar[str] = "J/m/K"

    def force_n(self, ride: Ride) -> FloatArray:
        stiff = np.expm1((self.warm_c - ride.conditions.temperature_c(ride.clock_s)) / self.scale_k)
        return self.share * ride.weight_n * stiff / math.expm1(self.warm_c / self.scale_k)

    def amount(self, ride: Ride) -> FloatArray:
        return ride.along_path(ride.conditions.temperature_c(ride.clock_s) - self.warm_c)


@dataclass(frozen=True)
class SideSlip(Effect):
    """Wet ground on which tyres slip sideways across a slope.

    F = weight |sin(roll)| slip, with slip = |sin(roll)| / grip, at most 0.8.
    """

    grip: float  # Side force over weight and slip
    name: ClassVar[str] = "cross_slope"
    unit: ClassVar[str] = "J/m per squared sine"

    def force_n(self, ride: Ride) -> FloatArray:
        side = np.abs(np.sin(ride.motion.roll_rad))
        return ride.weight_n * side * np.minimum(side / self.grip, 0.8)

    def amount(self, ride: Ride) -> FloatArray:
        return ride.along_path(np.sin(ride.motion.roll_rad) ** 2)


@dataclass(frozen=True)
class SoftClass(Effect):
    """A larger rolling loss on one kind of ground."""

    word: str  # What the operator calls that ground
    factor: float  # Factor on the rolling loss there
    name: ClassVar[str] = "terrain_class"

    def stated(self) -> float:
        return self.factor

    def on_site(self, site: Site) -> Site:
        x, y = site.mu_factor.frame.centres()
        soft = site.words_at(*np.meshgrid(x, y)) == self.word
        return site.with_rolling_loss(np.where(soft, self.factor, 1.0))


@dataclass(frozen=True)
class WetPatch(Effect):
    """A larger rolling loss in one soft spot."""

    factor: float  # Factor on the rolling loss in the middle
    radius_m: float  # Distance from the middle at which the factor fades [m]
    east: float  # Place of the middle, 0 to 1 over the width and height of the site
    north: float
    name: ClassVar[str] = "local_friction"

    def stated(self) -> float:
        return self.factor

    def on_site(self, site: Site) -> Site:
        west, south, east, north = site.terrain.frame.bounds
        x, y = np.meshgrid(*site.mu_factor.frame.centres())
        away = np.hypot(x - west - self.east * (east - west), y - south - self.north * (north - south))
        return site.with_rolling_loss(1.0 + (self.factor - 1.0) * np.exp(-0.5 * (away / self.radius_m) ** 4))


@dataclass(frozen=True)
class Drift(Effect):
    """Mud that gathers with the distance, or tyres that lose air over the hours: a growing drag."""

    share_per_unit: float  # Growth of the drag over the load, per kilometre or per hour
    over: Literal["km", "h"] = "km"  # km or h
    name: ClassVar[str] = "drift"

    def __post_init__(self) -> None:
        object.__setattr__(self, "unit", f"J/m/{self.over}")

    def force_n(self, ride: Ride) -> FloatArray:
        return self.share_per_unit * ride.motion.loads_n.sum(axis=1) * self._age(ride)

    def amount(self, ride: Ride) -> FloatArray:
        return ride.along_path(self._age(ride))

    def _age(self, ride: Ride) -> FloatArray:
        if self.over == "km":
            return (ride.conditions.driven_m + ride.path_m) / 1000.0
        return np.maximum(((ride.conditions.start_s + ride.clock_s) % 86400.0) / 3600.0 - _FIRST_HOUR, 0.0)


@dataclass(frozen=True)
class Furrows(Effect):
    """Ploughed ground: driving across the furrows takes energy, driving along them takes none."""

    share: float  # Drag over load when driving across
    along_rad: float  # Heading of the furrows [rad]
    name: ClassVar[str] = "learned:heading"
    unit: ClassVar[str] = "J/m across"

    def force_n(self, ride: Ride) -> FloatArray:
        across = np.sin(ride.drive.heading_rad - self.along_rad) ** 2
        return self.share * ride.motion.loads_n.sum(axis=1) * across

    def amount(self, ride: Ride) -> FloatArray:
        return ride.along_path(np.sin(ride.drive.heading_rad - self.along_rad) ** 2)
