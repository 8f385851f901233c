"""State of charge, current and voltage of a battery along a course: an open-circuit voltage behind a resistance."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.battery import Battery, Pack
from joulemap.planner.verdict.trajectory import Course

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BatteryTrace:
    """A battery along a course, at the expected energies.

    Attributes
    ----------
    charge : ndarray of float, (n,)
        State of charge at the end of each piece, 0..1.
    voltage_v : ndarray of float, (n,)
        Voltage under the load of each piece [V]; 0 where it breaks down.
    power_w : ndarray of float, (n,)
        Mean power of each piece [W].
    most_power_w : ndarray of float, (n,)
        Most power at which the voltage holds there [W].
    lost_j : float
        Energy lost inside the battery [J].
    """

    charge: FloatArray
    voltage_v: FloatArray
    power_w: FloatArray
    most_power_w: FloatArray
    lost_j: float

    @property
    def overload(self) -> int | None:
        """Number of the first piece whose power is more than the battery can give; None where there is none."""
        over = np.flatnonzero(self.power_w > self.most_power_w)
        return int(over[0]) if over.size else None


def trace_battery(course: Course, battery: Battery, pack: Pack) -> BatteryTrace:
    """Return a battery along a course.

    `course`: its pieces; energies are those at the terminals of the battery; `battery`: with its charge at the start;
    `pack`: its electric side. Result: a full battery takes no more charge.

    P = V I and V = U(s) - R I, so I = (U - sqrt(U^2 - 4 R P)) / (2 R) and ds/dt = -I / Q, with the open-circuit voltage
    U at the start of a piece (a piece is at most a metre). Where the battery cannot give the power it gives the most
    that it can, so that what follows is shown too.

    Reference: Tremblay, Dessaint & Dekkiche 2007, "A generic battery model for the dynamic simulation of hybrid
    electric vehicles", without its transient part.
    """
    timed = course.duration_s > 0.0
    power = np.where(timed, course.energy_j / np.where(timed, course.duration_s, 1.0), 0.0)
    charges, volts = (list(column) for column in zip(*pack.curve, strict=True))
    slopes = [(b - a) / (d - c) for a, b, c, d in zip(volts, volts[1:], charges, charges[1:], strict=False)]
    resistance, cutoff, limit, full = pack.resistance_ohm, pack.cutoff_v, pack.max_power_w, pack.full_as
    charge, lost, last = battery.charge, 0.0, len(slopes) - 1
    found: list[tuple[float, float, float]] = []
    for wanted, seconds in zip(power.tolist(), course.duration_s.tolist(), strict=True):
        k = min(bisect_right(charges, charge) - 1, last)
        open_v = volts[k] + slopes[k] * (charge - charges[k])
        least_v = max(cutoff, 0.5 * open_v)
        if resistance > 0.0:
            most = min(least_v * max(open_v - least_v, 0.0) / resistance, limit)
            given = min(wanted, most)
            current = (open_v - math.sqrt(max(open_v * open_v - 4.0 * resistance * given, 0.0))) / (2.0 * resistance)
        else:
            most = limit if open_v > cutoff else 0.0
            given = min(wanted, most)
            current = given / open_v
        under_load = open_v - resistance * current if wanted <= most else 0.0
        charge = min(max(charge - current * seconds / full, 0.0), 1.0)
        lost += resistance * current * current * seconds
        found.append((charge, under_load, most))
    columns = np.array(found, dtype=np.float64).reshape(-1, 3).T
    return BatteryTrace(columns[0], columns[1], power, columns[2], lost)


def electric_available_j(battery: Battery, pack: Pack, trace: BatteryTrace, used_j: float) -> float:
    """Return the energy above the reserve that a battery can give at the losses of a course.

    `battery`: charge and reserve; `pack`: its electric side; `trace`: of the course; `used_j`: energy of the course at
    the terminals [J]. Result: energy at the terminals [J]: what the curve holds between charge and reserve, less the
    course's share of losses.
    """
    ends = sorted((battery.charge, battery.reserve))
    marks = np.array([ends[0], *(s for s, _ in pack.curve if ends[0] < s < ends[1]), ends[1]])
    held = pack.full_as * float(np.trapezoid(pack.open_circuit_v(marks), marks))
    share = trace.lost_j / used_j if used_j > 0.0 else 0.0
    held /= 1.0 + share
    return held if battery.charge >= battery.reserve else -held
