"""The logged columns that residuals may depend on, and why others are refused: none may copy the measurement."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.drive import Drive
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

_OF_POSITION = frozenset({"heading", "gps_course", "gps_error", "speed", "gps_speed", "z", "lat", "lon"})
_MEASUREMENT = re.compile(r"^(voltage|current|power|energy|charge|amps?|volts?|watts?)(_|$)|_(a|v|w|wh|amps?|volts?)$")
_COPY = 0.95
_SPIKE = 8.0  # times the median size


def usable_columns(residuals: Residuals, electric: Mapping[str, FloatArray], refused: dict[str, str]) -> list[str]:
    """Return the logged columns that vary, copy no other column, and are no part of the measurement.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    electric : mapping
        Readings of the battery by name, (n,).
    refused : dict
        To which the reasons against all others are added, by name.

    Returns
    -------
    list of str
        Names of the columns.
    """
    drive, moving = residuals.drive, residuals.moving
    only = drive.take(moving)
    meters = {key: values[moving] for key, values in electric.items() if key != "ripple"}
    said = residuals.predicted[moving]
    expected = [only.grade, said, said / only.duration_s]
    kept: dict[str, FloatArray] = {}
    for key, every in sorted(drive.columns.items()):
        values = every[moving]
        known = np.isfinite(values)
        if key in _OF_POSITION:
            continue
        if _MEASUREMENT.search(key):
            refused[f"learned:{key}"] = "it is part of the measurement itself"
        elif known.mean() < 0.5:
            refused[f"learned:{key}"] = f"recorded on only {known.mean():.0%} of the segments"
        elif np.ptp(values[known]) <= 1e-9 * max(1.0, float(np.abs(values[known]).max())):
            refused[f"learned:{key}"] = f"constant ({values[known][0]:g})"
        elif copied := next((m for m, e in meters.items() if _alike(values, e, expected, only)), None):
            refused[f"learned:{key}"] = f"a copy of the {copied}, which is part of the measurement itself"
        elif twin := next((k for k, v in kept.items() if _same(values, v)), None):
            refused[f"learned:{key}"] = f"identical to {twin}"
        elif residuals.charge and _constant_in_runs(values, drive.run[moving]):
            refused[f"learned:{key}"] = "constant within every run, while the offset of each run is unknown too"
        else:
            kept[key] = values
    return list(kept)


def _alike(values: FloatArray, electric: FloatArray, expected: Sequence[FloatArray], drive: Drive) -> bool:
    """Whether a column follows a reading of the battery from segment to segment.

    Both may follow a slow course over the day (a voltage sinks while the air warms), so a straight line in time is
    subtracted in each run. Spikes are left out, since the reading has none. A column that follows one of `expected`
    more closely, which needs no meter, is no copy (a pitch on hills).
    """
    both = np.isfinite(values) & np.isfinite(electric)
    for _ in range(3):
        if both.sum() < 10:
            return False
        run, since = drive.run[both], drive.since_s[both]
        a, b, *others = (_without_lines(v[both], run, since) for v in (values, electric, *expected))
        near = np.all([np.abs(v) <= _SPIKE * np.median(np.abs(v)) for v in (a, b)], axis=0)
        both[both] = near
    if a[near].std() <= 1e-9 * max(1.0, float(np.abs(values[both]).max())):
        return False
    follows = _likeness(a[near], b[near])
    return follows > max(_COPY, *(_likeness(a[near], other[near]) for other in others))


def _likeness(a: FloatArray, b: FloatArray) -> float:
    """Magnitude of the correlation; 0 with what is constant."""
    return float(abs(np.corrcoef(a, b)[0, 1])) if min(a.std(), b.std()) > 1e-9 else 0.0


def _without_lines(values: FloatArray, run: NDArray[np.int64], since: FloatArray) -> FloatArray:
    out = values.copy()
    for k in np.unique(run):
        mine = run == k
        line = np.stack([np.ones(mine.sum()), since[mine] - since[mine].mean()], axis=1)
        out[mine] -= line @ np.linalg.lstsq(line, values[mine], rcond=None)[0]
    return out


def _same(a: FloatArray, b: FloatArray) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    return bool(both.any() and a[both].std() > 0 and abs(np.corrcoef(a[both], b[both])[0, 1]) > 1.0 - 1e-9)


def _constant_in_runs(values: FloatArray, run: NDArray[np.int64]) -> bool:
    known = np.isfinite(values)
    return all(np.ptp(values[mine]) < 1e-9 for k in np.unique(run) if (mine := known & (run == k)).any())
