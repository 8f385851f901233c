"""Measured runs: read a log of any format, repair the usual faults of loggers by stated rules, count every repair.

Rules, in this order. Their keys in `Run.repairs` are given in brackets; a key is there only if its count is not zero:

1. A last line that breaks off is dropped [truncated_rows]. Other lines are made as long as the header [ragged_rows].
   Cells that are no numbers [unreadable_current] and marks of unknown values [marks_power] are blank.
2. Rows without a time are dropped [rows_without_time].
3. Of the stamps, the longest strictly increasing sequence is kept. A row with the stamp of a kept one is dropped as
   repeated [duplicate_stamps], any other as out of order [backward_stamps]. More than a fifth out of order is an error,
   but rows in no order at all, as parts of a table come together, are sorted [rows_sorted_by_time].
4. Some fixes are not used: those with a gps_error above the larger of 5 cm and four times its median [bad_fixes], where
   a gps_error of exactly 0 means "not reported"; blank ones, and those with a latitude or longitude that does not exist
   [blank_fixes]; a fix that is written again in the next rows because the receiver is slower than the log, for up to
   1.5 s [held_fixes]; and, of the rest, stretches of up to 5 s (2.5 s at an end) that the robot can have reached only
   by a jump [position_jumps]. A jump to where the log then stays is kept as a break, which no segment spans
   [position_breaks].
5. If wheel speeds of both sides are logged, blanks of the position are filled by dead reckoning between the fixes at
   their ends, where it meets them to half a metre [reckoned_positions].
6. Where a meter is slower than the log, its reading is written again in the next rows [held_voltage, held_current];
   there voltage, current and power change evenly from one reading to the next (`joulemap.model.runs.held_readings`).
   Elsewhere a voltage or current is a spike if it differs from the median of the eleven samples around it by more
   than six times their spread plus a share of the run's median, a quarter for voltage and one for current, and the
   run has no such value elsewhere, for one row or less than half a second, because vehicles brake and start for longer
   [voltage_spikes, current_spikes]. Spikes and blanks [blank_voltage, blank_current]
   are replaced by straight lines in time.
7. If a single current or power counts discharge as negative, its sign is changed [current_sign_flipped,
   power_sign_flipped]: as the voltage says, which falls under load, or the acceleration, which takes power; where
   neither is clear, if it is mostly negative. A sign that is said, `current=+pack`, or a name such as
   `discharge_current`, is kept. The currents of several motors are summed with the sign of power; where
   their signs are those of directions, wheel speeds give them that of power [currents_signed_by_wheels], or magnitudes
   are summed [currents_as_magnitudes]; see `joulemap.model.runs.electric`.

Dropped rows and long blanks leave gaps, which `joulemap.model.runs.segments` does not bridge.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import RunsError
from joulemap.model.runs.electric import Currents, electric
from joulemap.model.runs.fixes import positions, usable_fixes
from joulemap.model.runs.logs import read_log
from joulemap.model.runs.mapping import CAPACITY, ROW
from joulemap.model.runs.odometry import Odometry, with_track
from joulemap.model.runs.reckoning import fill_by_wheels
from joulemap.model.runs.run import Run
from joulemap.model.runs.table import (
    LEAST_ROWS,
    LIMITS,
    SIDES,
    TURNING,
    TableLimits,
    add_count,
    columns_there,
    known_values,
    spread,
)
from joulemap.model.runs.table_columns import Table
from joulemap.model.runs.words import count_words

FloatArray = NDArray[np.float64]
_FAR = 0.5  # positions that only scatter are as near to the one after the next as to the next
_MANY_ELSEWHERE = 0.2  # of the positions; receivers err less often


def read_run(path: str | Path, *, name: str | None = None, **options: Any) -> Run:
    """Read a run from a file of any format that is known.

    It needs the columns `t` [s], `x` and `y` [m] (or `lat` and `lon` [deg] with the map's `crs`), and `current`,
    several `current_*` [A] or `power` [W]. `voltage` [V] and any other column are optional. Columns of other names and
    units are recognised where their names say so, or are given by a mapping.

    Parameters
    ----------
    path : str or Path
        Of the file.
    name : str, optional
        Of the run; without it, that of the file.
    **options
        As of `parse_run`.

    Returns
    -------
    Run
        Repaired by the rules above.

    Raises
    ------
    RunsError
        With file, column and row.
    TooLargeError
        If it is larger than the limits.
    """
    path = Path(path)
    return parse_run(path, name=name or path.name, **options)


def parse_run(
    content: str | bytes | Path,
    *,
    name: str,
    crs: str | None = None,
    currents: Currents = "auto",
    odometry: Odometry | None = None,
    limits: TableLimits = LIMITS,
    mapping: Mapping[str, str] | None = None,
) -> Run:
    """Read a run from a text in CSV, from the bytes of a file, or from a file.

    Parameters
    ----------
    content : str, bytes or Path
        Of the whole file, or the file.
    name : str
        Of the run.
    crs : str, optional
        The heightmap's CRS, needed for `lat` and `lon`.
    currents : {"auto", "signed", "magnitude"}
        How the currents of several motors are summed (`joulemap.model.runs.electric`).
    odometry : Odometry, optional
        How its wheel speeds become a track, of a log without positions.
    limits : TableLimits, optional
        How large the table may be.
    mapping : mapping of str to str, optional
        Where joulemap's columns are taken from, as `joulemap.model.runs.mapping.read_mapping` returns it.

    Returns
    -------
    Run
        As `read_run`.

    Raises
    ------
    RunsError
        As `read_run`.
    TooLargeError
        As `read_run`.
    """
    repairs: dict[str, int] = {}
    table = read_log(content, name, repairs, limits=limits, mapping=mapping)
    return run_of_table(table, name=name, crs=crs, repairs=repairs, currents=currents, odometry=odometry)


def run_of_table(table: Table, *, name: str, odometry: Odometry | None = None, **options: Any) -> Run:
    """Make a run of a log that is read already, which stays as it is. `options`: of `run_of`."""
    numbers, texts = dict(table.numbers), dict(table.texts)
    if odometry is not None:
        with_track(numbers, texts, odometry, name)
    run = run_of(numbers, texts, name=name, signed=table.signed, **options)
    notes = (*table.notes, *run.notes, *_of_gaps(run, table.counted))
    return replace(run, reading=table.reading, notes=notes, confidence=table.confidence, counted=table.counted)


def run_of(
    numbers: dict[str, FloatArray],
    texts: dict[str, NDArray[np.str_]],
    *,
    name: str,
    crs: str | None = None,
    repairs: dict[str, int] | None = None,
    currents: Currents = "auto",
    signed: Collection[str] = (),
) -> Run:
    """Make a run of columns that are read already, which are changed.

    `numbers`, `texts` (n,): NaN where blank; `repairs`: what was counted while they were read; `signed`: as of
    `electric`.
    """
    repairs, notes = {} if repairs is None else repairs, list[str]()
    if "t" in texts:
        row = next((k for k, cell in enumerate(texts["t"].tolist()) if cell.strip()), 0)
        raise RunsError.of_run(
            name,
            f", column 't', row {row + 2}: {str(texts['t'][row])[:80]!r} is not a number, and no time such "
            "as 2024-05-01T12:00:00.25",
            column="t",
            row=row + 2,
        )
    if "t" not in numbers:
        raise RunsError.of_run(
            name,
            f"there is no column 't' (seconds){columns_there(numbers)}; a mapping says which it is, like "
            f"t=timestamp_ms:ms, or how long a row lasts, like {ROW}=0.5",
            column="t",
        )
    rows = _ordered_rows(numbers["t"], name, repairs)
    elsewhere = _elsewhere(numbers, rows)
    numbers = {key: values[rows] for key, values in numbers.items()}
    texts = {key: values[rows] for key, values in texts.items()}
    t = numbers.pop("t")
    whole_j = _of_charge(numbers, name)
    unknown_s = _unknown(t, numbers)
    if whole_j is None:
        current, voltage, power, how, of_motors = electric(
            numbers, t, name, repairs, currents, signed=signed, notes=notes
        )
    else:
        current, voltage, power, how, of_motors = np.full(t.size, np.nan), None, None, None, False
    placed = "distance" not in numbers or bool({"x", "lat"} & numbers.keys())
    if placed:
        x, y = positions(numbers, name=name, crs=crs)
        if (away_m := _alternate(x, y)) > 0.0:
            notes.append(
                f"its positions alternate between places that lie {away_m:,.0f} m from each other: is it one vehicle?"
            )
        x, y, breaks = usable_fixes(t, x, y, numbers.get("gps_error"), repairs)
        elsewhere += repairs.get("position_jumps", 0)
        if elsewhere > _MANY_ELSEWHERE * t.size:
            notes.append(
                f"{elsewhere:,} of its positions are out of reach of others, or have the time of another, and were not "
                "used: is it one vehicle, and has each row a time of its own?"
            )
    else:
        y = numbers.pop("distance")
        x, breaks = np.where(np.isfinite(y), 0.0, np.nan), np.zeros(t.size, dtype=bool)
    x, y = fill_by_wheels(t, x, y, breaks, numbers, repairs)
    if np.isfinite(x).sum() < 2:
        raise RunsError.of_run(name, "no usable position is left after the rules for bad fixes", repairs=repairs)
    if not any(map(spread, (x, y, *(numbers[key] for key in (*SIDES, *TURNING, "heading") if key in numbers)))):
        raise RunsError.of_run(name, "it does not move: its position is the same in every row", column="x")
    return Run(
        name,
        t,
        x,
        y,
        current,
        voltage,
        numbers,
        texts,
        breaks,
        repairs,
        power,
        how,
        of_motors,
        notes=tuple(notes),
        placed=placed,
        unknown_s=unknown_s,
        whole_j=whole_j,
    )


def _of_gaps(run: Run, counted: bool) -> list[str]:
    """What is to be known of rows that are missing."""
    gaps_s = np.diff(run.t)[run.missing()]
    if not gaps_s.size or run.whole_j is not None:
        return []
    drawn = "what was drawn is that of its counter" if counted else "nor what was drawn"
    gaps = count_words({"gaps": gaps_s.size})
    return [f"its log has {gaps}, {gaps_s.sum():,.1f} s in all: what was driven there is not counted, {drawn}"]


def _alternate(x: FloatArray, y: FloatArray) -> float:
    """How far each position is from the next, where it is far from it and near the one after that [m]; else 0."""
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < LEAST_ROWS:
        return 0.0
    x, y = x[known], y[known]
    one, two = (float(np.median(np.hypot(x[k:] - x[:-k], y[k:] - y[:-k]))) for k in (1, 2))
    return one if two < _FAR * one and one > 1.0 else 0.0


def _of_charge(numbers: dict[str, FloatArray], name: str) -> tuple[float, float] | None:
    """Energy of the whole run, and its standard deviation by the rounding, where a state of charge is all there is."""
    soc, capacity = numbers.pop("soc", None), numbers.pop(CAPACITY, None)
    drawn = any(key in ("power", "current", "left_current") or key.startswith("current_") for key in numbers)
    if soc is None or drawn:
        return None
    known = known_values(soc)
    if capacity is None:
        raise RunsError.of_run(
            name,
            f"it has a state of charge, and no current, power or counter of energy: say what the battery "
            f"holds with a mapping, such as {CAPACITY}=500 for 500 Wh",
            column="current",
        )
    steps = np.abs(np.diff(np.unique(known)))
    if not steps.size:
        raise RunsError.of_run(name, "its state of charge is the same in every row", column="soc")
    joules = 36.0 * float(capacity[0])  # of one per cent
    rounding = float(steps.min()) / math.sqrt(12.0) * math.sqrt(2.0)  # evenly distributed, at both ends
    return joules * float(known[0] - known[-1]), joules * rounding


def _unknown(t: FloatArray, numbers: Mapping[str, FloatArray]) -> float:
    """Time around rows in which what is drawn is not known [s]."""
    used = ["power"] if "power" in numbers else [key for key in ("voltage", "current") if key in numbers]
    lost = np.zeros(t.size, dtype=bool)
    for key in used:
        lost |= ~np.isfinite(numbers[key])
    each = np.gradient(t) if t.size > 1 else np.zeros(t.size)
    return float(each[lost].sum())


def _ordered_rows(t: FloatArray, name: str, repairs: dict[str, int]) -> NDArray[np.int64]:
    known = np.flatnonzero(np.isfinite(t))
    add_count(repairs, "rows_without_time", t.size - known.size)
    if known.size < LEAST_ROWS:
        raise RunsError.of_run(name, f", column 't': only {known.size} rows have a time", column="t")
    kept = known[_longest_increasing(t[known])]
    again = int(np.isin(t[np.setdiff1d(known, kept)], t[kept]).sum())
    backward = known.size - kept.size - again
    add_count(repairs, "duplicate_stamps", again)
    add_count(repairs, "backward_stamps", backward)
    if backward > 0.2 * known.size:
        row = int(known[np.flatnonzero(np.diff(t[known]) < 0)[0] + 1]) + 2
        raise RunsError.of_run(
            name,
            f", column 't', row {row}: the clock was set back; {backward} of {known.size} rows are out "
            "of order. Split the file there",
            column="t",
            row=row,
        )
    return kept


def _elsewhere(numbers: Mapping[str, FloatArray], rows: NDArray[np.int64]) -> int:
    """How many of the rows that are left out have another position than the kept row of their time."""
    t = numbers["t"]
    left = np.setdiff1d(np.flatnonzero(np.isfinite(t)), rows)
    kept = rows[np.minimum(np.searchsorted(t[rows], t[left]), rows.size - 1)]
    places = [numbers[key] for key in ("x", "y", "lat", "lon") if key in numbers]
    return int(np.any([np.abs(each[left] - each[kept]) > 0 for each in places], axis=0).sum()) if places else 0


@njit(cache=True)
def _longest_increasing(t: FloatArray) -> NDArray[np.int64]:
    """Indices of a longest strictly increasing subsequence of t (n,), the first of equal stamps first."""
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
