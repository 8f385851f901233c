"""Effects of weather, load and equipment."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from joulemap.model.robot import Robot
from tests.loop.generators.config import CaseConfig
from tests.loop.generators.effect import HiddenEffect, Scene
from tests.loop.generators.robots import G_MPS2, TrueRobot

FloatArray = NDArray[np.float64]

AIR_KGPM3 = 1.225
"""Density of air at sea level and 15 degC. Source: ISO 2533, standard atmosphere."""


def _pressure_n(scene: Scene, area_m2: float) -> FloatArray:
    """Drag of the moving air minus that of still air [N], (n,): 1/2 rho c_d A |u| u, u along the course."""
    motion, conditions = scene.motion, scene.conditions
    along = conditions.wind_mps * np.cos(conditions.wind_from_rad - motion.course_rad)
    own = motion.rolling_mps
    return 0.5 * AIR_KGPM3 * area_m2 * (np.abs(own + along) * (own + along) - own**2)


class Breeze(HiddenEffect):
    """Air drag in a wind that the log has."""

    kind = "breeze"
    right: ClassVar[tuple[str, ...]] = (r"wind",)
    why_none = "depends on the relative speed that a candidate chooses"

    def force_n(self, scene: Scene) -> FloatArray:
        """Drag of the wind."""
        return _pressure_n(scene, self.area_m2(scene.robot))

    def area_m2(self, robot: TrueRobot) -> float:
        """c_d A [m^2] at which a wind of 5 m/s takes 0.4 of the rolling resistance."""
        return 0.4 * self.size * robot.rolling_n / (0.5 * AIR_KGPM3 * 25.0)

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """A windy day."""
        return replace(config, weather=replace(config.weather, wind_mps=(2.0, 7.0)))


class SteadyWind(Breeze):
    """Air drag in a wind that nobody measured and that blows from one side all day."""

    kind = "steady_wind"
    right = (r"wind", r"heading(?! change)", r"direction")
    transfers = False

    def force_n(self, scene: Scene) -> FloatArray:
        """Drag of a wind of 5 m/s."""
        if not scene.home:
            return 0.0 * scene.motion.t
        still = replace(scene.conditions, wind_mps=5.0, wind_from_rad=2 * np.pi * self.draw[0])
        return _pressure_n(replace(scene, conditions=still), self.area_m2(scene.robot))

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """The log lacks the wind."""
        return replace(config, weather=replace(config.weather, wind_logged=False))


_TEMPERATURE = r"(?<!motor_)(?<!motor )temperature"


class StiffGrease(HiddenEffect):
    """Grease whose viscosity follows Arrhenius' law in the temperature of the air."""

    kind = "stiff_grease"
    right = (_TEMPERATURE, r"cold")
    why_none = "exponential in the inverse of the temperature"
    between = True

    def force_n(self, scene: Scene) -> FloatArray:
        """0.25 of the rolling resistance at 0 degC, doubling every 12 K or so; activation energy 45 kJ/mol."""
        kelvin = scene.conditions.temperature_degc + 273.15
        viscosity = np.exp(45e3 / 8.314 * (1.0 / kelvin - 1.0 / 273.15))
        return 0.25 * self.size * scene.robot.rolling_n * viscosity

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """Runs of very different temperatures."""
        return replace(config, weather=replace(config.weather, new_degc=(-12.0, 15.0)))


class WarmGears(HiddenEffect):
    """Gears that resist less as they warm up, slowly after the start of each run."""

    kind = "warm_gears"
    right = (r"motor.temperature", r"since", r"start", r"drift", r"(^|[^a-z])time")
    why_none = "exponential in the temperature of the motor"

    def force_n(self, scene: Scene) -> FloatArray:
        """Half of the rolling resistance when cold, falling with the motor's own warming."""
        warmer = scene.conditions.motor_degc - scene.conditions.temperature_degc
        return 0.5 * self.size * scene.robot.rolling_n * np.exp(-warmer / 8.0)


class Cargo(HiddenEffect):
    """A load that changes from run to run and is logged, in kg."""

    kind = "cargo"
    right = (r"payload",)
    unit = "kg/kg"
    between = True

    def coefficients(self, robot: TrueRobot) -> tuple[float]:
        """Mass per logged mass."""
        return (1.0,)

    def stated(self, robot: TrueRobot, declared: Robot) -> tuple[float]:
        """In kilograms of the declared mass: no energy tells that mass from the true one."""
        return (declared.mass_kg / robot.mass_kg,)

    def force_n(self, scene: Scene) -> FloatArray:
        """Rolling resistance and climb of the load."""
        motion = scene.motion
        return scene.conditions.payload_kg * G_MPS2 * (scene.robot.rolling_resistance + motion.grade)

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """New runs carry from nothing to 35 % of the robot's mass."""
        return replace(config, weather=replace(config.weather, cargo_share=0.35 * self.size))


class SoftTires(HiddenEffect):
    """Tires that lose air from hour to hour on the day of the new runs."""

    kind = "soft_tires"
    right = (r"drift", r"clock", r"odometer", r"(^|[^a-z])time", r"hour", r"since the first")
    why_none = "a share of the rolling resistance; candidates may state it per metre"
    transfers = False
    between = True

    def force_n(self, scene: Scene) -> FloatArray | float:
        """Rolling resistance that grows by 18 % an hour."""
        hours = (scene.conditions.clock_s + scene.motion.t) / 3600.0
        return 0.18 * self.size * scene.robot.rolling_n * hours


class Heater(HiddenEffect):
    """A thermostat's heater; the log has a column of 0 and 1 named `aux_2`."""

    kind = "heater"
    right = (r"aux_2",)
    unit = "W"
    either_sign = True  # on against off, or off against on
    switch = True

    def coefficients(self, robot: TrueRobot) -> tuple[float]:
        """Power [W]."""
        return (0.4 * self.size * (robot.idle_power_w + robot.rolling_n * robot.speed_mps / robot.efficiency),)

    def load_w(self, scene: Scene, force_n: FloatArray) -> FloatArray:
        """Power while it is on."""
        return self.coefficients(scene.robot)[0] * scene.conditions.heater


CONDITIONS = (Breeze, SteadyWind, StiffGrease, WarmGears, Cargo, SoftTires, Heater)
