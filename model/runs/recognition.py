"""Which columns of a table are joulemap's: by name and unit, then by values, with a question where two remain.

Of several columns that may be one, the surest name wins, then a sum over all batteries, then the column that agrees
with the others.
"""

from __future__ import annotations

from collections.abc import Mapping

from joulemap.model.runs.candidates import CONFIDENCE, Recognised, candidates_of, has_partner, speaks, surest
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source, replaced, source_of
from joulemap.model.runs.names import NAMED, POSSIBLE, Candidate, ruled_out, side_of, wheel_speed, words_of
from joulemap.model.runs.table import SIDES, TURNING, spread
from joulemap.model.runs.units import known_unit, quantity_of, unit_in_name
from joulemap.model.runs.which_battery import choose_battery
from joulemap.model.runs.which_time import choose_time, take_axis

_BY_UNIT = {"t": ("s", "ms"), "voltage": ("V", "mV"), "current": ("A", "mA"), "speed": ("km/h", "m/s", "mph")}
_WHEELS = {*SIDES, *TURNING}
_TICKS = {"tick", "ticks", "encoder", "enc", "counts"}


def recognised(stream: Stream, mapping: Mapping[str, str], name: str) -> Recognised:
    """Return which columns of a table are joulemap's."""
    there = [*stream.numbers, *stream.texts]
    found = Recognised({target: source_of(target, text, there, name) for target, text in mapping.items()})
    for target, source in found.chosen.items():
        found.confidence[target] = 1.0
        if not source.unit and len(source.parts) == 1:
            unit = known_unit(target, stream.units.get(source.columns[0], ""))
            found.chosen[target] = Source(source.parts, unit or "")
    if "t" not in mapping:
        choose_time(stream, found)
    for target in ("lat", "lon", "x", "y", "z", "distance", "energy", "charge", "soc", "heading"):
        if not replaced(target, mapping):
            _choose(target, stream, found)
    take_axis(stream, found)
    _choose_speeds(stream, mapping, found)
    if stream.packs:
        found.packs = [(Source(((1, volt),)), Source(((1, amp),))) for volt, amp in stream.packs]
        found.confidence["power"] = CONFIDENCE[NAMED]
    else:
        choose_battery(stream, mapping, found)
    for target in _BY_UNIT:
        if not replaced(target, mapping) and not (target == "current" and "power" in found.chosen):
            _by_unit(target, stream, found)
    if {"x", "y"} <= found.chosen.keys() and not {"lat", "lon"} <= mapping.keys():
        standing = not {"x", "y"} & mapping.keys() and not _moves(stream, found, ("x", "y"))
        for target in ("x", "y") if standing and _moves(stream, found, ("lat", "lon")) else ("lat", "lon"):
            found.chosen.pop(target, None)
    if {"lat", "lon"} <= found.chosen.keys() and ("x" in found.chosen) != ("y" in found.chosen):
        found.chosen.pop("x", None), found.chosen.pop("y", None)
    return found


def _choose(target: str, stream: Stream, found: Recognised, *, least: int = 0) -> None:
    """The surest column; a question where several are, but for heights, of which the first does."""
    if target in found.chosen:
        return
    candidates = [each for each in candidates_of(target, stream, found.taken) if each.sureness >= least]
    tied = surest(candidates, stream.numbers)
    if target in ("x", "y"):
        tied = [each for each in tied if has_partner(each, stream)] or tied
    if len(tied) == 1 or (tied and target == "z"):
        found.take(target, tied[:1])
    elif tied:
        found.ask(target, tied)


def _moves(stream: Stream, found: Recognised, pair: tuple[str, str]) -> bool:
    """Whether a place is known, and not the same in every row."""
    columns = [found.chosen[target].columns[0] for target in pair if target in found.chosen]
    return len(columns) == 2 and any(spread(stream.numbers[column]) for column in columns if column in stream.numbers)


def _choose_speeds(stream: Stream, mapping: Mapping[str, str], found: Recognised) -> None:
    placed = {"x", "y"} <= found.chosen.keys() or {"lat", "lon"} <= found.chosen.keys()
    for column in sorted(stream.numbers, key=lambda each: each not in _WHEELS):
        target, wheel = wheel_speed(column, stream.units.get(column, "")) or ("", None)
        known = {*found.chosen, *(_WHEELS if _WHEELS & mapping.keys() else ())}
        if wheel is not None and column not in found.taken and target not in known | ({*TURNING} if placed else set()):
            found.take(target, [wheel])
    ticks = [column for column in stream.numbers if side_of(column) and _TICKS & {*words_of(column)}]
    if {*map(side_of, ticks)} == {"left", "right"} and not _WHEELS & found.chosen.keys():
        both = "+".join(next(column[:60] for column in ticks if side_of(column) == side) for side in ("left", "right"))
        found.questions.setdefault(
            "distance",
            f"how far does it roll in half a tick of {both}? Say it in metres with a mapping, pi times the radius of a "
            f"wheel over the ticks of a turn, such as distance={both}:0.00015",
        )
    _choose("speed", stream, found, least=NAMED if placed else POSSIBLE)


def _by_unit(target: str, stream: Stream, found: Recognised) -> None:
    """The only column in its unit whose name says nothing else: `Spannung [V]`."""
    if target in found.chosen or target in found.questions or (target in ("voltage", "current") and found.packs):
        return
    if target == "current" and any(quantity_of(key) == quantity_of(target) for key in found.chosen):
        return
    fitting = []
    for column in stream.numbers.keys() - found.taken:
        bracketed = unit_in_name(target, column)[1] if column.rstrip().endswith(("]", ")")) else None
        unit = known_unit(target, stream.units.get(column, "")) or bracketed
        if unit in _BY_UNIT[target] and not ruled_out(target, column) and speaks(target, stream.numbers[column]):
            fitting.append(Candidate(column, str(unit), 0))
    if len(fitting) == 1:
        found.take(target, fitting)
