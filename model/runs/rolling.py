"""How far wheels roll, and runs without positions cut into segments by it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.runs.arcs import STILL_M, equal_parts, station_at, stops_of
from joulemap.model.runs.reckoning import without_blanks
from joulemap.model.runs.run import STOP_S, Run, rows_missing
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.smoothing import smooth
from joulemap.model.runs.table import SIDES

FloatArray = NDArray[np.float64]

HEADING_SMOOTHING_S = 0.8
"""Setting: headings from wheel speeds are smoothed over so long before turns are measured: jitter is no turning, but it
adds up. Chosen on a Husky: without it left-out runs err by 2 % more; from 0.7 to 1 s they err alike."""


def rolled_between(t: FloatArray, sides: FloatArray) -> FloatArray:
    """Return what the wheels roll from each row to the next.

    `t` (n,): stamps [s]; `sides` (2, n): speeds of the sides [m/s]. Result (n - 1,): mean of both sides, unsigned [m].
    """
    rolling = np.abs(sides).mean(axis=0)
    return np.asarray(0.5 * (rolling[1:] + rolling[:-1]) * np.diff(t))


def rolled_m(run: Run) -> float:
    """Return how far the wheels of a run rolled, turns on the spot included and missing rows not.

    Result: mean of both sides [m].
    """
    rolled = rolled_between(run.t, np.stack([without_blanks(run.extras[name]) for name in SIDES]))
    return float(rolled[~rows_missing(run.t, rolled, 1.0)].sum())


def cut_travel(run: Run, *, length_m: float = 1.0, charge: bool = False) -> Segments:
    """Cut a run into segments by the distance that the wheels roll.

    The distance is the mean of both sides, so that turning on the spot counts too. `driven_m` is what the wheels
    rolled, `heading_rad` where the robot points in the middle. Every piece between missing rows is cut into equal parts
    of about `length_m`; stops of 2 s or more are in no segment. The metres across missing rows are those at the mean
    speed of both ends.

    `charge`: integrate the current alone [A s] instead of the power [J].
    """
    t = run.t
    sides = np.stack([without_blanks(run.extras[name]) for name in SIDES])
    rolled = rolled_between(t, sides)
    missing = rows_missing(t, rolled, length_m)
    gap = np.concatenate([[True], missing])
    still = np.abs(sides).max(axis=0) < STILL_M / STOP_S
    stop = _long_intervals(t, still, gap)
    dt = np.where(missing | (stop[1:] & stop[:-1]), 0.0, np.diff(t))
    arc = _summed(np.where(dt > 0, rolled, 0.0))
    spans, short = equal_parts(arc, gap, stop, length_m)
    station = np.arange(t.size, dtype=np.float64)
    starts, ends = (np.interp(spans[:, k], station, t) for k in (0, 1))
    middle = np.interp(station_at(arc, np.interp(spans, station, arc).mean(axis=1)), station, t)
    row = np.clip(np.searchsorted(t, middle), 0, t.size - 1)
    heading = np.unwrap(np.radians(run.extras["heading"]))
    part = np.cumsum(gap | np.diff(stop, prepend=stop[:1]), dtype=np.int64)  # no turn is smoothed into a stop
    sigma_s = max(HEADING_SMOOTHING_S, float(np.median(np.diff(t))))
    step = np.where(dt > 0, np.diff(smooth(t, heading, heading, part, sigma_s)[0]), 0.0)
    speed = sides.mean(axis=0)
    half_square = 0.5 * speed**2
    power = run.drawn(charge=charge)
    energy = _summed(0.5 * (power[1:] + power[:-1]) * dt)
    gap_m = float(rolled[missing].sum())

    def _between(cumulated: FloatArray) -> FloatArray:
        return np.interp(ends, t, cumulated) - np.interp(starts, t, cumulated)

    def _mean(values: FloatArray) -> FloatArray:
        return _between(_summed(0.5 * (values[1:] + values[:-1]) * dt)) / np.maximum(duration, 1e-9)

    duration = _between(_summed(dt))
    counts = {"gaps": int(missing.sum()), "stops": int((np.diff(stop.astype(int), prepend=0) == 1).sum())}
    metres = {"gaps": gap_m, "remainders": sum(short)}

    usable = np.isfinite(run.x)
    logged = {key: without_blanks(values) for key, values in run.extras.items() if key not in SIDES}
    return Segments(
        x=np.interp(middle, t[usable], run.x[usable]),
        y=np.interp(middle, t[usable], run.y[usable]),
        heading_rad=np.mod(np.interp(middle, t, heading), 2.0 * np.pi),
        energy_j=_between(energy),
        duration_s=duration,
        driven_m=_between(arc),
        heading_change_rad=_between(_summed(step)),
        turned_abs_rad=_between(_summed(np.abs(step))),
        gained_m2ps2=_between(_summed(np.maximum(np.where(dt > 0, np.diff(half_square), 0.0), 0.0))),
        kinetic_m2ps2=_between(half_square),
        standing_s=_between(_summed(np.where(still[1:] & still[:-1], dt, 0.0))),
        voltage_v=np.full(starts.size, np.nan) if run.voltage_v is None else _mean(run.voltage_v),
        current_a=_mean(run.current_a),
        ripple=np.ones(starts.size),
        t0=starts,
        run=np.zeros(starts.size, dtype=np.int64),
        runs=(run.name,),
        length_m=length_m,
        charge=charge,
        of_motors=charge and run.of_motors,
        extras={key: _mean(values) for key, values in logged.items()}
        | {"heading": np.degrees(np.interp(middle, t, heading)) % 360.0, "speed": _mean(speed)},
        texts={key: words[row] for key, words in run.texts.items()},
        stationary=stops_of(t, gap, stop, t, power),
        left_out={key: count for key, count in (counts | {"remainders": len(short)}).items() if count},
        left_out_m={key: length for key, length in metres.items() if length > 0},
        track_m=float(arc[-1]) + gap_m,
    )


def _summed(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _long_intervals(t: FloatArray, still: NDArray[np.bool_], gap: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """True in intervals without a gap that are still for `STOP_S` or more."""
    stop = np.zeros(t.size, dtype=bool)
    begins = np.flatnonzero(still & (gap | ~np.concatenate([[False], still[:-1]])))
    ends = np.flatnonzero(still & (np.append(gap[1:], True) | ~np.append(still[1:], False)))
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        if t[last] - t[first] >= STOP_S:
            stop[first : last + 1] = True
    return stop
