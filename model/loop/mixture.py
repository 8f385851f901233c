"""What plans use: a weighted mean of the calibrated model, the model before, and two simple ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import Drives, Features, FloatArray

CALIBRATED, BEFORE = "after_planner", "before"
SIMPLE = {
    "least_squares": ("length", "climb", "turned", "time", "drag", "speeding_up", "kinetic_energy"),
    "constant": ("length",),
}
"""Columns of simple models by name, each fitted to the same runs."""
PREDICTIONS = (CALIBRATED, *SIMPLE, BEFORE)
"""What the mean is of."""


@dataclass(frozen=True)
class Mixture:
    """Shares of the predictions, and what the calibrated model does not know of the others.

    Attributes
    ----------
    shares : mapping of str to float
        By name, of `PREDICTIONS`; they sum to 1.
    simple : mapping of str to Term
        The simple models that have a share.
    scale : Term, optional
        What makes a charge of the prediction before.
    """

    shares: Mapping[str, float]
    simple: Mapping[str, Term]
    scale: Term | None = None

    @property
    def of_calibrated(self) -> bool:
        """Whether the calibrated model has a share."""
        return CALIBRATED in self.shares

    def added(
        self, calibrated: FloatArray, rows: Features, *, level: bool, ranges: Mapping[str, tuple[float, float]]
    ) -> FloatArray:
        """Return what is added to the base model's prediction, or to nothing of a charge, (n,) [J, or A s].

        calibrated : what the calibrated model adds, (n,). level : whether no run has shown a slope, which then costs
        what the base model says. ranges : as driven.
        """
        own, before = self.shares.get(CALIBRATED, 0.0), self.shares.get(BEFORE, 0.0)
        plain = replace(rows, drives=Drives())
        flat = plain.tilted(-plain.grade) if level else plain
        held = flat.within({name: ends for name, ends in ranges.items() if name == "speed"})
        total = own * calibrated
        for name, term in self.simple.items():
            total = total + self.shares[name] * (term.energy(held) + plain.predicted - flat.predicted)
        if self.scale is None:
            return total + (own - 1.0) * rows.predicted + before * plain.predicted
        return total + before * self.scale.energy(plain)

    def as_dict(self) -> dict[str, Any]:
        """Return it as a JSON-able mapping."""
        simple = {name: term.as_dict() for name, term in self.simple.items()}
        scale = None if self.scale is None else self.scale.as_dict()
        return {"shares": dict(self.shares), "simple": simple, "scale": scale}

    def turned(self, calibrated: float, declared: float) -> float:
        """Return the cost of a radian [J, or A s] of which the calibrated model says `calibrated` and the model before
        `declared`.
        """
        own, before = self.shares.get(CALIBRATED, 0.0), self.shares.get(BEFORE, 0.0)
        simple = sum(self.shares[name] * term.by_name.get("turned", 0.0) for name, term in self.simple.items())
        return own * calibrated + before * declared + simple


def mean_of(shares: Mapping[str, float], said: Mapping[str, FloatArray]) -> FloatArray:
    """Return the mean of predictions with these shares, (n,)."""
    return np.asarray(sum(share * said[name] for name, share in shares.items()))
