"""The logged columns that residuals may depend on, and why others are refused: none may copy the measurement."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.residuals import Residuals

_MEASUREMENT = re.compile(
    r"^(left_|right_)?(voltage|current|power|energy|charge|amps?|volts?|watts?)(_|$)|_(a|v|wh|amps?|volts?)$"
)
"""A power of something else (`heater_w`) is no part of it; one of the drives is found by `_is_meter`."""
_COPY = 0.95
_LEAST_ROWS = 10
_SPIKE = 8.0  # times the median size


def refused_columns(residuals: Residuals, electric: Mapping[str, FloatArray]) -> dict[str, str]:
    """Return the logged columns on which no effect may depend.

    Result: why, by name of the column: parts of the measurement and copies of it, constants and copies of other
    columns.
    """
    moving = residuals.moving
    rows = residuals.features.take(moving)
    meters = {key: values[moving] for key, values in electric.items()}
    said = residuals.said[moving]
    expected = [rows.grade, said, said / rows.duration_s]
    refused: dict[str, str] = {}
    kept: dict[str, FloatArray] = {}
    for key, values in sorted(rows.columns.items()):
        known = np.isfinite(values)
        if key in ("pitch", "roll"):
            refused[key] = (
                "the robot's attitude, which the slope of the ground makes; the measured pitch is a base parameter"
            )
        elif _MEASUREMENT.search(key):
            refused[key] = "it is part of the measurement itself"
        elif known.mean() < 0.5:
            refused[key] = f"recorded on only {known.mean():.0%} of the segments"
        elif np.ptp(values[known]) <= 1e-9 * max(1.0, float(np.abs(values[known]).max())):
            refused[key] = f"constant ({values[known][0]:g})"
        elif copied := next((m for m, e in meters.items() if _alike(values, e, expected, rows)), None):
            refused[key] = f"a copy of the {copied}, which is part of the measurement itself"
        elif _is_meter(values, residuals.measured[moving], said, rows):
            refused[key] = "it follows the measured power, also where the model predicts otherwise: it is another meter"
        elif twin := next((k for k, v in kept.items() if _same(values, v)), None):
            refused[key] = f"identical to {twin}"
        else:
            kept[key] = values
    return refused


def _is_meter(values: FloatArray, measured: FloatArray, said: FloatArray, rows: Features) -> bool:
    """Whether a column reads the power or the energy: it follows what the model predicts of it and what it does not
    predict in the same proportion. A cause follows the second only.
    """
    known = np.isfinite(values)
    if known.sum() < _LEAST_ROWS or not said.any():
        return False
    run, since = rows.run[known], rows.since_s[known]
    column = _without_lines(values[known], run, since)
    for per in (np.ones_like(said), rows.duration_s):
        parts = [_without_lines((part / per)[known], run, since) for part in (said, measured - said)]
        x = np.stack(parts, axis=1)
        if min(part.std() for part in parts) < 1e-9 or column.std() < 1e-9:
            continue
        slopes = np.linalg.lstsq(x, column, rcond=None)[0]
        rest = column - x @ slopes
        explained = 1.0 - float(rest @ rest) / float(column @ column)
        if explained > 0.5 and slopes[1] != 0.0 and 0.5 < slopes[0] / slopes[1] < 2.0:
            return True
    return False


def _alike(values: FloatArray, electric: FloatArray, expected: Sequence[FloatArray], rows: Features) -> bool:
    """Whether a column follows a reading of the battery from segment to segment.

    Both may follow a slow course over the day (a voltage sinks while the air warms), so a straight line in time is
    subtracted in each run. Spikes are left out, since the reading has none. A column that follows one of `expected`
    more closely, which needs no meter, is no copy (a pitch on hills).
    """
    both = np.isfinite(values) & np.isfinite(electric)
    for _ in range(3):
        if both.sum() < _LEAST_ROWS:
            return False
        run, since = rows.run[both], rows.since_s[both]
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
    """Values without their straight line in time, fitted to each run."""
    count = np.maximum(np.bincount(run), 1)
    at, out = (v - (np.bincount(run, v) / count)[run] for v in (since, values))
    slope = np.bincount(run, at * out) / np.maximum(np.bincount(run, at * at), np.finfo(float).tiny)
    return out - slope[run] * at


def _same(a: FloatArray, b: FloatArray) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    return bool(both.any() and _likeness(a[both], b[both]) > 1.0 - 1e-9)
