"""Whether the numbers of a run can be in the units that it is read in, judged without knowing the robot."""

from __future__ import annotations

import numpy as np

from joulemap.model.ranges import ROBOT
from joulemap.model.runs.agreement import MOST_A, MOST_V, in_degrees, most_amps
from joulemap.model.runs.clocks import of_clocks
from joulemap.model.runs.counters import summed
from joulemap.model.runs.run import Run
from joulemap.model.runs.segments import Segments

MOST_J_PER_M = 20_000.0
"""Ten tonnes on soft ground: 1e4 kg * 9.8 m/s2 * 0.2 is 20 kN."""

LEAST_J_PER_M = 0.1
"""A toy of 1 kg on rails: 1 kg * 9.8 m/s2 * 0.01."""

_SELDOM_S = 1.0  # between fixes: a vehicle turns at a crossing in some seconds

_MODEL_CAR_J_PER_M = 1.0  # 5 kg on a floor take 5 kg * 9.8 m/s2 * 0.02
_LEAST_READINGS = 10
_FROZEN_S, _FROZEN = 30.0, 30.0  # and so many times as long as nine of ten readings stay

FASTEST_MPS = 70.0
"""250 km/h, at which cars are limited."""

LENGTHS_DIFFER = 0.03
"""Tyres and sensors of speed err by less [share]."""

LONGEST_STEP_S, SLOWEST_MPS = 10.0, 0.02
"""Between rows: at a walking pace no metre of ground would have a row of its own. A robot that drove is believed."""


def implausible(run: Run, segments: Segments | None = None) -> list[str]:
    """Return what cannot be, if all columns are in the units that they are read in.

    Result: a sentence for each finding, with the value and the unit that it points to; empty where all is plausible.
    """
    found = []
    step = float(np.median(np.diff(run.t)))
    if step > LONGEST_STEP_S and _mean_speed(run) < SLOWEST_MPS:
        found.append(f"from one of its rows to the next it is {step:,.0f} s: is `t` in ms?")
    if run.voltage_v is not None:
        volts, (low, high) = float(np.median(run.voltage_v)), (ROBOT["nominal_voltage_v"].low, MOST_V)
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
                column = "is `power` in mW" if run.power_w is not None else "is `current` in mA"
                column += "" if run.power_w is not None or run.voltage_v is None else ", or `voltage` in mV"
                found.append(f"a metre took {took:,.0f} J: {column}?")
            elif 0 < took < LEAST_J_PER_M and run.power_w is not None:
                found.append(f"a metre took {took:.3g} J: is `power` in kW?")
    elif in_degrees(run.x, run.y):
        found.append(
            f"its positions span {np.ptp(run.x[np.isfinite(run.x)]):.2g} m by {np.ptp(run.y[np.isfinite(run.y)]):.2g} "
            "m: are `x` and `y` a longitude and a latitude? Then call them `lon` and `lat`"
        )
    return found


def doubtful(run: Run, segments: Segments | None) -> list[str]:
    """Return what is to be known of a run that is kept: sentences on its length and on its clocks."""
    return [*of_length(run, segments), *of_meter(run, segments), *of_clocks(run)]


def of_length(run: Run, segments: Segments | None) -> list[str]:
    """Return a sentence where positions are so seldom that the track is not as long as the speed says; else nothing."""
    speed = run.extras.get("speed")
    if segments is None or speed is None or float(np.median(np.diff(run.t))) < _SELDOM_S:
        return []
    made = float(np.nanmax(summed(run.t, speed), initial=0.0))
    if abs(segments.track_m - made) <= LENGTHS_DIFFER * made:
        return []
    return [
        f"its track is {segments.track_m:,.0f} m long, where its speed makes {made:,.0f} m: positions are too rare to "
        "show its curves, and what a metre takes is wrong by as much"
    ]


def of_meter(run: Run, segments: Segments | None) -> list[str]:
    """Return sentences on a meter that stopped while the robot went on, and on one that hardly reads anything."""
    found = list[str]()
    if segments is None or not len(segments):
        return found
    if run.has_energy and 0 < (took := float(segments.energy_j.sum() / segments.driven_m.sum())) < _MODEL_CAR_J_PER_M:
        found.append(f"a metre took {took:.2g} J, less than a model car takes: is its power in the unit that it says?")
    drawn = run.drawn(charge=not run.has_energy)
    rows = np.flatnonzero(np.isfinite(drawn))
    first = rows[np.append(True, np.diff(drawn[rows]) != 0)]
    if first.size < _LEAST_READINGS:
        return found
    last = np.append(first[1:], rows[-1])
    stays = run.t[last] - run.t[first]
    longest = int(np.argmax(stays))
    begin, end = run.t[first[longest]], run.t[last[longest]]
    inside = (segments.t0 >= begin) & (segments.t0 + segments.duration_s <= end)
    moved_m = float(segments.driven_m[inside].sum())
    if stays[longest] > max(_FROZEN_S, _FROZEN * float(np.quantile(stays, 0.9))) and moved_m > _FROZEN_S * SLOWEST_MPS:
        found.append(
            f"its power stays the same for {stays[longest]:,.0f} s, in which it drove {moved_m:,.0f} m: had its meter "
            "stopped?"
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
    if 0 < volts <= MOST_V and amps > most_amps(volts):
        return [f"its current is {amps:,.0f} A at {volts:.1f} V: is `current` in mA?"]
    return []
