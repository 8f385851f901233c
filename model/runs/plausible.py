"""Whether the numbers of a run can be in the units that it is read in, judged without knowing the robot."""

from __future__ import annotations

import numpy as np

from joulemap.model.ranges import ROBOT
from joulemap.model.runs.reader import Run
from joulemap.model.runs.segments import Segments

MOST_J_PER_M = 20_000.0
"""Ten tonnes on soft ground: 1e4 kg * 9.8 m/s2 * 0.2 is 20 kN."""

LEAST_J_PER_M = 0.1
"""A toy of 1 kg on rails: 1 kg * 9.8 m/s2 * 0.01."""

LEAST_LOAD_OHM = 0.05
"""A smaller load is as small as the inner resistance of a battery pack and its cables: no pack drives it for long."""

MOST_A = 1_000.0
"""Where no voltage is logged: more than the packs of electric lorries give for long."""

FASTEST_MPS = 70.0
"""250 km/h, at which cars are limited."""

LONGEST_STEP_S, SLOWEST_MPS = 10.0, 0.02
"""Between rows: at a walking pace no metre of ground would have a row of its own. A robot that drove is believed."""

_DEGREES = 0.1  # a drive of 10 km spans less of both


def implausible(run: Run, segments: Segments | None = None) -> list[str]:
    """Return what cannot be, if all columns are in the units that they are read in.

    Result: a sentence for each finding, with the value and the unit that it points to; empty where all is plausible.
    """
    found = []
    step = float(np.median(np.diff(run.t)))
    if step > LONGEST_STEP_S and _mean_speed(run) < SLOWEST_MPS:
        found.append(f"from one of its rows to the next it is {step:,.0f} s: is `t` in ms?")
    if run.voltage_v is not None:
        volts, (low, high) = float(np.median(run.voltage_v)), (ROBOT["nominal_voltage_v"].low, 2000.0)
        if volts > high:
            found.append(f"its voltage is {volts:,.0f} V: is `voltage` in mV?")
        elif 0 < volts < low:
            found.append(f"its voltage is {volts:.3g} V: in which unit is `voltage`?")
    if run.whole_j is not None:
        energy, _ = run.whole_j
        if energy <= 0:
            found.append(f"its state of charge rises, by {-energy / 3600.0:,.1f} Wh: was it charged?")
    elif run.power_w is None:
        found += _current(run)
    elif not run.power_w.any():
        found.append("its power is 0 W in all rows: was it recorded?")
    moving = segments is not None and len(segments) > 0
    if segments is not None and moving:
        speed = float(np.median(segments.driven_m / np.maximum(segments.duration_s, 1e-9)))
        if speed > FASTEST_MPS:
            found.append(f"it drove {speed:,.0f} m/s: is `t` in s, and are positions in m?")
        if not segments.charge and not found:
            took = float(np.median(segments.energy_j / segments.driven_m))
            if took > MOST_J_PER_M:
                column = "is `power` in mW" if run.power_w is not None else "is `current` in mA, or `voltage` in mV"
                found.append(f"a metre took {took:,.0f} J: {column}?")
            elif 0 < took < LEAST_J_PER_M and run.power_w is not None:
                found.append(f"a metre took {took:.3g} J: is `power` in kW?")
    elif _in_degrees(run):
        found.append(
            f"its positions span {np.ptp(run.x[np.isfinite(run.x)]):.2g} m by {np.ptp(run.y[np.isfinite(run.y)]):.2g} "
            "m: are `x` and `y` a longitude and a latitude? Then call them `lon` and `lat`"
        )
    return found


def _mean_speed(run: Run) -> float:
    known = np.isfinite(run.x) & np.isfinite(run.y)
    return float(np.hypot(np.diff(run.x[known]), np.diff(run.y[known])).sum()) / max(float(np.ptp(run.t)), 1e-9)


def _current(run: Run) -> list[str]:
    flowing = np.abs(run.current_a[np.isfinite(run.current_a) & (run.current_a != 0)])
    if not flowing.size:
        return ["its current is 0 A in all rows: was it recorded?"]
    amps = float(np.median(flowing))
    if run.voltage_v is None:
        return [f"its current is {amps:,.0f} A: is `current` in mA?"] if amps > MOST_A else []
    volts = float(np.median(run.voltage_v))
    if 0 < volts <= 2000.0 and amps > volts / LEAST_LOAD_OHM:
        return [f"its current is {amps:,.0f} A at {volts:.1f} V: is `current` in mA?"]
    return []


def _in_degrees(run: Run) -> bool:
    known = np.isfinite(run.x) & np.isfinite(run.y)
    x, y = run.x[known], run.y[known]
    small = np.ptp(x) < _DEGREES and np.ptp(y) < _DEGREES and (np.ptp(x) > 0 or np.ptp(y) > 0)
    return bool(small and np.abs(x).max() <= 180 and np.abs(y).max() <= 90 and np.abs(y).min() > 0.5)
