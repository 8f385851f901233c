"""The true power of a drive, from textbook longitudinal dynamics. No formula here comes from the project.

Per horizontal metre the ground takes m g (c + tan theta): the surface is 1 / cos theta longer, the rolling resistance
c m g cos theta and the pull of the hill m g sin theta (e.g. Wong, Theory of Ground Vehicles, section 3.1). Speeding up
takes m a. A drivetrain of constant efficiency carries power to the ground; braking returns a share or nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tests.loop.generators.drive import Motion
from tests.loop.generators.effect import HiddenEffect, Scene
from tests.loop.generators.robots import G_MPS2, TrueRobot

FloatArray = NDArray[np.float64]


def resistance_n(motion: Motion, robot: TrueRobot, *, inertia: bool) -> FloatArray:
    """Force against the motion without any hidden effect, per horizontal metre [N], (n,)."""
    pull = robot.mass_kg * G_MPS2 * (robot.rolling_resistance + motion.grade)
    return pull + robot.mass_kg * motion.acceleration_mps2 if inertia else pull


def battery_power_w(
    force_n: FloatArray, speed_mps: FloatArray, robot: TrueRobot, *, slip: FloatArray | float = 0.0
) -> FloatArray:
    """Power from the battery [W], (n,): idle, and what moves the robot, or comes back from it.

    Parameters
    ----------
    force_n : ndarray of float, (n,)
        Against the motion [N].
    speed_mps : ndarray of float, (n,)
        Magnitude of the horizontal speed.
    robot : TrueRobot
        Efficiency, regeneration and idle power.
    slip : ndarray of float or float
        Share of the wheels' way that is lost: the wheels turn by 1 / (1 - slip) more.

    Returns
    -------
    ndarray of float, (n,)
        Power.
    """
    ground = force_n * speed_mps
    drives = np.maximum(ground, 0.0) / (1.0 - np.asarray(slip)) / robot.efficiency
    brakes = robot.regeneration * np.minimum(ground, 0.0)
    return robot.idle_power_w + drives + brakes


def true_power_w(scene: Scene, effects: Sequence[HiddenEffect], *, inertia: bool = True) -> FloatArray:
    """Power that a meter without fault gives [W], (n,), without unexplained variation."""
    motion, robot = scene.motion, scene.robot
    force = resistance_n(motion, robot, inertia=inertia)
    lost = np.zeros(len(motion))
    for effect in effects:
        force = force + effect.force_n(scene)
        lost = lost + effect.slip(scene)
    power = battery_power_w(force, motion.rolling_mps, robot, slip=lost)
    moving = np.where(motion.rolling_mps > 0.0, force, 0.0)
    for effect in effects:
        power = power + effect.load_w(scene, moving)
    for effect in effects:
        power = effect.limited_w(scene, power)
    return power
