"""Forms with their coefficients: what a calibration finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from joulemap.model.loop.forms import Form
from joulemap.model.runs.features import SHARE_DRIVEN, Features, FloatArray


@dataclass(frozen=True)
class Term:
    """A form with fitted coefficients."""

    form: Form  # What it depends on, and how
    coefficients: tuple[float, ...]  # One for each column of the form

    def energy(self, rows: Features) -> FloatArray:
        """Return the energy that it adds to each row. Result (n,): energy [J], or charge [A s]."""
        return self.form.columns(rows) @ np.asarray(self.coefficients)

    @property
    def by_name(self) -> dict[str, float]:
        """Every coefficient by its name."""
        return dict(zip(self.form.coefficient_names(), self.coefficients, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Return it as a JSON-able mapping."""
        return {**self.form.as_dict(), "name": self.form.name, "coefficients": list(self.coefficients)}


@dataclass(frozen=True)
class Effect:
    """An effect that was found."""

    term: Term  # What is new in these runs and not in the baseline runs
    low: FloatArray  # (k,): Ends of the 95 % confidence intervals of its coefficients
    high: FloatArray
    p_value: float  # Allowing for every test
    share: float  # Of the squared error, that it explains on left-out runs
    between: bool  # Whether it was found in the differences between runs


def energy_of(terms: Sequence[Term], rows: Features) -> FloatArray:
    """Return the energy of rows by all terms, (n,) [J, or A s]."""
    return np.sum([t.energy(rows) for t in terms], axis=0) if terms else np.zeros(len(rows))


def turning_per_rad(terms: Sequence[Term], rows: Features, kind: str = "") -> float:
    """Return the cost of a radian of turning in plans, on a kind of ground or on all that was driven on.

    Result: cost [J/rad, or A s/rad]: the slope of the energy of turning, beyond that of going straight on, over the
    angle that each row turned, in least squares. Turns beyond the driven range are left out: a log may not show the
    peak of power of one on the spot.
    """
    moving = rows.take(~rows.standing)
    rows = moving.take(moving.turned_abs_rad <= np.quantile(moving.turned_abs_rad, 1.0 - SHARE_DRIVEN))
    turned = rows.turned_abs_rad
    named = {column: np.full(len(rows), kind) for column in rows.words}
    rows = replace(rows, words=named, drives=replace(rows.drives, motor_speed_mps=None))
    straight = replace(rows, turned_abs_rad=0.0 * turned)
    of_turning = [t for t in terms if t.form.name == "turning" or "turning" in t.form.parts]
    energy = energy_of(of_turning, rows) - energy_of(of_turning, straight)  # a curve may be nil at another turn
    return float(turned @ energy) / max(float(turned @ turned), 1e-12)
