"""What the columns of a table say of time, speed and distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.candidates import Recognised
from joulemap.model.runs.column_values import stamps_of
from joulemap.model.runs.columns_of_power import flows
from joulemap.model.runs.counters import no_counter, summed, total_of, unknown_s
from joulemap.model.runs.formats.columns import CLOCK, DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.instants import across_midnight
from joulemap.model.runs.mapping import RADIUS, Source
from joulemap.model.runs.names import words_of
from joulemap.model.runs.table import SIDES, TURNING, FloatArray
from joulemap.model.runs.units import conversion
from joulemap.model.runs.unsaid_units import ALIKE, FAST_KMPH, UNSAID, Movement, clear, fitting, off

_ANOTHER = 0.5  # tolerances by which a speed differs from that of the positions, and is in no unit that is known
_FALLS = 0.05  # of the steps of a counter, which falls where it begins anew
_COARSE = 0.1  # of the way: steps of a counter that say too little of where it was driven
_NO_METRES = 30.0  # a distance that counts so many times less than the speed makes counts km or miles


def take_movement(
    numbers: dict[str, FloatArray], stream: Stream, words: dict[str, str], found: Recognised, name: str
) -> None:
    """Time, speed and distance in the units in which they and the positions agree best.

    A speed whose unit stays open is left out, and asked for where nothing else says how far it drove.
    """
    chosen = found.chosen
    if "t" not in chosen:
        return
    stamps, units = _stamps(chosen["t"], stream, name)
    times = {unit: _seconds(stamps, unit) for unit in units}
    choices: dict[str, Sequence[str]] = {"t": units}
    if _placed(numbers):
        open_ = {"lat", "lon"} <= numbers.keys() and not any(chosen[key].unit for key in ("lat", "lon"))
        turned = {key: np.degrees(numbers[key]) for key in ("lat", "lon")} if open_ else {}
        known = any(key in numbers for key in ("speed", "distance"))
        around = known and open_ and all(np.nanmax(np.abs(each), initial=0.0) <= 180.0 for each in turned.values())
        places = {"": numbers} | ({"rad": turned} if around else {})
        choices["place"] = [*places]
    else:
        places = {}
    for key in ("speed", "distance"):
        if key in numbers:
            choices[key] = [""] if chosen[key].unit or chosen[key].columns == ["distance"] else UNSAID[key]
    counted = numbers.get("distance")
    counted = total_of(counted) if counted is not None and not numbers.keys() & {"lat", "x"} else None
    counted = counted if counted is not None and _counts(counted) else None
    movement = Movement(times, places, numbers.get("speed"), counted)
    fits = fitting(choices, movement.cost)
    unit = clear(fits["t"], "s" if "s" in units else units[0])
    numbers["t"], words["t"] = times[unit], unit if unit != "s" else ""
    if unit != "s" and (len(units) > 1 or unit in ("d", "hhmmss")):
        found.notes.append(f"`t` is taken for {unit}: so its numbers, and those of its movement, make sense")
    if (place := clear(fits.get("place", [""]), "")) == "rad":
        numbers |= turned
        words |= dict.fromkeys(turned, "rad")
        found.notes.append("`lat` and `lon` are taken for radians: in degrees the way would be 57 times too short")
    if "speed" in numbers:
        _take_speed(numbers, stream, words, found, fits["speed"], movement, {"t": unit, "place": place})
    if choices.get("distance", ("",)) != [""] and "distance" in numbers and not _placed(numbers):
        _take_counter(numbers, words, found, fits["distance"], "speed" in numbers)


def _stamps(source: Source, stream: Stream, name: str) -> tuple[FloatArray, list[str]]:
    """The stamps as they are written, and the units that they may be in."""
    kinds = [stream.units.get(column, "") for column in source.columns]
    total = stamps_of(source, stream, name)
    for kind in (DATE, CLOCK):
        if kind in kinds:
            return total, [kind]
    return total, [source.unit] if source.unit else agreement.units_of_stamps(total)


def _seconds(stamps: FloatArray, unit: str) -> FloatArray:
    if unit in (DATE, CLOCK):
        return stamps if unit == DATE else across_midnight(stamps)
    if unit == "hhmmss":
        return across_midnight(agreement.of_clock(stamps))
    factor = conversion("t", unit)[0]
    seconds = stamps if factor == 1.0 else stamps * factor
    of_day = unit == "ms" and float(np.nanmax(np.abs(seconds), initial=0.0)) <= 86_400.0
    return across_midnight(seconds) if of_day else seconds


def _take_speed(
    numbers: dict[str, FloatArray],
    stream: Stream,
    words: dict[str, str],
    found: Recognised,
    units: Sequence[str],
    movement: Movement,
    others: Mapping[str, str],
) -> None:
    """The speed [m/s]; with positions one that is not theirs is no speed of the vehicle."""
    column, logged, placed = found.chosen["speed"].columns[0], numbers.pop("speed"), bool(movement.places)
    unit, pace = clear(units, "?"), movement.pace(others) if placed else 0.0
    if placed and unit not in ("", "?") and off(pace, conversion("speed", unit)[0]) >= _ANOTHER:
        unit = "?"
    if unit == "" and (times := agreement.contradiction(1.0, pace)):
        found.notes.append(f"its speed is {times} times that of its positions: is {column[:60]} in the unit it says?")
    elif unit == "?" and placed and column == "speed" and off(pace, 1.0) < 1.0:
        unit = "m/s"
    elif unit == "?" and not placed and any(words_of(other)[:2] == ["header", "stamp"] for other in stream.numbers):
        unit = "m/s"
        found.notes.append("`speed` is taken for m/s, the unit of ROS, whose stamps it has")
    elif unit == "?" and not placed:
        found.questions["speed"] = f"is {column[:60]} in km/h or m/s? Say it with a mapping: speed={column[:60]}:km/h"
    elif unit == "km/h" and movement.counted is None and not placed:
        found.notes.append(f"`speed` is taken for km/h, because {column[:60]} reaches more than {FAST_KMPH:g}")
    if unit != "?":
        words["speed"] = unit
        numbers["speed"] = logged * conversion("speed", unit)[0] if unit else logged


def _take_counter(
    numbers: dict[str, FloatArray], words: dict[str, str], found: Recognised, units: Sequence[str], with_speed: bool
) -> None:
    """The distance [m]: in metres where a vehicle can have driven so, or else as the speed says; it may stay open."""
    column = found.chosen["distance"].columns[0][:60]
    if len(units) > 1 and units[0] != "m" and not with_speed:
        numbers.pop("distance")
        found.questions["distance"] = (
            f"is {column} in {', '.join(units)}? Say it with a mapping, such as distance={column}:{units[0]}; if each "
            f"row is what came since the row before, distance={column}:m/row"
        )
        return
    unit = clear(units, "m")
    numbers["distance"] = conversion("distance", unit)[0] * numbers["distance"]
    if unit != "m":
        words["distance"] = unit
        found.notes.append(f"`distance` is taken for {unit}: so {column} agrees with its time and its speed")


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
        resolution = _resolution(steps)
        counts = min((steps > 0).sum(), (steps < 0).sum()) <= _FALLS * steps.size
        if made is None and not counts:
            raise no_counter(name, "distance", found.chosen["distance"].columns[0], "m")
        whole = float(np.nanmax(counted, initial=0.0))
        if made is None and resolution > max(1.0, _COARSE * whole) and whole > 0.0:
            raise RunsError.of_run(
                name,
                f"{found.chosen['distance'].columns[0][:60]} counts {whole:,.0f} m in steps of {resolution:,.0f} m, "
                "which is too coarse: say which column is the speed with a mapping, such as speed=v:km/h",
                column="distance",
            )
        whole, other = (float(np.nanmax(each, initial=0.0)) for each in (counted, counted if made is None else made))
        unit = agreement.contradiction(whole, other)
        if unit and found.chosen["distance"].unit and found.chosen["speed"].unit:
            raise RunsError.of_run(
                name,
                f"its distance is {unit} times the sum of its speed, so the unit of one is wrong: say "
                f"it with a mapping, such as speed={found.chosen['speed'].columns[0][:60]}:km/h",
                column="distance",
            )
        if made is not None and counts and not unit:
            if abs(whole - other) > ALIKE * other + resolution:
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


def _counts(counted: FloatArray) -> bool:
    """Whether a distance only rises, or only falls, in steps that are small beside the whole."""
    steps = np.diff(counted[np.isfinite(counted)])
    return min((steps > 0).sum(), (steps < 0).sum()) <= _FALLS * steps.size and _resolution(steps) <= ALIKE * float(
        np.nanmax(counted, initial=0.0)
    )


def _resolution(steps: FloatArray) -> float:
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
