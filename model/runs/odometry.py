"""Logs without positions: wheel speeds are integrated to a track.

A skid-steered robot slips in turns and turns less than its wheels indicate: `track_m` is the effective distance between
the sides, larger than the measured one. Positions drift within minutes; on flat ground only the last metre matters.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.ranges import TRACK_M
from joulemap.model.runs.reckoning import without_blanks
from joulemap.model.runs.rolling import rolled_between
from joulemap.model.runs.run import Run, rows_missing
from joulemap.model.runs.table import SIDES, columns_there
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

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


def with_track(
    numbers: dict[str, FloatArray], texts: dict[str, NDArray[np.str_]], odometry: Odometry, name: str
) -> None:
    """Add the track of wheel speeds, which starts at (0, 0) and heads north, with heading [deg] and speed [m/s].

    `numbers`, `texts` (n,): with t [s], speed_left and speed_right [m/s]; they are added to.
    """
    for column in ("t", *SIDES):
        if column not in numbers:
            raise RunsError.of_run(
                name, f"there is no column {column!r} of numbers{columns_there(numbers)}", column=column
            )
    left, right = (without_blanks(numbers[side]) for side in SIDES)
    x, y, heading = integrate(numbers["t"], left, right, track_m=odometry.track_m)
    numbers.pop("distance", None)
    numbers |= {"x": x, "y": y, "heading": np.degrees(heading) % 360.0, "speed": (left + right) / 2}
    terrain = terrain_in_name(name) if odometry.terrain_from_name else None
    if terrain is not None:
        texts.setdefault("terrain", np.full(x.size, terrain))


def terrain_in_name(name: str) -> str | None:
    """Return the class of ground that a file is named after.

    Result: such as `snow`; None where the name is a number only.
    """
    return _NUMBERED.sub("", Path(name).stem) or None


def integrate(
    t: FloatArray, left_mps: FloatArray, right_mps: FloatArray, *, track_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrate wheel speeds from (0, 0), heading north.

    `t` (n,): stamps [s]; `left_mps`, `right_mps` (n,): speeds of the sides [m/s]. Result (n,): x, y [m], and heading
    [rad], clockwise from north and not wrapped.

    Each step has the mean speeds of its two ends and is an arc, which is exact at constant speeds. Nothing is driven
    across missing rows (`joulemap.model.runs.run.rows_missing`) and steps back in time.
    """
    dt = np.diff(t)
    dt = np.where((dt > 0) & ~rows_missing(t, rolled_between(t, np.stack([left_mps, right_mps]))), dt, 0.0)
    ahead = 0.25 * (left_mps[1:] + left_mps[:-1] + right_mps[1:] + right_mps[:-1]) * dt
    turn = 0.5 * (left_mps[1:] + left_mps[:-1] - right_mps[1:] - right_mps[:-1]) * dt / track_m
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    chord = ahead * np.sinc(turn / (2.0 * np.pi))
    middle = heading[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    return x, y, heading


def flat_heightmap(runs: Sequence[Run], *, resolution_m: float = 1.0, margin_m: float = 3.0) -> Heightmap:
    """Return flat ground that covers all runs."""
    if not runs:
        raise InputError("there is no run to make a map for")
    x, y = (np.concatenate([getattr(run, key)[np.isfinite(run.x)] for run in runs]) for key in ("x", "y"))
    west, south = np.floor(x.min() - margin_m), np.floor(y.min() - margin_m)
    cols = int(np.ceil((x.max() + margin_m - west) / resolution_m))
    rows = int(np.ceil((y.max() + margin_m - south) / resolution_m))
    frame = GridFrame(float(west), float(south) + rows * resolution_m, resolution_m, rows, cols)
    return Heightmap(np.zeros(frame.shape, np.float32), frame, "flat ground for odometry")
