"""Faults of a log: a meter that is late, and a map that is out of place. No plan contains them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray

Energy = Callable[[Features], FloatArray]


class LogFault(Form):
    """A fault of the log, which its columns describe to first order."""

    planned = False
    on_map = False

    def simulated(self, rows: Features, size: FloatArray, energy: Energy) -> FloatArray:
        """Energy that a fault adds to rows, (n,), by that of rows without it. size : of the fault, (k,)."""
        raise NotImplementedError


@dataclass(frozen=True)
class MeterLag(LogFault):
    """Time by which the measured power is late.

    To first order the energy of a row is less by the lag times the predicted power at its end, and more by that at its
    start. The power at a border is the mean of both sides.
    """

    key = "meter_lag"
    label = "late power readings"
    meaning = "time by which the power readings are later than the positions"
    unit = "s"
    reveals = "sudden starts and stops; better, one clock for all sensors"

    def column(self, rows: Features) -> FloatArray:
        power = rows.power_w / rows.unit_j
        follows = (np.diff(rows.run) == 0) & ~rows.standing[1:] & ~rows.standing[:-1]
        border = np.pad(np.where(follows, 0.5 * (power[1:] + power[:-1]), np.nan), 1, constant_values=np.nan)
        return border[:-1] - border[1:]

    def simulated(self, rows: Features, size: FloatArray, energy: Energy) -> FloatArray:
        drawn = energy(rows)
        return rows.read_late(drawn, size[0]) - drawn


@dataclass(frozen=True)
class MapShift(LogFault):
    """Distance by which the map lies too far east and north, to first order in the change of the grade."""

    key = "map_shift"
    label = "map out of place"
    meaning = "distance by which the positions are off the map"
    unit = "m"
    reveals = "a survey of three marks that the map shows"
    of_map = True

    def coefficient_names(self) -> tuple[str, ...]:
        return ("east", "north")

    def columns(self, rows: Features) -> FloatArray:
        amount = (rows.weight_length * rows.pulling)[:, None]
        return np.nan_to_num(amount * np.stack([rows.grade_east, rows.grade_north], axis=1))

    def simulated(self, rows: Features, size: FloatArray, energy: Energy) -> FloatArray:
        return energy(rows.moved(*size)) - energy(rows)
