"""Classes of ground, or of anything else that a log says in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray

_GROUND_COLUMNS = ("terrain", "ground", "surface")


def _classes(rows: Features) -> Iterator[tuple[str, list[str]]]:
    """Columns of text, and their classes but for the most common one, which is the reference."""
    moving = ~rows.standing
    for column, values in sorted(rows.words.items()):
        words, counts = np.unique(values[moving], return_counts=True)
        known = {str(w): int(c) for w, c in zip(words, counts, strict=True) if w}
        if len(known) > 1:
            usual = max(known, key=lambda word: known[word])
            yield column, [word for word in known if word != usual]


@dataclass(frozen=True)
class _ByClass(Form):
    """What each class of a logged column of text has of its own; a class that is not listed is the reference.

    column_name : the column. classes : those with a coefficient.
    """

    column_name: str
    classes: tuple[str, ...]

    planned = False

    def coefficient_names(self) -> tuple[str, ...]:
        return self.classes

    def _amount(self, rows: Features) -> FloatArray:
        raise NotImplementedError

    def columns(self, rows: Features) -> FloatArray:
        found = rows.words.get(self.column_name, np.full(len(rows), ""))
        return np.stack([(found == word) * self._amount(rows) for word in self.classes], axis=1)


@dataclass(frozen=True)
class TerrainClass(_ByClass):
    """Energy added on each class. of_motion : a share of the energy of motion instead of energy per metre."""

    of_motion: bool = False

    key = "terrain_class"
    resists = True
    label = "terrain class"
    meaning = "energy added on each class of ground"
    reveals = "the same manoeuvres on each kind of ground"

    @property
    def name(self) -> str:
        return self.key if self.column_name in _GROUND_COLUMNS else f"{self.key}:{self.column_name}"

    @property
    def title(self) -> str:
        return self.label if self.column_name in _GROUND_COLUMNS else f"class of {self.column_name}"

    def units(self, energy: str) -> tuple[str, ...]:
        return ("of the motion's energy" if self.of_motion else f"{energy}/m",) * len(self.classes)

    def _amount(self, rows: Features) -> FloatArray:
        return rows.motion_part if self.of_motion else rows.work_m * rows.pulling

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield from (cls(column, tuple(words), share) for column, words in _classes(rows) for share in (False, True))


@dataclass(frozen=True)
class TurningByClass(_ByClass):
    """Turning on each class of a logged column of text, beside turning on others. limit_per_m : of `Turning`."""

    limit_per_m: float | None = None

    key = "turning_by_class"
    label = "turning by terrain class"
    meaning = "energy per radian of heading change, added on each class of ground"
    unit = "{E}/rad"
    reveals = "curves of several radii on each kind of ground"

    @property
    def _main(self) -> Form:
        return TerrainClass(self.column_name, self.classes)

    @property
    def name(self) -> str:
        return "turning x " + self._main.name

    @property
    def title(self) -> str:
        return "turning by " + self._main.title

    @property
    def parts(self) -> tuple[str, ...]:
        return ("turning", self._main.name)

    def _amount(self, rows: Features) -> FloatArray:
        return rows.slowness * rows.turned_up_to(self.limit_per_m)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        limit = None if rows.drives.motor_speed_mps is None else round(rows.pivot_per_m, 6)
        yield from (cls(column, tuple(classes), limit) for column, classes in _classes(rows))
