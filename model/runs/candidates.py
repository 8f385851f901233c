"""Columns that may be one of joulemap's, the surest first, and what was chosen of them."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import CLOCK, DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source
from joulemap.model.runs.names import LIKELY, NAMED, POSSIBLE, Candidate, candidate, words_of
from joulemap.model.runs.table import LEAST_ROWS, FloatArray, known_values, spread

CONFIDENCE = {NAMED: 0.99, LIKELY: 0.95, POSSIBLE: 0.7, 0: 0.6}
"""Of a reading by its name alone; 0 is a column that only its unit points to."""
_MAY_BE_CONSTANT = ("voltage", "z", "soc", "t")


@dataclass
class Recognised:
    """What was recognised, by joulemap's column."""

    chosen: dict[str, Source] = field(default_factory=dict)
    packs: list[tuple[Source, Source]] = field(default_factory=list)  # voltage and current of batteries in parallel
    questions: dict[str, str] = field(default_factory=dict)  # of what is not known, with the option that answers it
    confidence: dict[str, float] = field(default_factory=dict)  # 0 to 1
    notes: list[str] = field(default_factory=list)
    counted: bool = False  # what is drawn is the rate of a counter

    @property
    def taken(self) -> set[str]:
        """Columns of the log that are chosen."""
        return {column for source in self.chosen.values() for column in source.columns}

    def take(self, target: str, parts: Sequence[Candidate]) -> None:
        """Choose a column, or the sum of several."""
        self.chosen[target] = Source(tuple((1, each.column) for each in parts), parts[0].unit)
        self.confidence[target] = CONFIDENCE[min(each.sureness for each in parts)]

    def ask(self, target: str, tied: Sequence[Candidate]) -> None:
        """Ask which of several columns it is."""
        names = ", ".join(each.column[:60] for each in tied[:4])
        option = f"{target}={tied[0].column[:60]}"
        self.questions[target] = f"which of {names} is its {target}? Say it with a mapping, such as {option}"

    def refuse(self, name: str, targets: Collection[str]) -> None:
        """Raise the first question about some columns, if there is one."""
        for target in targets:
            if target in self.questions:
                raise RunsError.of_run(name, self.questions[target], column=target)


def candidates_of(target: str, stream: Stream, taken: Collection[str]) -> list[Candidate]:
    """Return all columns that may be it, the surest first."""
    found = []
    for column in stream.numbers:
        unit = stream.units.get(column, "")
        of_time = unit in (DATE, CLOCK)
        if column in taken or (of_time and target != "t") or (target == "speed" and _is_part(column, stream)):
            continue
        each = candidate(target, column, "" if of_time else unit)
        if of_time:
            found.append(Candidate(column, unit, each.sureness if each is not None else 0))
        elif each is not None:
            found.append(each)
    speaking = [each for each in found if each.unit == DATE or speaks(target, stream.numbers[each.column])]
    if target not in ("lat", "lon"):  # nothing but zeros, as receivers without a fix write, is no position
        speaking = speaking or [
            each for each in found if target != "power" or np.isfinite(stream.numbers[each.column]).any()
        ]
    if target in ("lat", "lon", "x", "y", "z"):  # a receiver without a fix writes the same in every row
        speaking = [each for each in speaking if spread(stream.numbers[each.column])] or speaking
    if target == "t" and any(each.sureness for each in speaking):
        speaking = [each for each in speaking if each.sureness]
    own = [each for each in speaking if each.column == target or each.column.startswith(f"{target} (")]  # or it twice
    return own or sorted(speaking, key=lambda each: (-each.sureness, -each.total))


def has_partner(each: Candidate, stream: Stream) -> bool:
    """Return whether a column called x has one called y beside it, or the other way round: `Pos_X` and `Pos_Y`."""
    pairs = {"x": "y", "easting": "northing", "east": "north", "ost": "nord", "e": "n", "rechtswert": "hochwert"}
    other = pairs | {second: first for first, second in pairs.items()}
    plain = re.sub(r" \(\d+\)$", "", each.column)  # the second of a name is no other
    wanted = [other.get(word, word) for word in words_of(plain)]
    return any(words_of(column) == wanted for column in stream.numbers)


def _is_part(column: str, stream: Stream) -> bool:
    """Whether a column is a component of a vector: `vel[0]` beside `vel[1]`, `velocity.1` beside `velocity.0`."""
    found = re.fullmatch(r"(.*[\[.])(\d)(\]?)", column)
    if found is None:
        return False
    other = "0" if found[2] == "1" else "1"
    return f"{found[1]}{other}{found[3]}" in stream.numbers


def speaks(target: str, values: FloatArray) -> bool:
    """Return whether values say something of a quantity: enough are known, and not all are 0."""
    known = known_values(values)
    if known.size < LEAST_ROWS or (target == "t" and np.ptp(known) == 0):
        return False
    return target in _MAY_BE_CONSTANT or bool((known != 0).any())


def surest(candidates: Sequence[Candidate], numbers: Mapping[str, FloatArray]) -> list[Candidate]:
    """Return those between which nothing decides, one where it is clear; columns that say the same are one."""
    different: list[Candidate] = []
    for each in candidates:
        best = (each.sureness, each.total) == (candidates[0].sureness, candidates[0].total)
        if best and not any(_alike(numbers[each.column], numbers[other.column]) for other in different):
            different.append(each)
    return different


def _alike(a: FloatArray, b: FloatArray) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < LEAST_ROWS:
        return False
    return bool(np.mean(np.abs(a[both] - b[both]) <= 1e-3 * np.abs(a[both]) + 1e-9) > 0.95)
