"""How much of the error on DRIVE is the meter's? `python -m tests.coverage.meter`.

The currents are read once a second there, and most metres take less. Run by run, each side's current at its readings is
fitted to both wheels' speeds and their rates, and to the rate of turning: to more than a plan knows. That current is
read once a second again, from many moments on. How far the energy of a metre is from its mean over these moments is
what no model of the drive can know: at least that of the fitted current, and at most, as if all were chance, with what
the fit leaves at the readings drawn at random.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from joulemap.model.runs.features import FloatArray
from joulemap.model.runs.held_readings import between_readings
from joulemap.model.runs.track import integral
from tests.coverage.real import drive, real_folder

_SIDES = ("left", "right")
_VOLTAGE = 48.0
_MOMENTS = np.linspace(0.0, 0.95, 20)
_LEAST_S = 0.8
"""Readings that stay for longer are those of the log's period, which is a second."""
_LARGEST_J = 2e4  # one metre took 38.5 kJ: the robot turned on the spot for 16 s


def of_motion(log: pd.DataFrame) -> FloatArray:
    """What the currents are fitted to, (n, k)."""
    t = log["t"].to_numpy()
    left, right = (between_readings(t, log[f"wheel_{side}_rad_s"].to_numpy())[0] for side in _SIDES)
    known = np.flatnonzero(np.diff(log["heading"], prepend=np.nan) != 0.0)
    heading = np.unwrap(np.radians(log["heading"].to_numpy()[known]))
    turning = np.abs(np.interp(t + 0.3, t[known], heading) - np.interp(t - 0.3, t[known], heading)) / 0.6
    speeding = [np.gradient(speed, t) * np.sign(speed) for speed in (left, right)]
    speeds = [np.abs(left), np.abs(right), left**2, right**2, left * right, np.abs(left - right)]
    return np.column_stack([np.ones(t.size), *speeds, np.sign(left * right), turning, *speeding])


def unknown_j(file: Path, start_s: FloatArray, duration_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """How far the energy of each metre is from its mean over the moments of reading, (2, moments, n) [J]: of the fitted
    current, and with what the fit leaves.
    """
    log = pd.read_csv(file)
    t, motion = log["t"].to_numpy(), of_motion(log)
    powers, rest = [], []
    for side in _SIDES:
        current = log[f"{side}_current"].to_numpy()
        first = np.flatnonzero(np.diff(current, prepend=np.nan) != 0.0)
        first = first[np.diff(np.append(t[first], t[-1])) > _LEAST_S]
        fit = np.linalg.lstsq(motion[first], current[first], rcond=None)[0]
        powers.append(_VOLTAGE * motion @ fit)
        rest.append(_VOLTAGE * (current[first] - motion[first] @ fit))

    def _read(begins_s: float, *, whole: bool) -> FloatArray:
        at = np.arange(t[0] + begins_s, t[-1], 1.0)
        both = zip(powers, rest, strict=True)
        power = np.interp(t, at, sum(np.interp(at, t, side) + whole * rng.choice(left, at.size) for side, left in both))
        return integral(t, power, start_s + duration_s) - integral(t, power, start_s)

    read = np.array([[_read(moment, whole=whole) for moment in _MOMENTS] for whole in (False, True)])
    return read - read[0].mean(axis=0)


def main() -> None:
    folder = real_folder()
    if folder is None:
        raise SystemExit("there are no real runs here (set JOULEMAP_REAL_DATA to their folder)")
    rng = np.random.default_rng(0)
    segments = drive(folder)[0].segments
    print(f"{np.mean(segments.duration_s < 1.0):.0%} of {len(segments)} metres take less than a second")
    every = []
    for k, name in enumerate(segments.runs):
        mine = (segments.run == k) & (segments.energy_j < _LARGEST_J)
        found = unknown_j(folder / "drive" / name, segments.t0[mine], segments.duration_s[mine], rng)
        every.append(found)
        print(f"{name}: {_words(found)}")
    print(f"all runs: {_words(np.concatenate(every, axis=2))}")


def _words(found: FloatArray) -> str:
    least, most = np.sqrt(np.mean(found**2, axis=(1, 2)))
    return f"{least:.0f} to {most:.0f} J root mean square"


if __name__ == "__main__":
    main()
