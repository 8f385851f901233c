"""Faults of a log: a meter that is late, and a map that is out of place. No plan contains them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.late_meter import read_late

_STEP_S = 0.01  # for a derivative
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
    start.
    """

    key = "meter_lag"
    label = "late power readings"
    meaning = "time by which the power readings are later than the positions"
    unit = "s"
    reveals = "sudden starts and stops; better, one clock for all sensors"

    def column(self, rows: Features) -> FloatArray:
        energy = rows.hotel_and_motion
        return (read_late(rows, energy, _STEP_S) - read_late(rows, energy, -_STEP_S)) / (2.0 * _STEP_S)

    def simulated(self, rows: Features, size: FloatArray, energy: Energy) -> FloatArray:
        drawn = energy(rows)
        return read_late(rows, drawn, size[0]) - drawn


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
