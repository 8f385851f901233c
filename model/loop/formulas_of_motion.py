"""Formulas of effects of the motion itself: turning, speed, slopes, and constant loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.drive import Drive
from joulemap.model.runs.track import TURN_LIMITS_RADPS

FloatArray = NDArray[np.float64]


def turning(drive: Drive, *, limit_radps: float | None = None, share: float = 1.0) -> FloatArray:
    """Turning, to either side, up to a rate at which it saturates.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    limit_radps : float, optional
        Rate of turning above which it costs no more [rad/s]; one of `TURN_LIMITS_RADPS`.
    share : float
        Share of a radian that runs turn no faster than the limit. The coefficient is then that of their usual radian,
        whatever the rate.

    Returns
    -------
    ndarray of float, (n, 1)
        Per J/rad.
    """
    if limit_radps is None:
        return drive.turned_abs_rad[:, None]
    return drive.gentle_turn_rad[:, [TURN_LIMITS_RADPS.index(limit_radps)]] / share


def turning_both(drive: Drive, *, limit_radps: float) -> FloatArray:
    """Turning, and in addition the part of it below a rate.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    limit_radps : float
        The rate [rad/s]; one of `TURN_LIMITS_RADPS`.

    Returns
    -------
    ndarray of float, (n, 2)
        Per J/rad each.
    """
    return np.concatenate([turning(drive), turning(drive, limit_radps=limit_radps)], axis=1)


def turning_sides(drive: Drive) -> FloatArray:
    """Turning to the right, and to the left.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 2)
        Per J/rad each.
    """
    sides = [drive.turned_abs_rad * (drive.turned_rad > 0), drive.turned_abs_rad * (drive.turned_rad <= 0)]
    return np.stack(sides, axis=1)


def hotel_load(drive: Drive) -> FloatArray:
    """Power drawn all the time, also while stationary.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per W.
    """
    return drive.duration_s[:, None]


def sensor_gain(drive: Drive) -> FloatArray:
    """A factor on everything that is measured.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per 1.
    """
    return drive.predicted[:, None]


def level(drive: Drive) -> FloatArray:
    """A factor on the base prediction of driven segments: its scale error.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per 1.
    """
    return np.where(drive.standing, 0.0, drive.predicted)[:, None]


def standing(drive: Drive) -> FloatArray:
    """Power drawn while stationary, in addition to the declared idle power.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per W.
    """
    return np.where(drive.standing, drive.duration_s, 0.0)[:, None]


def plane(drive: Drive) -> FloatArray:
    """A constant, and shares of the traction uphill and downhill, for charge, whose zero and scale are unknown.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 3)
        Per A s/m, 1/V and 1/V.
    """
    t, length = drive.traction_per_m, drive.length_m
    return np.stack([length, length * np.maximum(t, 0.0), length * np.minimum(t, 0.0)], axis=1)


def friction(drive: Drive) -> FloatArray:
    """Rolling resistance in addition to the declared one.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per unit of the coefficient of rolling resistance.
    """
    return (drive.robot.weight_n * drive.length_m / drive.unit_j)[:, None]


def speed(drive: Drive, *, power: int, absolute: bool) -> FloatArray:
    """The speed, or its difference from the robot's cruising speed.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    power : int
        Of the speed.
    absolute : bool
        Take the speed itself.

    Returns
    -------
    ndarray of float, (n, 1)
        Per J/m per (m/s)^power.
    """
    usual = 0.0 if absolute else drive.robot.speed_mps**power
    return (drive.length_m * (drive.speed_mps**power - usual))[:, None]


def acceleration(drive: Drive) -> FloatArray:
    """Mass, of the robot or of what spins in it, that is accelerated and whose energy is not recovered.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per kg.
    """
    return (drive.gained_m2ps2 / drive.unit_j)[:, None]


def cross_slope(drive: Drive, *, power: int) -> FloatArray:
    """Rolling resistance that depends on the slope across the motion.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    power : int
        Of the tangent: 1 or 2.

    Returns
    -------
    ndarray of float, (n, 1)
        Per unit of rolling resistance per tangent^power.
    """
    across = drive.cross_abs if power == 1 else drive.cross_sq
    return (drive.robot.weight_n * drive.length_m / drive.unit_j * across)[:, None]


def roughness(drive: Drive) -> FloatArray:
    """Rolling resistance that depends on the roughness of the ground.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per unit of rolling resistance per metre.
    """
    return (drive.robot.weight_n * drive.length_m / drive.unit_j * drive.roughness_m)[:, None]


def reversing(drive: Drive, *, of_motion: bool) -> FloatArray:
    """Driving backwards.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    of_motion : bool
        A share of the energy of motion instead of energy per metre.

    Returns
    -------
    ndarray of float, (n, 1)
        Per J/m, or per 1.
    """
    return ((drive.motion_part if of_motion else drive.length_m) * drive.backwards)[:, None]


def braking(drive: Drive, *, from_grade: float | None) -> FloatArray:
    """Share of the energy released downhill that is drawn in addition.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    from_grade : float or None
        Only what is steeper than this tangent is released; None for what is left after the rolling resistance.

    Returns
    -------
    ndarray of float, (n, 1)
        Per 1.
    """
    if from_grade is None:
        return (drive.length_m * np.maximum(-drive.traction_per_m, 0.0) / drive.unit_j)[:, None]
    below = drive.along(lambda grade: np.maximum(-grade - from_grade, 0.0))
    return (drive.robot.weight_n * drive.length_m * below / drive.unit_j)[:, None]


def climbing(drive: Drive) -> FloatArray:
    """Share of the energy of climbing that is drawn in addition.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 1)
        Per 1.
    """
    above = drive.along(lambda grade: np.maximum(grade, 0.0))
    return (drive.robot.weight_n * drive.length_m * above / drive.unit_j)[:, None]
