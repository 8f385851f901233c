"""Logs without positions: wheel speeds are integrated into a track, so that the loop runs on a flat map of it.

A skid-steer slides in turns, so that it turns less than its wheels say: `track_m` is the effective distance between
the sides, not the measured one. Positions drift over minutes; on level ground only the last metre matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from model.errors import InputError, RunsError
from model.frames import GridFrame
from model.loop.runs import Run, run_of
from model.loop.segments import Segments
from model.loop.table import read_table
from model.loop.track import TURN_LIMITS_RADPS
from model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

HUSKY_TRACK_M = 1.07
"""Effective track of a Clearpath Husky A200: wheel_separation 0.571 m times wheel_separation_multiplier 1.875.
Source: husky_control/config/control.yaml of the robot's ROS packages."""

_LONGEST_GAP_S = 0.75
_STAND_S = 1.0
_STANDING_MPS = 0.02


@dataclass(frozen=True)
class OdometryColumns:
    """Names in the log: time [s], speed of each side's wheels [m/s], currents [A] whose magnitudes are summed."""

    time: str = "time"
    left: str = "velL"
    right: str = "velR"
    currents: tuple[str, ...] = ("curL", "curR")


def read_odometry(
    path: str | Path, *, track_m: float = HUSKY_TRACK_M, terrain: str | None = None,
    columns: OdometryColumns | None = None,
) -> Run:  # fmt: skip
    """Read a log (CSV or Parquet) of wheel speeds as a run that starts at (0, 0) and heads north.

    terrain : what the ground is called, for a log without such a column. The rules of `model.loop.runs` hold. Adds the
    columns heading [deg], speed, speed_left and speed_right [m/s]. Raises RunsError, naming the column that is missing.
    """
    path = Path(path)
    if not track_m > 0:
        raise InputError(f"the track must be positive, got {track_m} m", track_m=str(track_m))
    wanted = columns or OdometryColumns()
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RunsError(f"run {path}: {error}", path=str(path)) from error
    repairs: dict[str, int] = {}
    numbers, texts = read_table(content, path.name, repairs)
    for column in (wanted.time, wanted.left, wanted.right, *wanted.currents):
        if column not in numbers:
            raise RunsError(f"run {path.name}: there is no column {column!r} of numbers", run=path.name, column=column)
    t = numbers.pop(wanted.time)
    left, right = (_without_blanks(numbers.pop(name)) for name in (wanted.left, wanted.right))
    x, y, heading = integrate(t, left, right, track_m=track_m)
    currents = {f"current_{k}": numbers.pop(name) for k, name in enumerate(wanted.currents)}
    motion = {"heading": np.degrees(heading) % 360.0, "speed": (left + right) / 2}
    sides = {"speed_left": left, "speed_right": right}
    if terrain is not None and "terrain" not in texts:
        texts["terrain"] = np.full(t.size, terrain)
    every = {"t": t, "x": x, "y": y, **numbers, **currents, **motion, **sides}
    return run_of(every, texts, name=path.name, repairs=repairs)


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


def cut_travel(run: Run, *, length_m: float = 1.0) -> Segments:
    """Segments of charge [A s] by what the wheels roll, mean of both sides, so that turning on the spot counts too.

    `run` is one of `read_odometry`. driven_m is what the wheels rolled, heading_rad where the robot points in the
    middle; gaps and stands of a second or more divide a run, ends of pieces shorter than a segment are left out.
    """
    t = run.t
    sides = np.stack([_without_blanks(run.extras[name]) for name in ("speed_left", "speed_right")])
    rolling = np.abs(sides).mean(axis=0)
    gap = np.diff(t) > _LONGEST_GAP_S
    dt = np.where(gap, 0.0, np.diff(t))
    travel = _summed(0.5 * (rolling[1:] + rolling[:-1]) * dt)
    starts, ends, remainders = _ends(t, travel, _pieces(t, rolling, gap), length_m)
    heading = np.unwrap(np.radians(run.extras["heading"]))
    step = np.diff(heading)
    speed = sides.mean(axis=0)
    charge = _summed(0.5 * (run.current_a[1:] + run.current_a[:-1]) * dt)
    middle = (starts + ends) / 2
    row = np.clip(np.searchsorted(t, middle), 0, t.size - 1)

    def between(cumulated: FloatArray) -> FloatArray:
        return np.interp(ends, t, cumulated) - np.interp(starts, t, cumulated)

    def mean(values: FloatArray) -> FloatArray:
        return between(_summed(0.5 * (values[1:] + values[:-1]) * dt)) / np.maximum(ends - starts, 1e-9)

    usable = np.isfinite(run.x)
    return Segments(
        x=np.interp(middle, t[usable], run.x[usable]),
        y=np.interp(middle, t[usable], run.y[usable]),
        heading_rad=np.mod(np.interp(middle, t, heading), 2.0 * np.pi),
        energy_j=between(charge),
        duration_s=ends - starts,
        driven_m=np.full(starts.size, length_m),
        heading_change_rad=between(heading),
        turned_abs_rad=between(_summed(np.abs(step))),
        gentle_turn_rad=np.stack(
            [between(_summed(np.minimum(np.abs(step), limit * dt))) for limit in TURN_LIMITS_RADPS], axis=1
        ),
        gained_m2ps2=between(_summed(np.maximum(np.diff(0.5 * speed**2), 0.0))),
        voltage_v=np.full(starts.size, np.nan),
        current_a=mean(run.current_a),
        ripple=np.ones(starts.size),
        t0=starts,
        run=np.zeros(starts.size, dtype=np.int64),
        runs=(run.name,),
        length_m=length_m,
        charge=True,
        extras={"heading": np.degrees(np.interp(middle, t, heading)) % 360.0, "speed": mean(speed)},
        texts={key: words[row] for key, words in run.texts.items()},
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
