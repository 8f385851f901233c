"""Logs without positions: wheel speeds are integrated into a track, so that the loop runs on a flat map of it.

A skid-steer slides in turns, so that it turns less than its wheels say: `track_m` is the effective distance between
the sides, not the measured one. Positions drift over minutes; on level ground only the last metre matters.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.runs.reader import Run, run_of
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.table import columns_there, read_table
from joulemap.model.runs.track import TURN_LIMITS_RADPS, find_stands
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

_SIDES = ("speed_left", "speed_right")
_OTHER_NAMES = {
    "time": "t",
    "velL": "speed_left",
    "velR": "speed_right",
    "curL": "current_left",
    "curR": "current_right",
}
"""Of columns in the logs of BorealTC (LaRocque et al., IROS 2024)."""

_LONGEST_GAP_S = 0.75
_STAND_S = 1.0
_STANDING_MPS = 0.02
_NUMBERED = re.compile(r"[\W_]*\d*$")


@dataclass(frozen=True)
class Odometry:
    """How logs without positions are read. track_m : distance of the sides as the robot turns [m]. terrain_from_name :
    a file's name says what ground it was driven on, where it has no such column. Raises InputError.
    """

    track_m: float
    terrain_from_name: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.track_m) and self.track_m > 0):
            raise InputError(f"the track must be positive, got {self.track_m} m", track_m=str(self.track_m))


def read_odometry(path: str | Path, odometry: Odometry, *, name: str | None = None) -> Run:
    """Read a log (CSV or Parquet) of wheel speeds as a run that starts at (0, 0) and heads north.

    Its columns: t [s], speed_left and speed_right [m/s], current or several current_* [A] whose magnitudes are summed
    (or the names of `_OTHER_NAMES`); optionally voltage [V] and any further one. name : default that of the file. The
    rules of `runs.reader` hold. Adds heading [deg] and speed [m/s]. Raises RunsError, naming the column that is
    missing.
    """
    path = Path(path)
    name = name or path.name
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RunsError(f"run {path}: {error}", path=str(path)) from error
    repairs: dict[str, int] = {}
    numbers, texts = read_table(content, name, repairs)
    numbers = {_OTHER_NAMES.get(key, key): values for key, values in numbers.items()}
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
    return run_of(numbers | {"x": x, "y": y} | motion, texts, name=name, repairs=repairs)


def terrain_in_name(name: str) -> str | None:
    """What a file's name says of the ground: snow_02.csv was driven on "snow"."""
    return _NUMBERED.sub("", Path(name).stem) or None


def integrate(
    t: FloatArray, left_mps: FloatArray, right_mps: FloatArray, *, track_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x, y [m] and heading [rad, clockwise from north, not wrapped] of a robot that starts at (0, 0) to the north.

    All (n,). Speeds hold as the mean of both ends of a step, and each step is an arc (exact at constant speeds); over
    gaps of more than 0.75 s and steps back in time nothing is driven.
    """
    dt = np.diff(t)
    dt = np.where((dt > 0) & (dt <= _LONGEST_GAP_S), dt, 0.0)
    ahead = 0.25 * (left_mps[1:] + left_mps[:-1] + right_mps[1:] + right_mps[:-1]) * dt
    turn = 0.5 * (left_mps[1:] + left_mps[:-1] - right_mps[1:] - right_mps[:-1]) * dt / track_m
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    chord = ahead * np.sinc(turn / (2.0 * np.pi))
    middle = heading[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    return x, y, heading


def cut_travel(run: Run, *, length_m: float = 1.0, charge: bool = False) -> Segments:
    """Segments by what the wheels roll, mean of both sides, so that turning on the spot counts too; of energy [J], or
    (`charge`) of charge [A s].

    `run` is one of `read_odometry`. driven_m is what the wheels rolled, heading_rad where the robot points in the
    middle; gaps and stands of a second or more divide a run, ends of pieces shorter than a segment are left out. Raises
    RunsError where the voltage is missing and `charge` is not asked for.
    """
    if run.voltage_v is None and not charge:
        raise RunsError(f"run {run.name}: no voltage was recorded; ask for charge [A s] instead", run=run.name)
    t = run.t
    sides = np.stack([_without_blanks(run.extras[name]) for name in _SIDES])
    rolling = np.abs(sides).mean(axis=0)
    gap = np.diff(t) > _LONGEST_GAP_S
    dt = np.where(gap, 0.0, np.diff(t))
    travel = _summed(0.5 * (rolling[1:] + rolling[:-1]) * dt)
    pieces = _pieces(t, rolling, gap)
    starts, ends, remainders = _ends(t, travel, pieces, length_m)
    piece = np.zeros(t.size, dtype=np.int64)
    for number, (first, last) in enumerate(pieces, start=1):
        piece[first : last + 1] = number
    heading = np.unwrap(np.radians(run.extras["heading"]))
    step = np.diff(heading)
    speed = sides.mean(axis=0)
    power = run.current_a if charge or run.voltage_v is None else run.current_a * run.voltage_v
    energy = _summed(0.5 * (power[1:] + power[:-1]) * dt)
    middle = (starts + ends) / 2
    row = np.clip(np.searchsorted(t, middle), 0, t.size - 1)

    def between(cumulated: FloatArray) -> FloatArray:
        return np.interp(ends, t, cumulated) - np.interp(starts, t, cumulated)

    def mean(values: FloatArray) -> FloatArray:
        return between(_summed(0.5 * (values[1:] + values[:-1]) * dt)) / np.maximum(ends - starts, 1e-9)

    usable = np.isfinite(run.x)
    logged = {key: _without_blanks(values) for key, values in run.extras.items() if key not in _SIDES}
    return Segments(
        x=np.interp(middle, t[usable], run.x[usable]),
        y=np.interp(middle, t[usable], run.y[usable]),
        heading_rad=np.mod(np.interp(middle, t, heading), 2.0 * np.pi),
        energy_j=between(energy),
        duration_s=ends - starts,
        driven_m=np.full(starts.size, length_m),
        heading_change_rad=between(heading),
        turned_abs_rad=between(_summed(np.abs(step))),
        gentle_turn_rad=np.stack(
            [between(_summed(np.minimum(np.abs(step), limit * dt))) for limit in TURN_LIMITS_RADPS], axis=1
        ),
        gained_m2ps2=between(_summed(np.maximum(np.diff(0.5 * speed**2), 0.0))),
        voltage_v=np.full(starts.size, np.nan) if run.voltage_v is None else mean(run.voltage_v),
        current_a=mean(run.current_a),
        ripple=np.ones(starts.size),
        t0=starts,
        run=np.zeros(starts.size, dtype=np.int64),
        runs=(run.name,),
        length_m=length_m,
        charge=charge,
        extras={key: mean(values) for key, values in logged.items()}
        | {"heading": np.degrees(np.interp(middle, t, heading)) % 360.0, "speed": mean(speed)},
        texts={key: words[row] for key, words in run.texts.items()},
        stands=find_stands(t, run.x, run.y, piece, t, power, rolling),
        left_out={"remainders": remainders} if remainders else {},
    )


def flat_heightmap(runs: Sequence[Run], *, resolution_m: float = 1.0, margin_m: float = 3.0) -> Heightmap:
    """Level ground under all tracks, with `margin_m` around. Raises InputError without a run."""
    if not runs:
        raise InputError("there is no run to lay a map under")
    x, y = (np.concatenate([getattr(run, key)[np.isfinite(run.x)] for run in runs]) for key in ("x", "y"))
    west, south = np.floor(x.min() - margin_m), np.floor(y.min() - margin_m)
    cols = int(np.ceil((x.max() + margin_m - west) / resolution_m))
    rows = int(np.ceil((y.max() + margin_m - south) / resolution_m))
    frame = GridFrame(float(west), float(south) + rows * resolution_m, resolution_m, rows, cols)
    return Heightmap(np.zeros(frame.shape, np.float32), frame, "level ground under odometry")


def _summed(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _without_blanks(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    rows = np.arange(values.size)
    return np.interp(rows, rows[known], values[known]) if known.any() else np.zeros(values.size)


def _pieces(t: FloatArray, rolling: FloatArray, gap: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first row, last row) of each stretch without a gap or a stand."""
    still = rolling < _STANDING_MPS
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    moving = np.ones(t.size, dtype=bool)
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        if t[after - 1] - t[first] >= _STAND_S:
            moving[first:after] = False
    fresh = np.concatenate([[True], gap | ~moving[:-1]]) & moving
    firsts = np.flatnonzero(fresh)
    lasts = np.flatnonzero(moving & np.concatenate([gap | ~moving[1:], [True]]))
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def _ends(
    t: FloatArray, travel: FloatArray, pieces: Sequence[tuple[int, int]], length_m: float
) -> tuple[FloatArray, FloatArray, int]:
    """Stamps at which segments start and end, and how many pieces end in less than a segment."""
    starts, ends = [np.empty(0)], [np.empty(0)]
    remainders = 0
    for first, last in pieces:
        count = int((travel[last] - travel[first]) / length_m + 1e-9)
        remainders += int(travel[last] - travel[first] > count * length_m + 1e-9)
        at = travel[first] + length_m * np.arange(count + 1)
        stamps = np.interp(at, travel[first : last + 1], t[first : last + 1])
        starts.append(stamps[:-1])
        ends.append(stamps[1:])
    return np.concatenate(starts), np.concatenate(ends), remainders
