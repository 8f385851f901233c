"""Formulas of effects of conditions: payload, weather, heading, time, battery and classes of ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.drive import Drive
from joulemap.model.loop.quantities import quantity

FloatArray = NDArray[np.float64]


def payload(drive: Drive, *, column: str | None = None, reference: float = 0.0) -> FloatArray:
    """Mass: all energy of motion is proportional to it.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    column : str, optional
        Logged mass to multiply with.
    reference : float
        Of that column [kg].

    Returns
    -------
    ndarray of float, (n, 1)
        Per kg, or per kg of logged kg.
    """
    per_kg = drive.motion_part / drive.robot.mass_kg
    return (per_kg if column is None else per_kg * _known(drive, column, reference))[:, None]


def temperature(
    drive: Drive, *, reference: float, of_motion: bool, begun: bool = False, of_time: bool = False
) -> FloatArray:
    """Energy that depends on the temperature.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    reference : float
        Temperature at which it is nil [degC].
    of_motion : bool
        A share of the energy of motion instead of energy per metre.
    begun : bool
        Add a column for what it takes at the reference already.
    of_time : bool
        Power, as of a heater.

    Returns
    -------
    ndarray of float, (n, 1) or (n, 2)
        Per 1/K, J/m/K or W/K.
    """
    amount = drive.duration_s if of_time else drive.motion_part if of_motion else drive.length_m
    return _from_zero(amount, _known(drive, "temperature", reference), begun)


def _from_zero(amount: FloatArray, grows: FloatArray, begun: bool) -> FloatArray:
    return np.stack([amount] * begun + [amount * grows], axis=1)


def wind_measured(drive: Drive, *, quadratic: bool) -> FloatArray:
    """Aerodynamic drag along the motion in the logged wind, less that in still air.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    quadratic : bool
        Drag with the square of the relative air speed, instead of the component of the wind.

    Returns
    -------
    ndarray of float, (n, 1)
        Per N per (m/s)^2, or per N per m/s.
    """
    towards = _known(drive, "wind_speed", 0.0) * np.cos(
        np.radians(np.nan_to_num(drive.columns.get("wind_from", np.zeros(len(drive))))) - drive.heading_rad
    )
    across2 = np.maximum(_known(drive, "wind_speed", 0.0) ** 2 - towards**2, 0.0)
    if not quadratic:
        return (drive.length_m * towards / drive.unit_j)[:, None]
    ahead = drive.speed_mps + towards
    drag = ahead * np.sqrt(ahead**2 + across2) - drive.speed_mps**2
    return (drive.length_m * drag / drive.unit_j)[:, None]


def wind_constant(drive: Drive) -> FloatArray:
    """Driving towards the east, and towards the north, against a wind that was not logged.

    Parameters
    ----------
    drive : Drive
        Features of the segments.

    Returns
    -------
    ndarray of float, (n, 2)
        Per J/m each.
    """
    return heading(drive, harmonics=1)


def heading(drive: Drive, *, harmonics: int, level: bool = False, of_motion: bool = False) -> FloatArray:
    """Sine and cosine of the heading and of its multiples.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    harmonics : int
        Number of multiples.
    level : bool
        Add a constant column before them.
    of_motion : bool
        A share of the energy of motion instead of energy per metre, as of ruts.

    Returns
    -------
    ndarray of float, (n, 2 harmonics + level)
        Per J/m, or per 1.
    """
    angles = [order * drive.heading_rad for order in range(1, harmonics + 1)]
    waves = [f(angle) for angle in angles for f in (np.sin, np.cos)]
    constant = [np.ones(len(drive))] if level else []
    return np.stack([*constant, *waves], axis=1) * (drive.motion_part if of_motion else drive.length_m)[:, None]


def drift(drive: Drive, *, over: str, unit: float, of_all: bool = True, begun: bool = False) -> FloatArray:
    """A share of everything, or energy per metre, that grows from 0 at the start.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    over : str
        Quantity over which it grows.
    unit : float
        Of that quantity: an hour, a kilometre.
    of_all : bool
        A share of everything instead of energy per metre.
    begun : bool
        Add a column for what it takes at the start already.

    Returns
    -------
    ndarray of float, (n, 1) or (n, 2)
        Per 1/unit, or per J/m/unit.
    """
    return _from_zero(drive.predicted if of_all else drive.length_m, quantity(drive, over) / unit, begun)


def battery(drive: Drive, *, ripple: float = 1.0) -> FloatArray:
    """Losses with the square of the current that the prediction asks for.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    ripple : float
        Mean square of a current over the square of its mean within a segment, where it is not steady.

    Returns
    -------
    ndarray of float, (n, 1)
        Per ohm.
    """
    volts = drive.robot.nominal_voltage_v
    amps = drive.predicted * drive.unit_j / np.maximum(drive.duration_s, 1e-6) / volts
    return (ripple * amps**2 * drive.duration_s / drive.unit_j)[:, None]


def words(drive: Drive, *, column: str, values: list[str], of_motion: bool) -> FloatArray:
    """Classes of a logged column of text; classes that are not listed are the reference.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    column : str
        Name of the column.
    values : list of str
        Classes.
    of_motion : bool
        A share of the energy of motion instead of energy per metre.

    Returns
    -------
    ndarray of float, (n, classes)
        Per J/m, or per 1.
    """
    found = drive.words.get(column, np.full(len(drive), ""))
    amount = drive.motion_part if of_motion else drive.length_m
    return np.stack([(found == word) * amount for word in values], axis=1)


def turning_words(drive: Drive, *, column: str, values: list[str]) -> FloatArray:
    """Turning on each class of a logged column of text, in addition to turning on classes that are not listed.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    column : str
        Name of the column.
    values : list of str
        Classes.

    Returns
    -------
    ndarray of float, (n, classes)
        Per J/rad.
    """
    found = drive.words.get(column, np.full(len(drive), ""))
    return np.stack([(found == word) * drive.turned_abs_rad for word in values], axis=1)


def _known(drive: Drive, column: str, reference: float) -> FloatArray:
    """A logged column less its reference; 0 where it was not recorded."""
    values = drive.columns.get(column, np.full(len(drive), np.nan))
    return np.where(np.isfinite(values), values - reference, 0.0)
