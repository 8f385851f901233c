"""A missing effect: a formula with its settings, its coefficients and the part of the operating range it acts in.

It is JSON-able, and prices drives nobody has made yet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import ModelError
from joulemap.model.loop.bend import Bend, bend_of
from joulemap.model.loop.drive import Drive
from joulemap.model.loop.formulas import FORCES, FORMULAS, GROUND, quantity
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]


def inside(drive: Drive, where: Mapping[str, Any]) -> FloatArray:
    """(n,) 0..1, how much of a row lies in a part of the operating range: {"over": quantity, "above" | "below": value},
    {"word": column, "is": value} or {"runs": names}. A metre over the brow of a hill is partly uphill.
    """
    if "runs" in where:
        return np.isin(drive.runs or [""], where["runs"])[drive.run].astype(np.float64)
    if "word" in where:
        return np.where(drive.words.get(where["word"], np.full(len(drive), "")) == where["is"], 1.0, 0.0)
    over = where["over"]

    def beyond(values: FloatArray) -> FloatArray:
        return np.where(values > where["above"] if "above" in where else values < where["below"], 1.0, 0.0)

    return drive.along(beyond) if over == "grade" else beyond(quantity(drive, over))


@dataclass(frozen=True)
class Term:
    """A formula with its settings: one way in which an effect may act.

    name : the effect's. units : of each coefficient. where : see `inside`. coefficients : empty until fitted. bend : of
    a force, how far it is felt.
    """

    name: str
    formula: str
    units: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    where: Mapping[str, Any] = field(default_factory=dict)
    coefficients: tuple[float, ...] = ()
    bend: Bend | None = None

    def columns(self, drive: Drive) -> FloatArray:
        """(n, k) per unit of the coefficients; 0 where the ground or a column is not known."""
        if self.formula not in FORMULAS:
            raise ModelError(f"a model has an effect {self.formula!r}, which this version does not know")
        found = np.nan_to_num(FORMULAS[self.formula](drive, **self.settings))
        if self.where:
            found = found * inside(drive, self.where)[:, None]
        return found if self.bend is None else self.bend.columns(drive, found)

    @property
    def is_force(self) -> bool:
        """Whether it pushes against the motion over every metre, so that it is felt as far as the drives pull."""
        shares = any(self.settings.get(key) for key in ("of_motion", "of_all", "of_time"))
        return not shares and self.settings.get("of", self.formula) in FORCES

    def bent(self, residuals: Residuals, spread_n: float | None = None) -> Term:
        """A force as far as it is felt, being as large as the residuals say; any other effect as it is. spread_n : see
        `Bend`; that of the bend it has unless given.
        """
        spread = spread_n if spread_n is not None or self.bend is None else self.bend.spread_n
        if spread is None or not self.is_force:
            return self
        return replace(self, bend=bend_of(residuals, replace(self, bend=None).columns(residuals.drive), spread))

    @property
    def reads_ground(self) -> bool:
        """Whether slopes, roughness or height of the ground change it; all else it takes from the base and the path."""
        named = (self.formula, *self.settings.values(), *self.where.values())
        return not GROUND.isdisjoint(name for name in named if isinstance(name, str))

    @property
    def goes_with(self) -> str | None:
        """The quantity it goes with, as far as that is one of a drive's own, or of a log."""
        logged = {"temperature": "temperature", "payload": self.settings.get("column")}.get(self.formula)
        over = self.settings.get("over")
        return f"column:{logged}" if logged else None if over is None else str(over)

    def record(self, drive: Drive) -> FloatArray | None:
        """(n,) what a log says that the effect goes with: a column, or 1 where a word stands; None without a record."""
        over = str(self.settings.get("over", ""))
        if self.formula == "smooth" and over.startswith("column:"):
            return quantity(drive, over)
        if self.formula == "words":
            found = drive.words.get(self.settings["column"], np.full(len(drive), ""))
            return np.isin(found, self.settings["values"]).astype(np.float64)
        return None

    def energy(self, drive: Drive) -> FloatArray:
        """(n,) [J, or A s] that the effect adds."""
        return self.columns(drive) @ np.asarray(self.coefficients)

    def fitted(self, coefficients: FloatArray) -> Term:
        return replace(self, coefficients=tuple(float(c) for c in coefficients))

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "formula": self.formula,
            "units": list(self.units),
            "settings": dict(self.settings),
            "where": dict(self.where),
            "coefficients": list(self.coefficients),
            "bend": None if self.bend is None else self.bend.as_dict(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Term:
        """Raises ModelError where something is missing."""
        try:
            coefficients = tuple(float(c) for c in values["coefficients"])
            bend = values.get("bend")
            return cls(
                str(values["name"]),
                str(values["formula"]),
                tuple(values["units"]),
                dict(values["settings"]),
                dict(values["where"]),
                coefficients,
                None if bend is None else Bend.from_dict(bend),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"an effect of the model is not complete: {error!r}") from error


def turning_per_rad(terms: Sequence[Term], drive: Drive) -> float:
    """What a radian of turning costs in plans [J, or A s]: the slope of the terms' energy of turning over how far each
    segment turned, in least squares. A turn within a metre counts, not the wandering of straight driving, which a plan
    has none of; of one term that acts everywhere it is the coefficient, also where turning saturates.
    """
    turned = drive.turned_abs_rad
    energy = np.sum([t.energy(drive) for t in terms if t.formula.startswith("turning")] or [0.0 * turned], axis=0)
    return float(turned @ energy) / max(float(turned @ turned), 1e-12)
