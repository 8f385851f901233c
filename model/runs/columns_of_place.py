"""What the columns of a table say of place and heading, and which positions are none."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.candidates import Recognised
from joulemap.model.runs.column_values import read_column
from joulemap.model.runs.counters import LONGEST_STEP, pauses, summed, total_of
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source
from joulemap.model.runs.table import LEAST_ROWS, FloatArray, known_values, spread
from joulemap.model.runs.unsaid_units import ALIKE


def take_degrees(
    numbers: dict[str, FloatArray], chosen: dict[str, Source], words: dict[str, str], found: Recognised
) -> None:
    """Positions `x` and `y` that are a longitude and a latitude, as in metres nothing would have moved."""
    if not {"x", "y"} <= numbers.keys() or any(chosen[key].columns == [key] or chosen[key].unit for key in "xy"):
        return
    if not agreement.in_degrees(numbers["x"], numbers["y"]):
        return
    for key, target in (("x", "lon"), ("y", "lat")):
        numbers[target], words[target], chosen[target] = numbers.pop(key), "deg", chosen.pop(key)
        words.pop(key, None)
        found.confidence[target] = found.confidence.pop(key)
    found.notes.append("`x` and `y` are taken for a longitude and a latitude: in metres they would hardly move")


def check_latitude(stream: Stream, chosen: Mapping[str, Source], name: str) -> None:
    """Refuse latitudes above 90 degrees that could only be degrees and minutes, beside longitudes that are none."""
    pair = [chosen[key] for key in ("lat", "lon") if key in chosen and chosen[key].unit in ("", "deg")]
    columns = [source.columns[0] for source in pair if len(source.parts) == 1 and source.columns[0] in stream.numbers]
    if len(columns) < 2:
        return
    lat, lon = (known_values(stream.numbers[column]) for column in columns)
    largest = float(np.median(np.abs(lat))) if lat.size else 0.0
    of_minutes = agreement.degrees_unit("lat", lat, columns[0]) == "ddmm"
    if of_minutes and largest <= 180.0 and float(np.abs(lon).max(initial=0.0)) <= 90.0:
        first, second = (column[:60] for column in columns)
        raise RunsError.of_run(
            name,
            f"{first} is about {largest:.4g}, and no latitude is above 90 degrees: are {first} and {second} the wrong "
            f"way round? Then say so with a mapping: lat={second},lon={first}",
            column="lat",
            value=largest,
        )


def with_heading(chosen: Mapping[str, Source], stream: Stream, rest: dict[str, FloatArray]) -> str:
    """Add a heading to the other columns. Result: the column whose sense only the way can tell; empty without."""
    source = chosen.get("heading")
    if source is None:
        return ""
    column = source.columns[0]
    if column == "heading" or source.unit or len(source.parts) > 1:
        rest["heading"] = read_column("heading", source, stream, "", {})[0]
        return ""
    rest[column] = stream.numbers[column]
    return column


def without_standing_positions(
    numbers: dict[str, FloatArray], stream: Stream, chosen: dict[str, Source], found: Recognised
) -> None:
    """Leave positions out that are the same in every row, as receivers write without a fix, while a speed, a distance
    or another position says that the robot moved, in whichever unit.
    """
    moved = [
        column
        for key in ("speed", "distance", "lat", "lon", "x", "y")
        if key in chosen
        for column in chosen[key].columns
    ]
    for pair in (("x", "y"), ("lat", "lon")):
        standing = numbers.keys() >= set(pair) and not any(spread(numbers[key]) for key in pair)
        if standing and any(spread(stream.numbers[column]) for column in moved if column in stream.numbers):
            found.notes.append("its positions are the same in every row, while it moved: they are not used")
            for key in pair:
                del numbers[key]
                chosen.pop(key, None)


def without_frozen_positions(numbers: dict[str, FloatArray], found: Recognised) -> None:
    """Make positions unknown where they stay the same for long, while the speed or the distance goes on."""
    pair = next((each for each in (("x", "y"), ("lat", "lon")) if numbers.keys() >= {*each, "t"}), None)
    speed, counted = numbers.get("speed"), numbers.get("distance")
    if pair is None or (speed is None and counted is None):
        return
    t = numbers["t"]
    driven = total_of(counted) if counted is not None else summed(t, numbers["speed"])
    known = np.flatnonzero(np.isfinite(driven) & np.isfinite(t) & np.isfinite(numbers[pair[0]] + numbers[pair[1]]))
    if known.size < LEAST_ROWS:
        return
    moved = np.any([np.diff(numbers[key][known]) != 0 for key in pair], axis=0)
    first = known[np.flatnonzero(np.append(True, moved))]
    last = known[np.append(np.flatnonzero(moved), known.size - 1)]
    ways, waited = np.abs(np.diff(driven[first])), t[last] - t[first]
    usual_m, usual_s = (
        float(np.median(each[ways > 0])) if (ways > 0).any() else 0.0 for each in (ways, np.diff(t[first]))
    )
    way = np.abs(driven[last] - driven[first])
    frozen = pauses(waited, usual_s) & (way > LONGEST_STEP * usual_m) & (way * usual_s > ALIKE * usual_m * waited)
    if not frozen.any() or usual_s <= 0:
        return
    for begin, end in zip(first[frozen], last[frozen], strict=True):
        for key in pair:
            numbers[key] = np.where((np.arange(t.size) > begin) & (np.arange(t.size) <= end), np.nan, numbers[key])
    said = "counter" if counted is not None else "speed"
    found.notes.append(
        f"its positions stay the same for {waited[frozen].sum():,.0f} s in which its {said} makes "
        f"{way[frozen].sum():,.0f} m: they are not used there"
    )


def without_null_island(numbers: dict[str, FloatArray]) -> None:
    """Make positions at latitude 0 and longitude 0 unknown, which receivers without a fix write."""
    lat, lon = numbers.get("lat"), numbers.get("lon")
    if lat is None or lon is None:
        return
    nowhere = (lat == 0) & (lon == 0)
    if nowhere.any() and not nowhere.all():
        numbers["lat"], numbers["lon"] = (np.where(nowhere, np.nan, values) for values in (lat, lon))
