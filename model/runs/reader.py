"""Measured runs: read a log (CSV or Parquet), repair what loggers break by stated rules, and count every repair.

Rules, in this order (the key in `Run.repairs` in brackets; a key is there only when its count is not zero):

1. A last line that breaks off is dropped [truncated_rows]. Any other line of the wrong length is an error.
2. Rows without a time are dropped [rows_without_time].
3. Of the stamps the longest strictly increasing sequence is kept; a row with the stamp of a kept one is dropped as
   repeated [duplicate_stamps], any other as out of order [backward_stamps]. More than a fifth out of order is an error.
4. Fixes with a gps_error above the larger of 5 cm and four times its median are not used [bad_fixes]; a gps_error of
   exactly 0 means "not reported". Neither are blank fixes [blank_fixes]; a fix that is written again in the rows after
   it because the receiver is slower than the log, for up to 1.5 s [held_fixes]; and, of what is left, stretches of up
   to 5 s (2.5 s at an end) that the robot can only have reached by a jump [position_jumps]. A jump to where the log
   then stays is kept as a break [position_breaks]: no segment spans it.
5. Voltage and current further from the median of the eleven samples around than six times their spread and a quarter
   (voltage) or once (current) of the run's median are spikes [voltage_spikes, current_spikes]; they and blanks
   [blank_voltage, blank_current] are replaced by straight lines in time.
6. A single current that is mostly negative counts discharge as negative and is turned round [current_sign_flipped].

Dropped rows and long blanks leave gaps, which `segments` does not bridge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from joulemap.model.errors import RunsError
from joulemap.model.runs.table import LEAST_ROWS, columns_there, count_repair, read_table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LONGEST_JUMP_S = 5.0
_LEAST_GPS_LIMIT_M = 0.05
_LONGEST_HOLD_S = 1.5


@dataclass(frozen=True)
class Run:
    """One measured run, cleaned. All arrays are (n,), stamps strictly increasing.

    t [s]; x, y [m] in the heightmap's CRS, NaN where the fix is not usable; current_a [A] > 0 discharging; voltage_v
    [V] or None when it was not recorded. extras : further numeric columns as recorded (NaN is blank); texts : text
    columns. breaks : True where the position jumped between this row and the one before. repairs : rule -> count.
    """

    name: str
    t: FloatArray
    x: FloatArray
    y: FloatArray
    current_a: FloatArray
    voltage_v: FloatArray | None
    extras: dict[str, FloatArray] = field(default_factory=dict)
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    breaks: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    repairs: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.breaks.size != self.t.size:
            object.__setattr__(self, "breaks", np.zeros(self.t.size, dtype=bool))

    def __len__(self) -> int:
        return int(self.t.size)


def read_run(path: str | Path, *, name: str | None = None, crs: str | None = None) -> Run:
    """Read a run in CSV or Parquet: `t`, `x`,`y` (or `lat`,`lon` with the map's `crs`), `current` or `current_*`, and
    optionally `voltage` and any further column. name : default that of the file. Raises RunsError naming file, column
    and row.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RunsError(f"run {path}: {error}", path=str(path)) from error
    return parse_run(content, name=name or path.name, crs=crs)


def parse_run(content: str | bytes, *, name: str, crs: str | None = None) -> Run:
    """`read_run` of a text in CSV, or of the bytes of a file, already read."""
    repairs: dict[str, int] = {}
    numbers, texts = read_table(content, name, repairs)
    return run_of(numbers, texts, name=name, crs=crs, repairs=repairs)


def run_of(
    numbers: dict[str, FloatArray],
    texts: dict[str, NDArray[np.str_]],
    *,
    name: str,
    crs: str | None = None,
    repairs: dict[str, int] | None = None,
) -> Run:
    """`read_run` of columns already read; repairs : what reading them has counted so far."""
    repairs = {} if repairs is None else repairs
    if "t" not in numbers:
        raise RunsError(f"run {name}: there is no column 't' (seconds){columns_there(numbers)}", run=name, column="t")
    rows = _ordered_rows(numbers["t"], name, repairs)
    numbers = {key: values[rows] for key, values in numbers.items()}
    texts = {key: values[rows] for key, values in texts.items()}
    t = numbers.pop("t")
    current, voltage = _electric(numbers, t, name, repairs)
    x, y = _position(numbers, name, crs)
    x, y, breaks = _usable_fixes(t, x, y, numbers.get("gps_error"), repairs)
    if np.isfinite(x).sum() < 2:
        raise RunsError(
            f"run {name}: no usable position is left after the rules for bad fixes", run=name, repairs=repairs
        )
    return Run(name, t, x, y, current, voltage, numbers, texts, breaks, repairs)


def _ordered_rows(t: FloatArray, name: str, repairs: dict[str, int]) -> NDArray[np.int64]:
    known = np.flatnonzero(np.isfinite(t))
    count_repair(repairs, "rows_without_time", t.size - known.size)
    if known.size < LEAST_ROWS:
        raise RunsError(f"run {name}, column 't': only {known.size} rows have a time", run=name, column="t")
    kept = known[_longest_increasing(t[known])]
    again = int(np.isin(t[np.setdiff1d(known, kept)], t[kept]).sum())
    backward = known.size - kept.size - again
    count_repair(repairs, "duplicate_stamps", again)
    count_repair(repairs, "backward_stamps", backward)
    if backward > 0.2 * known.size:
        row = int(known[np.flatnonzero(np.diff(t[known]) < 0)[0] + 1]) + 2
        raise RunsError(
            f"run {name}, column 't', row {row}: the clock was set back; {backward} of {known.size} rows are out "
            "of order. Split the file there",
            run=name,
            column="t",
            row=row,
        )
    return kept


def _electric(
    numbers: dict[str, FloatArray], t: FloatArray, name: str, repairs: dict[str, int]
) -> tuple[FloatArray, FloatArray | None]:
    """Current [A] and voltage [V] without spikes and blanks; takes their columns out of `numbers`."""
    parts = sorted(key for key in numbers if key.startswith("current_"))
    if "current" in numbers:
        current = numbers.pop("current")
        if np.isfinite(current).any() and np.nanmedian(current) < 0:
            current = -current
            count_repair(repairs, "current_sign_flipped", 1)
    elif parts:
        current = np.sum([np.abs(numbers.pop(key)) for key in parts], axis=0)
    else:
        raise RunsError(
            f"run {name}: there is neither a column 'current' nor any 'current_*'{columns_there(numbers)}",
            run=name,
            column="current",
        )
    voltage = numbers.pop("voltage", None)
    if voltage is not None and not np.isfinite(voltage).any():
        voltage = None
    current = _without_spikes(t, current, 1.0, "current", name, repairs)
    if voltage is not None:
        voltage = _without_spikes(t, voltage, 0.25, "voltage", name, repairs)
    return current, voltage


def _without_spikes(
    t: FloatArray, values: FloatArray, share: float, key: str, name: str, repairs: dict[str, int]
) -> FloatArray:
    blank = ~np.isfinite(values)
    if blank.mean() > 0.5:
        raise RunsError(
            f"run {name}, column {key!r}: {int(blank.sum())} of {t.size} cells are blank", run=name, column=key
        )
    count_repair(repairs, f"blank_{key}", int(blank.sum()))
    filled = np.interp(t, t[~blank], values[~blank])
    middle = median_filter(filled, 11, mode="nearest")
    away = np.abs(filled - middle)
    spread = 1.4826 * median_filter(away, 11, mode="nearest")
    spikes = away > 6.0 * spread + share * abs(float(np.median(filled)))
    count_repair(repairs, f"{key}_spikes", int((spikes & ~blank).sum()))
    good = ~(spikes | blank)
    return np.interp(t, t[good], values[good])


def _position(numbers: dict[str, FloatArray], name: str, crs: str | None) -> tuple[FloatArray, FloatArray]:
    if "x" in numbers and "y" in numbers:
        return numbers.pop("x"), numbers.pop("y")
    if "lat" not in numbers or "lon" not in numbers:
        raise RunsError(
            f"run {name}: there is neither 'x' and 'y' nor 'lat' and 'lon'{columns_there(numbers)}",
            run=name,
            column="x",
        )
    if crs is None:
        raise RunsError(f"run {name}: 'lat' and 'lon' need the heightmap's CRS", run=name, column="lat")
    from rasterio.errors import CRSError
    from rasterio.warp import transform

    lat, lon = numbers["lat"], numbers["lon"]
    known = np.isfinite(lat) & np.isfinite(lon)
    x = np.full(lat.size, np.nan)
    y = np.full(lat.size, np.nan)
    try:
        east, north = transform("EPSG:4326", crs, lon[known].tolist(), lat[known].tolist())
    except CRSError as error:
        raise RunsError(f"run {name}: the CRS {crs!r} is not known: {error}", run=name, crs=crs) from error
    x[known], y[known] = east, north
    return np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan)


def _usable_fixes(
    t: FloatArray, x: FloatArray, y: FloatArray, gps_error: FloatArray | None, repairs: dict[str, int]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Positions with NaN where a fix is not to be used, and where the track breaks."""
    good = np.isfinite(x) & np.isfinite(y)
    count_repair(repairs, "blank_fixes", int((~good).sum()))
    if gps_error is not None and (gps_error > 0).any():
        limit = max(_LEAST_GPS_LIMIT_M, 4.0 * float(np.median(gps_error[gps_error > 0])))
        bad = good & (gps_error > limit)
        count_repair(repairs, "bad_fixes", int(bad.sum()))
        good &= ~bad
    index = np.flatnonzero(good)
    held = _held(t[index], x[index], y[index], _LONGEST_HOLD_S)
    count_repair(repairs, "held_fixes", int(held.sum()))
    good[index[held]] = False
    index = index[~held]
    breaks = np.zeros(t.size, dtype=bool)
    if index.size > LEAST_ROWS:
        reach = _reach(t[index], x[index], y[index])
        verdict = _follow(t[index], x[index], y[index], *reach, _LONGEST_JUMP_S)
        count_repair(repairs, "position_jumps", int((verdict == 1).sum()))
        count_repair(repairs, "position_breaks", int((verdict == 2).sum()))
        good[index[verdict == 1]] = False
        breaks[index[verdict == 2]] = True
    return np.where(good, x, np.nan), np.where(good, y, np.nan), breaks


def _reach(t: FloatArray, x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """(speed [m/s], slack [m]): nobody gets further than speed * dt + slack between two fixes of this run."""
    step = np.hypot(np.diff(x), np.diff(y))
    fresh = step > 0
    if not fresh.any():
        return 1.0, 0.15
    step, interval = step[fresh], float(np.median(np.diff(t)[fresh]))
    lag = max(round(1.0 / max(interval, 1e-3)), 1)
    far = np.hypot(x[lag:] - x[:-lag], y[lag:] - y[:-lag]) / np.maximum(t[lag:] - t[:-lag], 1e-3)
    speed = 2.0 * float(np.quantile(far, 0.9)) if far.size else 1.0
    slack = 0.15 + 8.0 * 1.4826 * float(np.median(np.abs(step - np.median(step))))
    return speed, slack


@njit(cache=True)
def _held(t: FloatArray, x: FloatArray, y: FloatArray, longest_s: float) -> BoolArray:
    """True for a fix that repeats the one before exactly, in stretches of up to `longest_s`; longer ones stand."""
    n = t.size
    held = np.zeros(n, dtype=np.bool_)
    k = 0
    while k < n:
        j = k + 1
        while j < n and x[j] == x[k] and y[j] == y[k]:
            j += 1
        if t[j - 1] - t[k] <= longest_s:
            held[k + 1 : j] = True
        k = j
    return held


@njit(cache=True)
def _follow(
    t: FloatArray, x: FloatArray, y: FloatArray, speed: float, slack: float, longest_s: float
) -> NDArray[np.int64]:
    """Per fix: 0 kept, 1 part of a stretch reached by a jump, 2 first after a break. All (n,).

    The track is divided wherever a step is impossible. Of all chains of stretches the one that keeps the most seconds
    wins, where going on from one stretch to another that it cannot reach costs half of `longest_s`.
    """
    n = t.size
    verdict = np.zeros(n, dtype=np.int64)
    starts = np.empty(n + 1, dtype=np.int64)
    starts[0] = 0
    pieces = 1
    for k in range(1, n):
        if math.hypot(x[k] - x[k - 1], y[k] - y[k - 1]) > speed * (t[k] - t[k - 1]) + slack:
            starts[pieces] = k
            pieces += 1
    starts[pieces] = n
    usual = (t[n - 1] - t[0]) / max(n - 1, 1)
    value = np.zeros(pieces)
    before = np.full(pieces, -1, dtype=np.int64)
    jumped = np.zeros(pieces, dtype=np.bool_)
    for p in range(pieces):
        here = starts[p]
        best = 0.0
        for q in range(max(p - 300, 0), p):
            end = starts[q + 1] - 1
            apart = math.hypot(x[here] - x[end], y[here] - y[end]) > speed * (t[here] - t[end]) + slack
            worth = value[q] - (0.5 * longest_s if apart else 0.0)
            if worth > best:
                best = worth
                before[p] = q
                jumped[p] = apart
        value[p] = best + t[starts[p + 1] - 1] - t[here] + usual
    verdict[:] = 1
    p = int(np.argmax(value))
    while p >= 0:
        verdict[starts[p] : starts[p + 1]] = 0
        if jumped[p]:
            verdict[starts[p]] = 2
        p = before[p]
    return verdict


@njit(cache=True)
def _longest_increasing(t: FloatArray) -> NDArray[np.int64]:
    """Positions of a longest strictly increasing subsequence of t (n,), the first of equal stamps first."""
    n = t.size
    tails = np.empty(n, dtype=np.int64)  # tails[l]: where the best sequence of length l + 1 ends
    before = np.empty(n, dtype=np.int64)
    length = 0
    for k in range(n):
        low, high = 0, length
        while low < high:
            middle = (low + high) // 2
            if t[tails[middle]] < t[k]:
                low = middle + 1
            else:
                high = middle
        before[k] = tails[low - 1] if low > 0 else -1
        if low == length or t[k] < t[tails[low]]:
            tails[low] = k
        length = max(length, low + 1)
    out = np.empty(length, dtype=np.int64)
    k = tails[length - 1]
    for place in range(length - 1, -1, -1):
        out[place] = k
        k = before[k]
    return out
