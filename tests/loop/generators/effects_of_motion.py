"""Effects that depend on how the robot moves: turning, speed, grade, force, direction of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.loop.generators.config import CaseConfig
from tests.loop.generators.effect import HiddenEffect, Scene
from tests.loop.generators.robots import G_MPS2, TrueRobot

FloatArray = NDArray[np.float64]

_SHARPEST = 0.4  # 1/m, curvature at which scrubbing tires begin to slide
_TURN = (r"turn", r"yaw", r"curvature", r"scrub")


class SlidingScrub(HiddenEffect):
    """Tires that are twisted on the ground: a torque that saturates in the curvature, M0 tanh(k / k0)."""

    kind = "sliding_scrub"
    right = _TURN
    why_none = "the torque saturates: no one value per radian"

    def load_w(self, scene: Scene, force_n: FloatArray) -> FloatArray:
        """Torque times yaw rate, through the drivetrain."""
        motion, robot = scene.motion, scene.robot
        speed = np.maximum(motion.rolling_mps, 1e-3)
        torque = 1.6 * self.size * robot.rolling_n * np.tanh(np.abs(motion.yaw_rate) / speed / _SHARPEST)  # x 1 m
        return torque * np.abs(motion.yaw_rate) / robot.efficiency


class YawDamping(HiddenEffect):
    """A torque that grows with the yaw rate, so a power with its square."""

    kind = "yaw_damping"
    right = _TURN
    why_none = "the energy per radian grows with the yaw rate"

    def load_w(self, scene: Scene, force_n: FloatArray) -> FloatArray:
        """Torque times yaw rate, through the drivetrain."""
        usual = 0.35 * scene.robot.speed_mps  # rad/s, the yaw rate of a gentle curve
        torque = 0.9 * self.size * scene.robot.rolling_n * np.abs(scene.motion.yaw_rate) / usual
        return torque * np.abs(scene.motion.yaw_rate) / scene.robot.efficiency


class EachRadian(HiddenEffect):
    """The same energy for every radian, whatever the radius."""

    kind = "each_radian"
    right = _TURN
    unit = "J/rad"

    def coefficients(self, robot: TrueRobot) -> tuple[float]:
        """Energy from the battery [J/rad]."""
        return (self.size * robot.rolling_n / robot.efficiency,)

    def load_w(self, scene: Scene, force_n: FloatArray) -> FloatArray:
        """Energy per radian times yaw rate."""
        return self.coefficients(scene.robot)[0] * np.abs(scene.motion.yaw_rate)


class FastDrag(HiddenEffect):
    """Resistance that grows with speed to the power of 1.5."""

    kind = "fast_drag"
    right = (r"(?<!wind_)(?<!wind )speed",)
    why_none = "the power of the speed is not that of a candidate"

    def force_n(self, scene: Scene) -> FloatArray:
        """k v^1.5."""
        share = (scene.motion.rolling_mps / scene.robot.speed_mps) ** 1.5
        return 0.5 * self.size * scene.robot.rolling_n * share

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """Drive at many speeds."""
        return replace(config, drive=replace(config.drive, speed_factor=(0.4, 1.3)))


class Washboard(HiddenEffect):
    """Ripples of the ground that shake the robot above a certain speed only."""

    kind = "washboard"
    right = (r"(?<!wind_)(?<!wind )speed",)
    why_none = "a step in the speed"

    def force_n(self, scene: Scene) -> FloatArray:
        """A smooth step in the speed."""
        begins = (0.75 + 0.2 * self.draw[0]) * scene.robot.speed_mps
        step = 1.0 / (1.0 + np.exp(-(scene.motion.rolling_mps - begins) / (0.04 * scene.robot.speed_mps)))
        return 0.35 * self.size * scene.robot.rolling_n * step

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """Drive at many speeds."""
        return replace(config, drive=replace(config.drive, speed_factor=(0.4, 1.3)))


class UphillSlip(HiddenEffect):
    """Wheels that slip with the pull: the motors do 1 / (1 - s) of the work."""

    kind = "uphill_slip"
    right = (r"slip", r"grade", r"climb", r"square", r"pitch", r"force")
    why_none = "the base parameters take up its linear part"

    def slip(self, scene: Scene) -> FloatArray:
        """Share of the wheels' way that is lost."""
        return np.clip(3.0 * self.size * np.maximum(scene.motion.grade, 0.0) ** 1.2, 0.0, 0.8)


class WindingHeat(HiddenEffect):
    """Heat in the windings of the motors: the square of the force."""

    kind = "winding_heat"
    right = (r"copper", r"square", r"resistance of the battery", r"battery", r"force", r"grade", r"climb", r"pitch")
    unit = "W at the robot's weight"

    def coefficients(self, robot: TrueRobot) -> tuple[float]:
        """Power at a force as large as the weight [W]."""
        return (0.25 * self.size * robot.speed_mps / robot.rolling_n * (robot.mass_kg * G_MPS2) ** 2,)

    def load_w(self, scene: Scene, force_n: FloatArray) -> FloatArray:
        """c (F / m g)^2."""
        return self.coefficients(scene.robot)[0] * (force_n / (scene.robot.mass_kg * G_MPS2)) ** 2


class PowerCeiling(HiddenEffect):
    """A supply that gives no more than a certain power, while a buffer that nobody measures gives the rest."""

    kind = "power_ceiling"
    right = (r"limit", r"ceiling", r"saturat", r"grade", r"climb", r"square", r"battery", r"pitch", r"force")
    why_none = "a limit, not a slope"

    def limited_w(self, scene: Scene, power_w: FloatArray) -> FloatArray:
        """The power, cut off."""
        robot = scene.robot
        usual = robot.idle_power_w + robot.rolling_n * robot.speed_mps / robot.efficiency
        return np.minimum(power_w, usual * (1.0 + 0.35 / max(self.size, 1e-6)))


class Crabbing(HiddenEffect):
    """Driving across a slope at an angle to the own body: resistance grows with the square of the cross slope."""

    kind = "crabbing"
    right = (r"cross", r"(^|[^a-z])roll($|[^a-z])", r"side")
    why_none = "quadratic in the cross slope"

    def force_n(self, scene: Scene) -> FloatArray:
        """Rolling resistance times (cross slope / c0)^2, limited."""
        share = np.minimum((scene.motion.cross / 0.08) ** 2, 4.0)
        return 0.35 * self.size * scene.robot.rolling_n * share


class LossyReverse(HiddenEffect):
    """Gears that lose more when the robot drives backwards."""

    kind = "lossy_reverse"
    right = (r"revers", r"backward", r"direction of travel")
    why_none = "a share of the motion's energy; candidates may state it per metre"

    def force_n(self, scene: Scene) -> FloatArray:
        """A share of the rolling resistance and of the climb."""
        motion, robot = scene.motion, scene.robot
        pull = robot.mass_kg * G_MPS2 * np.maximum(robot.rolling_resistance + motion.grade, 0.0)
        return 0.3 * self.size * np.where(motion.speed_mps < 0.0, pull, 0.0)

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """Drive a third of the legs backwards."""
        return replace(config, drive=replace(config.drive, reverse_share=0.33))


class Furrows(HiddenEffect):
    """Ploughed ground: 15 % more motion energy in a narrow band of headings, 30 deg wide, to one side."""

    kind = "furrows"
    right = (r"heading(?! change)", r"furrow", r"direction(?! of travel)")
    why_none = "a band of headings has no one coefficient"

    def force_n(self, scene: Scene) -> FloatArray:
        """A share of the pull within the band."""
        motion, robot = scene.motion, scene.robot
        away = (motion.course_rad - 2 * np.pi * self.draw[0] + np.pi) % (2 * np.pi) - np.pi
        pull = robot.mass_kg * G_MPS2 * np.maximum(robot.rolling_resistance + motion.grade, 0.0)
        idle = robot.efficiency * robot.idle_power_w / robot.speed_mps
        return 0.15 * self.size * np.where(np.abs(away) < np.radians(15.0), pull + idle, 0.0)


MOTION = (
    SlidingScrub,
    YawDamping,
    EachRadian,
    FastDrag,
    Washboard,
    UphillSlip,
    WindingHeat,
    PowerCeiling,
    Crabbing,
    LossyReverse,
    Furrows,
)
