"""Classes of ground, or of anything else that a log says in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import GROUND, Features, FloatArray

_GROUND_COLUMNS = (GROUND, "ground", "surface")


def _classes(rows: Features) -> Iterator[tuple[str, tuple[str, ...], dict[str, Any]]]:
    """Columns of text, and their classes but for the most common one, which is the reference; and how much was driven
    on each.
    """
    moving = ~rows.standing
    for column, values in sorted(rows.words.items()):
        words, number = np.unique(values[moving], return_inverse=True)
        metres = np.bincount(number, weights=rows.length_m[moving], minlength=len(words))
        known = {str(w): float(m) for w, m in zip(words, metres, strict=True) if w}
        if len(known) > 1:
            usual, total = max(known, key=lambda word: known[word]), sum(known.values())
            others = tuple(word for word in known if word != usual)
            shares = tuple(round(known[word] / total, 6) for word in others)
            yield column, others, {"reference": usual, "shares": shares}


@dataclass(frozen=True)
class _ByClass(Form):
    """What each class of a logged column of text has of its own, beside the reference.

    column_name : the column. classes : those with a coefficient. reference, shares : the class without one, and which
    share of the metres was driven on each of the others. What is of no known class costs the mean of what was driven;
    without shares it is of the reference.
    """

    column_name: str
    classes: tuple[str, ...]
    reference: str = field(default="", kw_only=True)
    shares: tuple[float, ...] = field(default=(), kw_only=True)

    pooled = True

    @property
    def known_before(self) -> bool:
        return self.column_name in _GROUND_COLUMNS

    def coefficient_names(self) -> tuple[str, ...]:
        return self.classes

    def _amount(self, rows: Features) -> FloatArray:
        raise NotImplementedError

    def columns(self, rows: Features) -> FloatArray:
        found = rows.words.get(self.column_name, np.full(len(rows), ""))
        unknown = ~np.isin(found, [self.reference, *self.classes])
        shares = self.shares or (0.0,) * len(self.classes)
        of_class = [np.where(unknown, share, found == word) for word, share in zip(self.classes, shares, strict=True)]
        return np.stack([mine * self._amount(rows) for mine in of_class], axis=1)


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
        for column, words, driven in _classes(rows):
            yield from (cls(column, words, share, **driven) for share in (False, True))


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
        yield from (cls(column, classes, limit, **driven) for column, classes, driven in _classes(rows))
