"""Logs without positions: wheel speeds are integrated to a track, and segments are cut by the distance rolled.

A skid-steered robot slips in turns and turns less than its wheels indicate: `track_m` is the effective distance between
the sides, larger than the measured one. Positions drift within minutes; on flat ground only the last metre matters.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.ranges import TRACK_M
from joulemap.model.runs.arcs import STILL_M, STOP_S, equal_parts, rows_missing, station_at, stops_of
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.logs import Table, read_log
from joulemap.model.runs.reader import Run, run_of
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.smoothing import smooth
from joulemap.model.runs.table import LIMITS, TableLimits, columns_there
from joulemap.model.runs.track import TURN_LIMITS_RADPS
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

HEADING_SMOOTHING_S = 0.8
"""Setting: headings from wheel speeds are smoothed over so long before turns are measured: jitter is no turning, but it
adds up. Chosen on a Husky: without it left-out runs err by 2 % more; from 0.7 to 1 s they err alike."""
_SIDES = ("speed_left", "speed_right")
_NUMBERED = re.compile(r"[\W_]*\d*$")


@dataclass(frozen=True)
class Odometry:
    """How logs without positions are read.

    Attributes
    ----------
    track_m : float
        Effective distance between the left and the right wheels while turning [m].
    terrain_from_name : bool
        Take the class of ground from the name of a file that has no such column.

    Raises
    ------
    InputError
        If `track_m` is outside `joulemap.model.ranges.TRACK_M`.
    """

    track_m: float
    terrain_from_name: bool = False

    def __post_init__(self) -> None:
        if self.track_m not in TRACK_M:
            raise InputError(
                f"the track must be {TRACK_M} metres, got {self.track_m}",
                track_m=str(self.track_m),
                limit=[TRACK_M.low, TRACK_M.high],
            )


def read_odometry(
    path: str | Path,
    odometry: Odometry,
    *,
    name: str | None = None,
    currents: Currents = "auto",
    limits: TableLimits = LIMITS,
    mapping: Mapping[str, str] | None = None,
) -> Run:
    """Read a log of wheel speeds as a run that starts at (0, 0) and heads north.

    Its columns are t [s], speed_left and speed_right [m/s], and current, several current_* [A] or power [W]; optionally
    voltage [V] and any others. Columns named as in BorealTC (velL, curL, ...) are known too. The rules of
    `joulemap.model.runs.reader` apply. The columns heading [deg] and speed [m/s] are added.

    Parameters
    ----------
    path : str or Path
        Of the file.
    odometry : Odometry
        How wheel speeds become a track.
    name : str, optional
        Of the run; without it, that of the file.
    currents : {"auto", "signed", "magnitude"}
        As in `read_run`.
    limits : TableLimits, optional
        How large the table may be.
    mapping : mapping of str to str, optional
        As in `read_run`.

    Returns
    -------
    Run
        With positions in a frame of its own.

    Raises
    ------
    RunsError
        If the file cannot be read, or a column is missing.
    TooLargeError
        If it is larger than the limits.
    """
    path = Path(path)
    name = name or path.name
    repairs: dict[str, int] = {}
    table = read_log(path, name, repairs, limits=limits, mapping=mapping)
    return odometry_run(table, odometry, name=name, repairs=repairs, currents=currents)


def odometry_run(
    table: Table, odometry: Odometry, *, name: str, repairs: dict[str, int], currents: Currents = "auto"
) -> Run:
    """Make a run of a table of wheel speeds.

    Parameters
    ----------
    table : Table
        As `read_log` returns it; its columns are taken out of it.
    odometry : Odometry
        How wheel speeds become a track.
    name : str
        Of the run.
    repairs : dict
        What was counted while it was read.
    currents : {"auto", "signed", "magnitude"}
        As in `read_run`.

    Returns
    -------
    Run
        As `read_odometry`.

    Raises
    ------
    RunsError
        If a column is missing.
    """
    numbers, texts = table.numbers, table.texts
    for column in ("t", *_SIDES):
        if column not in numbers:
            raise RunsError(
                f"run {name}: there is no column {column!r} of numbers{columns_there(numbers)}", run=name, column=column
            )
    left, right = (_without_blanks(numbers[name]) for name in _SIDES)
    x, y, heading = integrate(numbers["t"], left, right, track_m=odometry.track_m)
    motion = {"heading": np.degrees(heading) % 360.0, "speed": (left + right) / 2}
    terrain = terrain_in_name(name) if odometry.terrain_from_name else None
    if terrain is not None and "terrain" not in texts:
        texts["terrain"] = np.full(x.size, terrain)
    run = run_of(numbers | {"x": x, "y": y} | motion, texts, name=name, repairs=repairs, currents=currents)
    return replace(run, reading=table.reading)


def terrain_in_name(name: str) -> str | None:
    """Return the class of ground that a file is named after.

    Parameters
    ----------
    name : str
        Such as `snow_02.csv`.

    Returns
    -------
    str or None
        Such as `snow`; None where the name is a number only.
    """
    return _NUMBERED.sub("", Path(name).stem) or None


def integrate(
    t: FloatArray, left_mps: FloatArray, right_mps: FloatArray, *, track_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrate wheel speeds from (0, 0), heading north.

    Parameters
    ----------
    t : ndarray of float, (n,)
        Stamps [s].
    left_mps, right_mps : ndarray of float, (n,)
        Speeds of the sides [m/s].
    track_m : float
        Effective distance between the sides [m].

    Returns
    -------
    tuple of ndarray of float, (n,)
        x, y [m], and heading [rad], clockwise from north and not wrapped.

    Notes
    -----
    Each step has the mean speeds of its two ends and is an arc, which is exact at constant speeds. Nothing is driven
    across missing rows (`joulemap.model.runs.arcs.rows_missing`) and steps back in time.
    """
    dt = np.diff(t)
    dt = np.where((dt > 0) & ~rows_missing(t, _rolled(t, np.stack([left_mps, right_mps]))), dt, 0.0)
    ahead = 0.25 * (left_mps[1:] + left_mps[:-1] + right_mps[1:] + right_mps[:-1]) * dt
    turn = 0.5 * (left_mps[1:] + left_mps[:-1] - right_mps[1:] - right_mps[:-1]) * dt / track_m
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    chord = ahead * np.sinc(turn / (2.0 * np.pi))
    middle = heading[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    return x, y, heading


def rolled_m(run: Run) -> float:
    """Return how far the wheels of a run rolled, turns on the spot included and missing rows not.

    Parameters
    ----------
    run : Run
        From `read_odometry`.

    Returns
    -------
    float
        Mean of both sides [m].
    """
    rolled = _rolled(run.t, np.stack([_without_blanks(run.extras[name]) for name in _SIDES]))
    return float(rolled[~rows_missing(run.t, rolled, 1.0)].sum())


def cut_travel(run: Run, *, length_m: float = 1.0, charge: bool = False) -> Segments:
    """Cut a run into segments by the distance that the wheels roll.

    The distance is the mean of both sides, so that turning on the spot counts too. `driven_m` is what the wheels
    rolled, `heading_rad` where the robot points in the middle. Every piece between missing rows is cut into equal parts
    of about `length_m`; stops of 2 s or more are in no segment. The metres across missing rows are those at the mean
    speed of both ends.

    Parameters
    ----------
    run : Run
        From `read_odometry`.
    length_m : float
        Nominal length of a segment [m].
    charge : bool
        Integrate the current alone [A s] instead of the power [J].

    Returns
    -------
    Segments
        In driving order.

    Raises
    ------
    RunsError
        If the run has no voltage and `charge` is False.
    """
    t = run.t
    sides = np.stack([_without_blanks(run.extras[name]) for name in _SIDES])
    rolled = _rolled(t, sides)
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
    logged = {key: _without_blanks(values) for key, values in run.extras.items() if key not in _SIDES}
    return Segments(
        x=np.interp(middle, t[usable], run.x[usable]),
        y=np.interp(middle, t[usable], run.y[usable]),
        heading_rad=np.mod(np.interp(middle, t, heading), 2.0 * np.pi),
        energy_j=_between(energy),
        duration_s=duration,
        driven_m=_between(arc),
        heading_change_rad=_between(_summed(step)),
        turned_abs_rad=_between(_summed(np.abs(step))),
        gentle_turn_rad=np.stack(
            [_between(_summed(np.minimum(np.abs(step), limit * dt))) for limit in TURN_LIMITS_RADPS], axis=1
        ),
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


def flat_heightmap(runs: Sequence[Run], *, resolution_m: float = 1.0, margin_m: float = 3.0) -> Heightmap:
    """Return flat ground that covers all runs.

    Parameters
    ----------
    runs : sequence of Run
        At least one.
    resolution_m : float
        Side of a cell [m].
    margin_m : float
        Ground beyond the outermost positions [m].

    Returns
    -------
    Heightmap
        Of height 0.

    Raises
    ------
    InputError
        If there is no run.
    """
    if not runs:
        raise InputError("there is no run to make a map for")
    x, y = (np.concatenate([getattr(run, key)[np.isfinite(run.x)] for run in runs]) for key in ("x", "y"))
    west, south = np.floor(x.min() - margin_m), np.floor(y.min() - margin_m)
    cols = int(np.ceil((x.max() + margin_m - west) / resolution_m))
    rows = int(np.ceil((y.max() + margin_m - south) / resolution_m))
    frame = GridFrame(float(west), float(south) + rows * resolution_m, resolution_m, rows, cols)
    return Heightmap(np.zeros(frame.shape, np.float32), frame, "flat ground for odometry")


def _summed(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _without_blanks(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    rows = np.arange(values.size)
    return np.interp(rows, rows[known], values[known]) if known.any() else np.zeros(values.size)


def _rolled(t: FloatArray, sides: FloatArray) -> FloatArray:
    """What the wheels roll from each row to the next [m], (n - 1,): the mean of both sides, unsigned."""
    rolling = np.abs(sides).mean(axis=0)
    return np.asarray(0.5 * (rolling[1:] + rolling[:-1]) * np.diff(t))


def _long_intervals(t: FloatArray, still: NDArray[np.bool_], gap: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """True in intervals without a gap that are still for `STOP_S` or more."""
    stop = np.zeros(t.size, dtype=bool)
    begins = np.flatnonzero(still & (gap | ~np.concatenate([[False], still[:-1]])))
    ends = np.flatnonzero(still & (np.append(gap[1:], True) | ~np.append(still[1:], False)))
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        if t[last] - t[first] >= STOP_S:
            stop[first : last + 1] = True
    return stop
