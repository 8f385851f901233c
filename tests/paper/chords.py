"""The paper's segments: chords, of which both ends are exactly 1 m apart in the horizontal plane.

What a chord cannot describe is left out, and counted in `Segments.left_out`: gaps, stops, remainders and fast, as
joulemap's own segments, and bent, whose track is much longer than the chord; slow, which took much longer than usual in
their run; not_positive, whose measured energy is not above zero.

Reference: Wei & Isler 2022, section V.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import heading_of
from joulemap.model.robot import Robot
from joulemap.model.runs.arcs import STILL_M
from joulemap.model.runs.cutting import CARRIED, segments_of
from joulemap.model.runs.electric import Currents
from joulemap.model.runs.files import read_alike
from joulemap.model.runs.headings import Velocity, headings
from joulemap.model.runs.reader import Run, read_run
from joulemap.model.runs.run import STOP_S
from joulemap.model.runs.segments import Segments, concatenate_segments, driven_only
from joulemap.model.runs.smoothing import SMOOTHING_S, position_noise, smooth
from joulemap.model.runs.table import add_count
from joulemap.model.runs.track import integral, track_speeds, turns_between

FloatArray = NDArray[np.float64]

LENGTH_M = 1.0
# Settings that the paper does not state.
_LONGEST_GAP_S = 0.75  # or two and a half of the run's usual intervals between fixes
_STATIONARY_S = 1.0
_STANDING = 0.15  # of the usual speed
_BENT = 1.2  # a track longer than so many lengths
_SLOW = 3.0  # a duration longer than so many of the usual ones


def read_chords(files: Sequence[Path], robot: Robot, *, crs: str | None) -> Segments:
    """Read runs and cut them into chords, in joules. A run without a voltage counts with the nominal one."""

    def _read(file: Path, name: str, how: Currents) -> Run:
        return read_run(file, name=name, crs=crs, currents=how)

    parts = []
    for run in read_alike(files, [_read] * len(files), "auto"):
        cut = chords_of(run, charge=not run.has_energy, max_speed_mps=CARRIED * robot.speed_mps)
        parts.append(cut if run.has_energy else replace(cut, energy_j=cut.energy_j * robot.nominal_voltage_v))
    return driven_only(concatenate_segments([replace(part, charge=False) for part in parts]))


def chords_of(run: Run, *, charge: bool = False, max_speed_mps: float = math.inf) -> Segments:
    """Cut a run into chords. `charge`: integrate the current alone [A s], for logs without a voltage."""
    left_out: dict[str, int] = {}
    good = np.flatnonzero(np.isfinite(run.x) & np.isfinite(run.y))
    t, x, y = run.t[good], run.x[good], run.y[good]
    fresh = (np.diff(x) != 0) | (np.diff(y) != 0)
    interval = float(np.median(np.diff(t)[fresh])) if fresh.any() else 0.0
    longest_gap = max(_LONGEST_GAP_S, 2.5 * interval)
    gap = np.concatenate([[True], (np.diff(t) > longest_gap) | run.breaks[good][1:]])
    add_count(left_out, "gaps", int(gap.sum()) - 1)
    noise = position_noise(x, y, fresh)
    smoothing_s = max(SMOOTHING_S, interval)
    x, y, vx, vy = smooth(t, x, y, np.cumsum(gap), smoothing_s)
    speed = np.hypot(vx, vy)
    own = speed[(speed > 0.0) & (speed <= max_speed_mps)]
    usual = float(np.median(own[own > 0.25 * np.quantile(own, 0.9)])) if own.size else 0.0
    piece, stops = _pieces(t, speed, gap, _STANDING * usual, _STATIONARY_S)
    add_count(left_out, "stops", stops)
    ends, remainders = _ends_of_chords(x, y, piece, LENGTH_M)  # (n, 2) fractional positions of p and q
    add_count(left_out, "remainders", remainders)
    station = np.arange(t.size, dtype=np.float64)

    def _at(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.interp(ends[:, 0], station, values), np.interp(ends[:, 1], station, values)

    def _between(steps: FloatArray) -> FloatArray:
        first, last = _at(np.cumsum(steps))
        return last - first

    (px, qx), (py, qy), (pt, qt) = _at(x), _at(y), _at(t)
    driven = _between(np.concatenate([[0.0], np.hypot(np.diff(x), np.diff(y))]))
    standing = (speed < STILL_M / STOP_S) & ~gap
    pointed = headings(run, good, gap, Velocity(vx, vy, noise, smoothing_s), ~standing)
    turned, turned_abs = turns_between(pointed.smoothed.value, ends)
    half_square = 0.5 * track_speeds(run, good, np.cumsum(gap), interval, speed) ** 2
    rises = np.where(gap, 0.0, np.maximum(np.diff(half_square, prepend=0.0), 0.0))
    kinetic_p, kinetic_q = _at(half_square)
    power = run.drawn(charge=charge)
    energy = integral(run.t, power, qt) - integral(run.t, power, pt)
    columns = {
        "x": (px + qx) / 2,
        "y": (py + qy) / 2,
        "heading_rad": heading_of(qx - px, qy - py),
        "energy_j": energy,
        "duration_s": qt - pt,
        "driven_m": driven,
        "heading_change_rad": turned,
        "turn_sd_rad": pointed.turn_sd(ends),
        "t0": pt,
        "turned_abs_rad": turned_abs,
        "gained_m2ps2": _between(rises),
        "kinetic_m2ps2": kinetic_q - kinetic_p,
        "standing_s": _between(np.where(standing, np.diff(t, prepend=t[0]), 0.0)),
    }
    bent = driven > _BENT * LENGTH_M
    slow = ~bent & ((qt - pt) * usual > _SLOW * LENGTH_M)
    dead = ~bent & ~slow & ~(energy > 0)
    fast = ~bent & ~slow & ~dead & (driven > max_speed_mps * (qt - pt))
    for key, mask in (("bent", bent), ("slow", slow), ("not_positive", dead), ("fast", fast)):
        add_count(left_out, key, int(mask.sum()))
    return segments_of(
        run,
        columns,
        np.searchsorted(run.t, pt),
        np.searchsorted(run.t, qt, side="right"),
        (pt + qt) / 2,
        ~(bent | slow | dead | fast),
        np.ones(len(run), dtype=bool),
        left_out_m={},
        length_m=LENGTH_M,
        charge=charge,
        of_motors=charge and run.of_motors,
        left_out=left_out,
    )


@njit(cache=True)
def _pieces(
    t: FloatArray, speed: FloatArray, gap: NDArray[np.bool_], standing_mps: float, standing_s: float
) -> tuple[NDArray[np.int64], int]:
    """Divide a track at gaps and stationary intervals.

    `t`, `speed` (n,): stamps [s] and speeds [m/s]; `gap` (n,): True where a gap lies before the sample. Result: number
    of the piece of each sample, (n,), 0 while stationary; and the number of stationary intervals.
    """
    n = t.size
    piece = np.zeros(n, dtype=np.int64)
    now = 0
    stops = 0
    fresh = True
    k = 0
    while k < n:
        fresh = fresh or gap[k]
        if speed[k] < standing_mps:
            j = k
            while j + 1 < n and speed[j + 1] < standing_mps and not gap[j + 1]:
                j += 1
            if t[j] - t[k] >= standing_s:
                stops += 1
                fresh = True
                k = j + 1
                continue
        if fresh:
            now += 1
            fresh = False
        piece[k] = now
        k += 1
    return piece, stops


@njit(cache=True)
def _ends_of_chords(x: FloatArray, y: FloatArray, piece: NDArray[np.int64], length: float) -> tuple[FloatArray, int]:
    """Cut a track into chords of equal length, one after the other within each piece.

    `x`, `y` (n,): positions [m]; `piece` (n,): number of the piece, 0 is not cut; `length`: of a chord, in a straight
    line [m]. Result: fractional positions of both ends, (chords, 2); and how many pieces end in a remainder.
    """
    n = x.size
    ends = np.empty((n + 1, 2))
    count = 0
    remainders = 0
    k = 0
    while k < n:
        if piece[k] == 0:
            k += 1
            continue
        here = piece[k]
        start = float(k)
        px, py = x[k], y[k]
        j = k + 1
        while j < n and piece[j] == here:
            if math.hypot(x[j] - px, y[j] - py) < length:
                j += 1
                continue
            ax, ay = x[j - 1] - px, y[j - 1] - py
            f0 = start - (j - 1) if start > j - 1 else 0.0
            dx, dy = x[j] - x[j - 1], y[j] - y[j - 1]
            a = dx * dx + dy * dy  # |a + f d| = length, the later root
            b = ax * dx + ay * dy
            c = ax * ax + ay * ay - length * length
            f = min(max((-b + math.sqrt(max(b * b - a * c, 0.0))) / a, f0), 1.0)
            end = j - 1 + f
            ends[count, 0] = start
            ends[count, 1] = end
            count += 1
            if count == ends.shape[0]:
                grown = np.empty((2 * count, 2))
                grown[:count] = ends
                ends = grown
            start = end
            px, py = x[j - 1] + f * dx, y[j - 1] + f * dy
        if start < j - 1:
            remainders += 1
        k = j
    return ends[:count].copy(), remainders
