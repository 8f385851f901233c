"""One measured run, cleaned: what every method takes that works on drives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import RunsError
from joulemap.model.runs.electric import Currents

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STOP_S = 2.0
"""A robot that is stationary for so long stops; a shorter interval is part of its drive. A setting."""

_MOST_STEPS = 0.9  # a bicycle computer thins rows out
_MEASURED_SHARE = 0.5  # at least so much of a segment is measured: missing rows take no more than the rest
_ROWS_BRIDGED = 2.5  # intervals between stamps: one missing row makes two, and stamps jitter


@dataclass(frozen=True)
class Run:
    """One measured run, cleaned.

    Attributes
    ----------
    name : str
        Of the run.
    t : ndarray of float, (n,)
        Stamps [s], strictly increasing.
    x, y : ndarray of float, (n,)
        Position [m] in the heightmap's CRS, NaN where the fix is not used.
    current_a : ndarray of float, (n,)
        Current [A], positive while the battery discharges; NaN if only power was recorded.
    voltage_v : ndarray of float, (n,), optional
        Voltage [V]; None if it was not recorded.
    extras : dict of str to ndarray of float, (n,)
        Further columns of numbers as recorded; NaN is blank.
    texts : dict of str to ndarray of str, (n,)
        Columns of text.
    breaks : ndarray of bool, (n,)
        True where the position jumped between this row and the one before.
    repairs : dict
        Count by rule.
    power_w : ndarray of float, (n,), optional
        Power [W] drawn from the battery, where it was recorded itself.
    currents : {"signed", "magnitude"}, optional
        How the currents of several motors were summed; None where the log leaves no choice.
    of_motors : bool
        Whether the current is the sum of those of several motors.
    reading : dict of str to str
        By joulemap's column that the log has under another name or in another unit: what was taken, with its unit.
    notes : tuple of str
        What is to be known of the file: that it was cut off, for example.
    placed : bool
        Whether positions are places. False where the log has a distance only: then x is 0, and y is the distance.
    unknown_s : float
        Time in which what is drawn was not measured, and is interpolated [s].
    whole_j : tuple of float, optional
        Energy of the whole run and its standard deviation [J], where a state of charge is all that was logged.
    counted : bool
        Whether what is drawn is the rate of a counter, which goes on where rows are missing.
    confidence : dict of str to float
        By joulemap's column, how sure it is that it was recognised rightly, 0 to 1.
    """

    name: str
    t: FloatArray
    x: FloatArray
    y: FloatArray
    current_a: FloatArray
    voltage_v: FloatArray | None
    extras: dict[str, FloatArray] = field(default_factory=dict)
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    breaks: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    repairs: dict[str, int] = field(default_factory=dict)
    power_w: FloatArray | None = None
    currents: Currents | None = None
    of_motors: bool = False
    reading: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    placed: bool = True
    unknown_s: float = 0.0
    whole_j: tuple[float, float] | None = None
    confidence: dict[str, float] = field(default_factory=dict)
    counted: bool = False

    def __post_init__(self) -> None:
        if self.breaks.size != self.t.size:
            object.__setattr__(self, "breaks", np.zeros(self.t.size, dtype=bool))

    def __len__(self) -> int:
        return int(self.t.size)

    @property
    def has_energy(self) -> bool:
        """Whether energy is known, and not charge alone."""
        return self.power_w is not None or self.voltage_v is not None or self.whole_j is not None

    def energy(self) -> tuple[float, float]:
        """Return the energy of the whole run, of which gaps of the log are no part unless a counter went on in them.

        Returns
        -------
        tuple of float
            Energy and its standard deviation as far as it is that of readings that are rounded [J].

        Raises
        ------
        RunsError
            If there is neither a power, nor a current with a voltage, nor a state of charge.
        """
        if self.whole_j is not None:
            return self.whole_j
        power = self.drawn()
        steps = 0.5 * (power[1:] + power[:-1]) * np.diff(self.t)
        return float(np.sum(steps if self.counted else steps[~self.missing()])), 0.0

    def missing(self, length_m: float = 1.0) -> BoolArray:
        """Return where rows are missing, by the ways between fixes.

        Parameters
        ----------
        length_m : float, optional
            Of a segment [m].

        Returns
        -------
        ndarray of bool, (n - 1,)
            As of `rows_missing`.
        """
        fixes = np.flatnonzero(np.isfinite(self.x) & np.isfinite(self.y))
        along = np.zeros(len(self) - 1)  # of the step between fixes in which a row lies
        if fixes.size:
            ways = np.hypot(np.diff(self.x[fixes]), np.diff(self.y[fixes]))
            along[fixes[0] : fixes[-1]] = np.repeat(ways, np.diff(fixes))
        return rows_missing(self.t, along, length_m)

    def drawn(self, *, charge: bool = False) -> FloatArray:
        """Return what is drawn from the battery.

        Parameters
        ----------
        charge : bool
            The current instead of the power.

        Returns
        -------
        ndarray of float, (n,)
            Power [W], or current [A].

        Raises
        ------
        RunsError
            If that is not known.
        """
        if self.whole_j is not None:
            raise RunsError.of_run(
                self.name, "a state of charge says the energy of the whole drive, and not that of a metre"
            )
        if charge:
            if np.isnan(self.current_a).all():
                raise RunsError(f"run {self.name}: power was recorded and no current, so its charge is not known")
            return self.current_a
        if self.power_w is not None:
            return self.power_w
        if self.voltage_v is None:
            raise RunsError.of_run(self.name, "no voltage was recorded; ask for charge [A s] instead")
        return self.current_a * self.voltage_v


def rows_missing(t: FloatArray, distance_m: FloatArray, length_m: float = 1.0) -> BoolArray:
    """Return where so many rows are missing that too little of a segment is measured.

    Parameters
    ----------
    t : ndarray of float, (n,)
        Stamps [s].
    distance_m : ndarray of float, (n - 1,)
        Driven from each to the next [m].
    length_m : float, optional
        Of a segment [m].

    Returns
    -------
    ndarray of bool, (n - 1,)
        True where more than one row is missing, and the robot drove more than half a segment or had time to stop.
    """
    dt = np.diff(t)
    usual = float(np.quantile(dt[dt > 0], _MOST_STEPS, method="lower")) if (dt > 0).any() else 0.0
    far = np.abs(distance_m) > _MEASURED_SHARE * length_m
    return np.asarray((dt > _ROWS_BRIDGED * usual) & (far | (dt > STOP_S)))
