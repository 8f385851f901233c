"""A missing effect: a formula with its settings, its coefficients, and the part of the operating range in which it
acts.

It is JSON-able, and gives the energy of segments that were not driven yet.
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
from joulemap.model.loop.formulas import FORCES, FORMULAS, GROUND
from joulemap.model.loop.quantities import quantity
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]


def inside(drive: Drive, where: Mapping[str, Any]) -> FloatArray:
    """Return how much of each row lies in a part of the operating range.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    where : mapping
        {"over": quantity, "above" or "below": value}, {"word": column, "is": value} or {"runs": names}.

    Returns
    -------
    ndarray of float, (n,)
        0..1: a metre over the top of a hill is partly uphill.
    """
    if "runs" in where:
        return np.isin(drive.runs or [""], where["runs"])[drive.run].astype(np.float64)
    if "word" in where:
        return np.where(drive.words.get(where["word"], np.full(len(drive), "")) == where["is"], 1.0, 0.0)
    over = where["over"]

    def _beyond(values: FloatArray) -> FloatArray:
        return np.where(values > where["above"] if "above" in where else values < where["below"], 1.0, 0.0)

    return drive.along(_beyond) if over == "grade" else _beyond(quantity(drive, over))


@dataclass(frozen=True)
class Term:
    """A formula with its settings: one way in which an effect may act.

    Attributes
    ----------
    name : str
        Of the effect.
    formula : str
        A key of `joulemap.model.loop.formulas.FORMULAS`.
    units : tuple of str
        Of each coefficient.
    settings : mapping
        Arguments of the formula.
    where : mapping
        The part of the operating range, see `inside`; empty for everywhere.
    coefficients : tuple of float
        Empty until it is fitted.
    bend : Bend, optional
        Of a force: its load-dependent response.
    """

    name: str
    formula: str
    units: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    where: Mapping[str, Any] = field(default_factory=dict)
    coefficients: tuple[float, ...] = ()
    bend: Bend | None = None

    def columns(self, drive: Drive) -> FloatArray:
        """Return what the effect adds to each row, per unit of its coefficients.

        Parameters
        ----------
        drive : Drive
            Features of the segments.

        Returns
        -------
        ndarray of float, (n, k)
            0 where the ground or a column is not known.

        Raises
        ------
        ModelError
            If the formula is not known.
        """
        if self.formula not in FORMULAS:
            raise ModelError(f"a model has an effect {self.formula!r}, which this version does not know")
        found = np.nan_to_num(FORMULAS[self.formula](drive, **self.settings))
        if self.where:
            found = found * inside(drive, self.where)[:, None]
        return found if self.bend is None else self.bend.columns(drive, found)

    @property
    def is_force(self) -> bool:
        """Whether it pushes against the motion over every metre, so that it has a load-dependent response."""
        shares = any(self.settings.get(key) for key in ("of_motion", "of_all", "of_time"))
        return not shares and self.settings.get("of", self.formula) in FORCES

    def bent(self, residuals: Residuals, spread_n: float | None = None) -> Term:
        """Return a force with its load-dependent response, fitted to residuals; any other effect unchanged.

        Parameters
        ----------
        residuals : Residuals
            That give its size.
        spread_n : float, optional
            See `Bend`; without it, that of the response it has already.

        Returns
        -------
        Term
            With the same settings.
        """
        spread = spread_n if spread_n is not None or self.bend is None else self.bend.spread_n
        if spread is None or not self.is_force:
            return self
        return replace(self, bend=bend_of(residuals, replace(self, bend=None).columns(residuals.drive), spread))

    @property
    def reads_ground(self) -> bool:
        """Whether it depends on slopes, roughness or height of the ground."""
        named = (self.formula, *self.settings.values(), *self.where.values())
        return not GROUND.isdisjoint(name for name in named if isinstance(name, str))

    @property
    def goes_with(self) -> str | None:
        """The quantity it depends on, if there is one; None otherwise."""
        logged = {"temperature": "temperature", "payload": self.settings.get("column")}.get(self.formula)
        over = self.settings.get("over")
        return f"column:{logged}" if logged else None if over is None else str(over)

    def record(self, drive: Drive) -> FloatArray | None:
        """Return the logged record that the effect follows.

        Parameters
        ----------
        drive : Drive
            Features of the segments.

        Returns
        -------
        ndarray of float, (n,), or None
            A column, or 1 where one of its classes was logged.
        """
        over = str(self.settings.get("over", ""))
        if self.formula == "smooth" and over.startswith("column:"):
            return quantity(drive, over)
        if self.formula == "words":
            found = drive.words.get(self.settings["column"], np.full(len(drive), ""))
            return np.isin(found, self.settings["values"]).astype(np.float64)
        return None

    def energy(self, drive: Drive) -> FloatArray:
        """Return the energy that the effect adds.

        Parameters
        ----------
        drive : Drive
            Features of the segments.

        Returns
        -------
        ndarray of float, (n,)
            Energy [J], or charge [A s].
        """
        return self.columns(drive) @ np.asarray(self.coefficients)

    def fitted(self, coefficients: FloatArray) -> Term:
        """Return the term with coefficients.

        Parameters
        ----------
        coefficients : ndarray of float, (k,)
            In its units.

        Returns
        -------
        Term
            Otherwise the same.
        """
        return replace(self, coefficients=tuple(float(c) for c in coefficients))

    def as_dict(self) -> dict[str, Any]:
        """Return it as a JSON-able mapping."""
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
        """Read what `as_dict` returned.

        Parameters
        ----------
        values : mapping
            From a file.

        Returns
        -------
        Term
            The same.

        Raises
        ------
        ModelError
            If something is missing.
        """
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
    """Return the cost of a radian of turning in plans.

    Parameters
    ----------
    terms : sequence of Term
        Of which those of turning count.
    drive : Drive
        Features of the segments.

    Returns
    -------
    float
        Cost [J/rad, or A s/rad].

    Notes
    -----
    It is the slope of the energy of turning over the angle that each segment turned, in least squares. Turns within a
    metre count, and the wandering of straight driving hardly does, which plans have none of. For one term that acts
    everywhere it is its coefficient, also where turning saturates.
    """
    turned = drive.turned_abs_rad
    energy = np.sum([t.energy(drive) for t in terms if t.formula.startswith("turning")] or [0.0 * turned], axis=0)
    return float(turned @ energy) / max(float(turned @ turned), 1e-12)
