"""Which columns of a table are joulemap's: by name and unit, then by values, with a question where two remain.

Of several columns that may be one, the surest name wins, then a sum over all batteries, then the column that agrees
with the others: power with voltage times current. Columns that say the same are one. Numbered pairs of a voltage and a
current are batteries in parallel, whose powers add.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from joulemap.model.runs.formats.columns import CLOCK, DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source, source_of
from joulemap.model.runs.names import (
    LIKELY,
    NAMED,
    POSSIBLE,
    Candidate,
    candidate,
    motor_current,
    part_of,
    ruled_out,
    wheel_speed,
)
from joulemap.model.runs.table import LEAST_ROWS, FloatArray, spread
from joulemap.model.runs.units import known_unit, quantity_of, unit_in_name

CONFIDENCE = {NAMED: 0.99, LIKELY: 0.95, POSSIBLE: 0.7, 0: 0.6}
"""Of a reading by its name alone; 0 is a column that only its unit points to."""
_MAY_BE_CONSTANT = ("voltage", "z", "soc", "t")
_BY_UNIT = {"t": ("s", "ms"), "voltage": ("V", "mV"), "current": ("A", "mA"), "speed": ("km/h", "m/s", "mph")}
_RISES = 0.5  # of the steps of a time, less those in which it falls
_AGREE = 0.2  # of power with voltage times current, in the median


@dataclass
class Recognised:
    """What was recognised.

    Attributes
    ----------
    chosen : dict of str to Source
        By joulemap's column.
    packs : list of (Source, Source)
        Voltage and current of batteries in parallel.
    questions : dict of str to str
        By joulemap's column that is not known, a sentence with the option that answers it.
    confidence : dict of str to float
        By joulemap's column, 0 to 1.
    notes : list of str
        What is to be known.
    """

    chosen: dict[str, Source] = field(default_factory=dict)
    packs: list[tuple[Source, Source]] = field(default_factory=list)
    questions: dict[str, str] = field(default_factory=dict)
    confidence: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def recognised(stream: Stream, mapping: Mapping[str, str], name: str) -> Recognised:
    """Return which columns of a table are joulemap's."""
    there = [*stream.numbers, *stream.texts]
    found = Recognised({target: source_of(target, text, there, name) for target, text in mapping.items()})
    for target, source in found.chosen.items():
        found.confidence[target] = 1.0
        if not source.unit and len(source.parts) == 1:
            unit = known_unit(target, stream.units.get(source.columns[0], ""))
            found.chosen[target] = Source(source.parts, unit or "")
    for target in ("t", "lat", "lon", "x", "y", "z", "distance", "energy", "charge", "soc", "heading"):
        if not replaced(target, mapping):
            _choose(target, stream, found)
    if "x" in found.chosen and not {"t", "y"} & {*found.chosen, *found.questions}:
        _take_axis(stream, found)
    _choose_speeds(stream, mapping, found)
    if stream.packs:
        found.packs = [(Source(((1, volt),)), Source(((1, amp),))) for volt, amp in stream.packs]
        found.confidence["power"] = CONFIDENCE[NAMED]
    else:
        _choose_electric(stream, mapping, found)
    for target in ("t", "voltage", "current", "speed"):
        if not replaced(target, mapping) and not (target == "current" and "power" in found.chosen):
            _by_unit(target, stream, found)
    if {"x", "y"} <= found.chosen.keys() and not {"lat", "lon"} <= mapping.keys():
        standing = not {"x", "y"} & mapping.keys() and not _moves(stream, found, ("x", "y"))
        given_up = ("x", "y") if standing and _moves(stream, found, ("lat", "lon")) else ("lat", "lon")
        for target in given_up:
            found.chosen.pop(target, None)
    for one, other in (("x", "y"), ("lat", "lon")):
        if (one in found.chosen) != (other in found.chosen) and {"lat", "lon"} <= found.chosen.keys():
            found.chosen.pop(one, None), found.chosen.pop(other, None)
    return found


def replaced(target: str, chosen: Collection[str]) -> bool:
    """Return whether the user has said a column, or another way to say the same.

    Result: True too of `lat` where x and y are said, and of a current where another or a power is.
    """
    if target in chosen:
        return True
    if target in ("lat", "lon"):
        return "x" in chosen and "y" in chosen
    if target in ("x", "y"):
        return "lat" in chosen and "lon" in chosen
    if target == "current" or target.startswith("current_"):
        return "power" in chosen or any(key == "current" or key.startswith("current_") for key in chosen)
    return False


def _candidates(target: str, stream: Stream, taken: Collection[str]) -> list[Candidate]:
    """All columns that may be it, the surest first."""
    found = []
    for column in stream.numbers:
        unit = stream.units.get(column, "")
        if column in taken or (target != "t" and unit in (DATE, CLOCK)):
            continue
        if target == "t" and unit in (DATE, CLOCK):
            each = candidate("t", column)
            found.append(Candidate(column, unit, each.sureness if each is not None else 0))
        elif (each := candidate(target, column, unit)) is not None:
            found.append(each)
    speaking = [each for each in found if each.unit == DATE or _speaks(target, stream.numbers[each.column])]
    if target not in ("lat", "lon"):  # nothing but zeros, as receivers without a fix write, is no position
        speaking = speaking or found
    if target in ("lat", "lon", "x", "y", "z"):  # a receiver without a fix writes the same in every row
        speaking = [each for each in speaking if spread(stream.numbers[each.column])] or speaking
    if target == "t" and any(each.sureness for each in speaking):
        speaking = [each for each in speaking if each.sureness]
    own = [each for each in speaking if each.column == target or each.column.startswith(f"{target} (")]  # or it twice
    return own or sorted(speaking, key=lambda each: (-each.sureness, -each.total))


def _speaks(target: str, values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    if known.size < LEAST_ROWS or (target == "t" and np.ptp(known) == 0):
        return False
    return target in _MAY_BE_CONSTANT or bool((known != 0).any())


def _first(candidates: Sequence[Candidate], numbers: Mapping[str, FloatArray]) -> list[Candidate]:
    """Those between which nothing decides; one where it is clear."""
    if not candidates:
        return []
    best = candidates[0]
    tied = [each for each in candidates if (each.sureness, each.total) == (best.sureness, best.total)]
    different = [best]
    for each in tied[1:]:
        if not any(_alike(numbers[each.column], numbers[other.column]) for other in different):
            different.append(each)
    return different


def _alike(a: FloatArray, b: FloatArray) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < LEAST_ROWS:
        return False
    return bool(np.mean(np.abs(a[both] - b[both]) <= 1e-3 * np.abs(a[both]) + 1e-9) > 0.95)


def _choose(target: str, stream: Stream, found: Recognised, *, least: int = 0) -> None:
    if target in found.chosen:
        return
    taken = {column for source in found.chosen.values() for column in source.columns}
    candidates = [each for each in _candidates(target, stream, taken) if each.sureness >= least]
    tied = _first(candidates, stream.numbers)
    if target == "t" and len(tied) > 1:
        tied = _time_of(tied, stream)
    if target == "t" and len(tied) == 1:
        tied = [_finer(tied[0], candidates, stream.numbers)]
    if len(tied) == 1 or [each.unit for each in tied] == [DATE, CLOCK]:
        _take(target, tied, found)
    elif tied and target == "z":
        _take(target, tied[:1], found)
    elif tied:
        found.questions[target] = _question(target, tied)


def _take(target: str, parts: Sequence[Candidate], found: Recognised) -> None:
    found.chosen[target] = Source(tuple((1, each.column) for each in parts), parts[0].unit)
    found.confidence[target] = CONFIDENCE[min(each.sureness for each in parts)]


def _question(target: str, tied: Sequence[Candidate]) -> str:
    names = ", ".join(each.column[:60] for each in tied[:4])
    return f"which of {names} is its {target}? Say it with a mapping, such as {target}={tied[0].column[:60]}"


def _time_of(tied: Sequence[Candidate], stream: Stream) -> list[Candidate]:
    """A date with a time of day, or the columns of both; of plain numbers the one that rises in most rows."""
    whole = [each for each in tied if each.unit == DATE and _resolves(stream.numbers[each.column])]
    dates = [each for each in tied if each.unit == DATE and each not in whole]
    clocks = [each for each in tied if each.unit == CLOCK]
    if whole:
        return whole[:1]
    if dates and clocks:
        return [dates[0], clocks[0]]
    rising = sorted(tied, key=lambda each: -_rises(values := stream.numbers[each.column]) * np.isfinite(values).sum())
    return rising[:1] if clocks or _rises(stream.numbers[rising[0].column]) > _RISES else list(tied)


def _finer(usual: Candidate, candidates: Sequence[Candidate], numbers: Mapping[str, FloatArray]) -> Candidate:
    """Beside a time that repeats, such as one in whole minutes, another that has at least twice as many values."""
    count = {
        each.column: np.unique(numbers[each.column][np.isfinite(numbers[each.column])]).size for each in candidates
    }
    most = max(candidates, key=lambda each: count[each.column] * (_rises(numbers[each.column]) > _RISES))
    return most if count[most.column] >= 2 * count[usual.column] else usual


def _resolves(seconds: FloatArray) -> bool:
    """Whether these are more than dates."""
    known = seconds[np.isfinite(seconds)]
    return bool((known % 86_400.0 != known[:1] % 86_400.0).any())


def _rises(values: FloatArray) -> float:
    steps = np.diff(values[np.isfinite(values)])
    return float(np.mean(steps > 0)) - float(np.mean(steps < 0)) if steps.size else 0.0


def _moves(stream: Stream, found: Recognised, pair: tuple[str, str]) -> bool:
    """Whether a place is known, and not the same in every row."""
    columns = [found.chosen[target].columns[0] for target in pair if target in found.chosen]
    return len(columns) == 2 and any(spread(stream.numbers[column]) for column in columns if column in stream.numbers)


def _take_axis(stream: Stream, found: Recognised) -> None:
    """A lone `x` that rises in every row is the axis of a plot: the time, in seconds."""
    source = found.chosen["x"]
    values = stream.numbers[source.columns[0]]
    if _rises(values) == 1.0 and source.unit in ("", "s"):
        found.chosen["t"] = Source(found.chosen.pop("x").parts, "s")
        found.confidence["t"] = min(found.confidence.pop("x"), CONFIDENCE[POSSIBLE])
        found.notes.append(f"`t` is taken from {source.columns[0][:60]}, in seconds: it rises, and there is no y")


def _choose_speeds(stream: Stream, mapping: Mapping[str, str], found: Recognised) -> None:
    sides = {each.instance: each for column in stream.numbers if (each := wheel_speed(column)) is not None}
    for side in ("left", "right"):
        target = f"speed_{side}"
        if side in sides and target not in mapping and target not in stream.numbers:
            _take(target, [sides[side]], found)
    placed = {"x", "y"} <= found.chosen.keys() or {"lat", "lon"} <= found.chosen.keys()
    if "speed" not in found.chosen:
        _choose("speed", stream, found, least=NAMED if placed else POSSIBLE)


def _choose_electric(stream: Stream, mapping: Mapping[str, str], found: Recognised) -> None:
    numbers, chosen = stream.numbers, found.chosen
    taken = {column for source in chosen.values() for column in source.columns}
    of = {
        key: [] if replaced(key, mapping) else _candidates(key, stream, taken)
        for key in ("voltage", "current", "power")
    }
    parts = [
        column for column in numbers if column.startswith("current_") or column in ("left_current", "right_current")
    ]
    if len(parts) > 1:
        of["current"] = [
            each for each in of["current"] if each.sureness >= LIKELY and not _is_motor_a(each.column, parts)
        ]
    if not replaced("current", mapping) and not of["current"]:
        _take_motors(stream, taken, found)
    tied = {key: _first(each, numbers) for key, each in of.items()}
    several = len(tied["voltage"]) > 1 or len(tied["current"]) > 1
    if several and not _take_agreeing(tied, numbers) and not _take_of_one_part(tied):
        _take_packs(tied, found)
    for key, each in tied.items():
        if key in chosen or not each or (found.packs and key in ("voltage", "current")):
            continue
        if len(each) == 1:
            _take(key, each, found)
        elif key == "power" and len({one.instance for one in each} - {""}) == len(each):
            _take(key, each, found)  # of batteries in parallel
        else:
            found.questions[key] = _question(key, each)


def _is_motor_a(column: str, others: Collection[str]) -> bool:
    """Whether `current_a` is that of a motor a, beside `current_b`, and no current in A."""
    return column.lower() == "current_a" and any(other.lower() == "current_b" for other in others)


def _take_motors(stream: Stream, taken: Collection[str], found: Recognised) -> None:
    """The currents of motors, where there is none of the battery."""
    own = {column: unit_in_name("current", column) for column in stream.numbers if column.startswith("current_")}
    for column, (stem, unit) in own.items():  # `current_left_mA`: what the name ends with is no motor
        if unit is not None and stem not in stream.numbers and not _is_motor_a(column, own):
            found.chosen[stem] = Source(((1, column),), unit)
    if own:
        return
    motors = [each for column in stream.numbers if column not in taken and (each := motor_current(column)) is not None]
    if len(motors) > 1 and len({each.instance for each in motors}) == len(motors):
        for each in motors:
            _take(f"current_{each.instance}", [each], found)


def _take_agreeing(tied: dict[str, list[Candidate]], numbers: Mapping[str, FloatArray]) -> bool:
    """The voltage and the current whose product is the power, if one pair is."""
    if len(tied["power"]) != 1:
        return False
    power = numbers[tied["power"][0].column]
    pairs = {
        (v, i): disagreement(power, numbers[v.column] * numbers[i.column])
        for v in tied["voltage"]
        for i in tied["current"]
    }
    best = min(pairs, key=lambda pair: pairs[pair], default=None)
    if best is None or pairs[best] > _AGREE:
        return False
    tied["voltage"], tied["current"] = [best[0]], [best[1]]
    return True


def _take_of_one_part(tied: dict[str, list[Candidate]]) -> bool:
    """The one voltage and current whose names say the same part: PackVolt and PackAmps beside BatteryVolt."""
    pairs = [
        (v, i)
        for v in tied["voltage"]
        for i in tied["current"]
        if part_of("voltage", v.column) == part_of("current", i.column)
    ]
    if len(pairs) != 1 or min(len(tied["voltage"]), len(tied["current"])) > 1:
        return False
    tied["voltage"], tied["current"] = ([each] for each in pairs[0])
    return True


def _take_packs(tied: Mapping[str, list[Candidate]], found: Recognised) -> None:
    """Pairs of a voltage and a current with the same number."""
    volts, amps = ({each.instance: each for each in tied[key]} for key in ("voltage", "current"))
    same = [key for key in amps if key in volts]
    if len(amps) < 2 or len(amps) != len(tied["current"]) or (len(volts) > 1 and len(same) != len(amps)):
        return
    for instance, amp in amps.items():
        volt = volts[instance] if len(volts) > 1 else next(iter(volts.values()), None)
        if volt is None or not instance:
            found.packs.clear()
            return
        found.packs.append(tuple(Source(((1, each.column),), each.unit) for each in (volt, amp)))  # type: ignore[arg-type]
    found.confidence["power"] = CONFIDENCE[min(each.sureness for each in amps.values())]


def disagreement(a: FloatArray, b: FloatArray) -> float:
    """Return by which share two quantities differ in the median, whatever their signs; infinite where neither flows.

    `a`, `b` (n,): NaN where unknown.
    """
    a, b = np.abs(a), np.abs(b)
    both = np.isfinite(a) & np.isfinite(b)
    both &= np.maximum(a, b) > 0.1 * max(float(np.quantile(b[both], 0.9)), 1e-12) if both.any() else both
    return float(np.median(np.abs(a[both] - b[both]) / np.maximum(a[both], b[both]))) if both.any() else np.inf


def _by_unit(target: str, stream: Stream, found: Recognised) -> None:
    """The only column in its unit whose name says nothing else: `Spannung [V]`."""
    if target in found.chosen or target in found.questions or (target in ("voltage", "current") and found.packs):
        return
    taken = {column for source in found.chosen.values() for column in source.columns}
    others = [key for key in found.chosen if quantity_of(key) == quantity_of(target)]
    if target == "current" and others:
        return
    fitting = []
    for column in stream.numbers:
        bracketed = unit_in_name(target, column)[1] if column.rstrip().endswith(("]", ")")) else None
        unit = known_unit(target, stream.units.get(column, "")) or bracketed
        if (
            unit in _BY_UNIT[target]
            and column not in taken
            and not ruled_out(target, column)
            and _speaks(target, stream.numbers[column])
        ):
            fitting.append(Candidate(column, unit, 0))
    if len(fitting) == 1:
        _take(target, fitting, found)
