"""What the columns of a table say of time, place, speed and distance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.candidates import Recognised
from joulemap.model.runs.column_values import numbers_of, read_column
from joulemap.model.runs.columns_of_power import flows
from joulemap.model.runs.counters import LONGEST_STEP, no_counter, pauses, summed, total_of, unknown_s
from joulemap.model.runs.formats.columns import CLOCK, DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.instants import across_midnight
from joulemap.model.runs.mapping import RADIUS, Source
from joulemap.model.runs.names import words_of
from joulemap.model.runs.table import LEAST_ROWS, SIDES, TURNING, FloatArray, spread
from joulemap.model.runs.units import UNITS, conversion

_AGREE = 0.2  # a counted distance differs from the sum of the speed by less
_FALLS = 0.05  # of the steps of a counter, which falls where it begins anew
_NO_METRES = 30.0  # a distance that counts so many times less than the speed makes counts km or miles
_FAST_KMPH = 70.0  # a speed that is above this number is no m/s of a vehicle on the ground


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


def take_radians(numbers: dict[str, FloatArray], stream: Stream, words: dict[str, str], found: Recognised) -> None:
    """Latitudes and longitudes that are in radians: then their way is that of the distance or of the speed."""
    if not {"t", "lat", "lon"} <= numbers.keys() or any(found.chosen[key].unit for key in ("lat", "lon")):
        return
    turned = {key: np.degrees(numbers[key]) for key in ("lat", "lon")}
    path_m = agreement.path_of(turned) if np.nanmax(np.abs([*turned.values()]), initial=0.0) <= 180.0 else None
    column = found.chosen["speed"].columns[0] if "speed" in found.chosen else ""
    driven, units = numbers.get("distance"), {"m": (1.0, 0.0)}
    if driven is None and column in stream.numbers:
        driven, units = summed(numbers["t"], stream.numbers[column]), UNITS["speed"]
    if driven is None or not path_m:
        return
    whole = float(np.nanmax(driven, initial=0.0))
    if any(abs(whole * factor / path_m - 1.0) < _AGREE for factor, _ in units.values()):
        numbers |= turned
        words |= dict.fromkeys(turned, "rad")
        found.notes.append("`lat` and `lon` are taken for radians: in degrees the way would be 57 times too short")


def time_of(
    source: Source, stream: Stream, path_m: float | None, name: str, found: Recognised
) -> tuple[FloatArray, str]:
    """The stamps [s], and their unit where the name does not say it."""
    kinds = [stream.units.get(column, "") for column in source.columns]
    columns = [numbers_of(stream, column, name) for column in source.columns]
    total = np.sum([sign * values for (sign, _), values in zip(source.parts, columns, strict=True)], axis=0)
    if DATE in kinds:
        return total, DATE
    if CLOCK in kinds:
        return across_midnight(total), CLOCK
    unit, why = source.unit, ""
    if not unit:
        speed = stream.numbers.get(found.chosen["speed"].columns[0]) if "speed" in found.chosen else None
        unit, why = agreement.time_unit(total, path_m, speed)
    if why:
        found.notes.append(f"`t` is taken for {unit}: {why}")
    if unit == "hhmmss":
        return across_midnight(agreement.of_clock(total)), unit
    factor = conversion("t", unit)[0] if unit else 1.0
    largest = float(np.nanmax(np.abs(total), initial=0.0))
    seconds = total if factor == 1.0 else total * factor
    return (across_midnight(seconds) if unit == "ms" and largest * factor <= 86_400.0 else seconds), unit


def take_speed(
    source: Source,
    stream: Stream,
    numbers: dict[str, FloatArray],
    path_m: float | None,
    name: str,
    repairs: dict[str, int],
    found: Recognised,
    words: dict[str, str],
) -> None:
    """The speed [m/s]; one whose unit nothing says is left out, or asked for where it is needed."""
    logged, _ = read_column("speed", Source(source.parts), stream, name, repairs)
    unit = source.unit
    if not unit and "t" in numbers:
        unit = agreement.speed_unit(numbers["t"], logged, numbers, path_m)
        if not unit and path_m is None:
            column = source.columns[0]
            if np.nanmax(np.abs(logged), initial=0.0) > _FAST_KMPH:
                unit = "km/h"
                found.notes.append(f"`speed` is taken for km/h, because {column[:60]} reaches more than {_FAST_KMPH:g}")
            elif any(words_of(other)[:2] == ["header", "stamp"] for other in stream.numbers):
                unit = "m/s"
                found.notes.append("`speed` is taken for m/s, the unit of ROS, whose stamps it has")
            else:
                found.questions["speed"] = (
                    f"is {column[:60]} in km/h or m/s? Say it with a mapping: speed={column[:60]}:km/h"
                )
                return
        if not unit and source.columns != ["speed"]:  # of which joulemap's own is in m/s
            return
    words["speed"] = unit if not source.unit else ""
    numbers["speed"] = logged * (UNITS["speed"].get(unit) or conversion("speed", unit or "m/s"))[0]


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
    frozen = pauses(waited, usual_s) & (way > LONGEST_STEP * usual_m) & (way * usual_s > _AGREE * usual_m * waited)
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


def take_wheels(
    numbers: dict[str, FloatArray], reading: dict[str, str], radius: Source | None, found: Recognised
) -> None:
    """The speed of a vehicle without a position: the mean of its sides, if they turn [rad/s] times the radius."""
    sides = next((pair for pair in (SIDES, TURNING) if numbers.keys() >= {*pair}), None)
    if sides is None or _placed(numbers) or numbers.keys() & {"speed", "distance"}:
        return
    columns = [found.chosen[key].columns[0][:60] for key in sides]
    unsaid = any(found.chosen[key].columns != [key] and not found.chosen[key].unit for key in sides)
    if sides == TURNING and radius is None:
        found.questions["speed"] = (
            f"{' and '.join(columns)} say how fast its wheels turn: say how large they are with a mapping, such as "
            f"{RADIUS}=0.165 for a radius of 0.165 m"
        )
    elif np.nansum(np.sign(numbers[sides[0]] * numbers[sides[1]])) < 0:
        found.questions["speed"] = (
            f"{' and '.join(columns)} are of opposite signs most of the time: if the wheels are mounted so, say so "
            f"with a mapping, such as {sides[1]}=-{columns[1]}"
        )
    elif sides == TURNING or not unsaid:
        factor = float(radius.unit) if radius is not None and sides == TURNING else 1.0
        numbers["speed"] = factor * (numbers[sides[0]] + numbers[sides[1]]) / 2
        of = f"{factor:g} m x " if sides == TURNING else ""
        reading["speed"] = f"{of}the mean of {' and '.join(reading.get(key, key) for key in sides)}"


def _placed(numbers: Mapping[str, FloatArray]) -> bool:
    return {"x", "y"} <= numbers.keys() or {"lat", "lon"} <= numbers.keys()


def take_distance(numbers: dict[str, FloatArray], reading: dict[str, str], found: Recognised, name: str) -> None:
    """The distance, counted or from the speed, where there is no position."""
    speed = numbers.get("speed")
    made = None if speed is None or "t" not in numbers else summed(numbers["t"], speed)
    if (
        _placed(numbers)
        or "t" not in numbers
        or (numbers.keys() >= {*SIDES} and not numbers.keys() & {"speed", "distance"})
    ):
        numbers.pop("distance", None)
        reading.pop("distance", None)
        return
    if "distance" in numbers:
        counted = total_of(numbers["distance"])
        steps = np.diff(counted[np.isfinite(counted)])
        resolution = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        counts = min((steps > 0).sum(), (steps < 0).sum()) <= _FALLS * steps.size
        if made is None:
            _ask_for_unit(numbers["t"], counted, found.chosen["distance"], name)
        if made is None and not counts:
            raise no_counter(name, "distance", found.chosen["distance"].columns[0], "m")
        unit = "" if made is None else agreement.contradiction(counted, made)
        if unit and found.chosen["distance"].unit and found.chosen["speed"].unit:
            raise RunsError.of_run(
                name,
                f"its distance is {unit} times the sum of its speed, so the unit of one is wrong: say "
                f"it with a mapping, such as speed={found.chosen['speed'].columns[0][:60]}:km/h",
                column="distance",
            )
        if made is not None and counts and not unit:
            whole, other = (float(np.nanmax(values, initial=0.0)) for values in (counted, made))
            if abs(whole - other) > _AGREE * other + resolution:
                found.notes.append(f"its distance counts {whole:,.0f} m, where its speed makes {other:,.0f} m")
            counts = bool(found.chosen["distance"].unit) or whole > other / _NO_METRES
        if made is None or (counts and resolution <= 1.0 and not unit):
            numbers["distance"] = counted
            return
    if made is not None:
        numbers["distance"] = made
        if lost := unknown_s(numbers["t"], numbers["speed"]):
            found.notes.append(f"its speed is not known for {lost:,.0f} s in all: what was driven then is not counted")
        reading["distance"] = f"the sum of {reading.get('speed', 'speed [m/s]')}"
    elif "distance" not in numbers and (flows(numbers) or "soc" in numbers):  # else that is what is missing
        found.refuse(name, ("lat", "lon", "x", "y", "distance", "speed"))


def _ask_for_unit(t: FloatArray, counted: FloatArray, source: Source, name: str) -> None:
    """Ask in which unit a distance counts that nothing says, where a vehicle does not drive so many metres."""
    column = source.columns[0]
    known = np.isfinite(t) & np.isfinite(counted)
    if source.unit or column == "distance" or known.sum() < LEAST_ROWS:
        return
    mean = float(np.nanmax(counted) / max(np.ptp(t[known]), 1e-9))
    if 0.0 < mean < agreement.DRIVEN_MPS[0] or mean > _FAST_KMPH / 3.6:
        raise RunsError.of_run(
            name,
            f"{column[:60]} rises by {mean:.3g} a second: in m, km, mi or ft? Say it with a mapping, such "
            f"as distance={column[:60]}:{'ft' if mean > 1.0 else 'km'}; if each row is what came since the row before, "
            f"distance={column[:60]}:m/row",
            column="distance",
        )


def without_null_island(numbers: dict[str, FloatArray]) -> None:
    """Make positions at latitude 0 and longitude 0 unknown, which receivers without a fix write."""
    lat, lon = numbers.get("lat"), numbers.get("lon")
    if lat is None or lon is None:
        return
    nowhere = (lat == 0) & (lon == 0)
    if nowhere.any() and not nowhere.all():
        numbers["lat"], numbers["lon"] = (np.where(nowhere, np.nan, values) for values in (lat, lon))
