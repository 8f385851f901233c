"""The whole procedure once: base parameters, the effects that the model lacks, and what is predicted with them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from joulemap.model.loop._base_step import base_step
from joulemap.model.loop._design import make_design
from joulemap.model.loop._selection import Selection, select
from joulemap.model.loop.forms._base_parameters import MEASURED_SLOPE
from joulemap.model.loop.terms import Correction, Effect, Term
from joulemap.model.runs.features import Drives, FloatArray, driven_ranges
from joulemap.model.runs.residuals import Residuals, joined


@dataclass(frozen=True, eq=False)
class Fitted:
    """One run of the whole procedure."""

    selection: Selection  # the effects that were chosen
    base_low: FloatArray  # (k,), 95 % confidence intervals of the base parameters
    base_high: FloatArray
    effects: tuple[Effect, ...]  # those that explain most first
    correction: Correction  # of the base model's prediction, by everything and by what is known before a drive
    base_terms: tuple[Term, ...]  # the base parameters alone, fitted for themselves
    scale: Term | None  # what makes a charge of the base model's prediction before any of this
    run_share: float  # standard deviation between runs that no effect explains, as a share of the energy

    @property
    def base(self) -> Term:
        """Corrections of the base parameters."""
        return self.correction.terms[0]

    def states(self, rows: Residuals, *, elsewhere: bool = False) -> dict[str, FloatArray]:
        """Predictions for some rows, (n,) [J, or A s], by state: before, corrected (with the base parameters), after
        and after_planner.

        elsewhere : without what belongs to the map on which it was found.
        """
        before = rows.said if self.scale is None else self.scale.energy(rows.driven_by(Drives()).features)
        moved = rows.driven_by(self.correction.drives)

        def _with(terms: Sequence[Term]) -> FloatArray:
            kept = tuple(term for term in terms if not (elsewhere and term.form.of_map))
            return moved.said + replace(self.correction, terms=kept).added_energy(moved.features, planned=False)

        return {
            "before": before,
            "corrected": _with(self.base_terms),
            "after": _with(self.correction.terms),
            "after_planner": _with(self.correction.planner_terms),
        }


def fit(
    measured: Residuals,
    base: Residuals | None,
    refused: Collection[str],
    *,
    progress: Callable[[float], None] | None = None,
) -> Fitted:
    """Run the whole procedure once. `progress` is called with the share of the work that is done, 0..1.

    measured, base : of the new runs and, where there are any, of the baseline runs. refused : logged columns that no
    effect may depend on.
    """
    rows = measured if base is None else joined([base, measured])
    new = np.arange(len(rows)) >= len(rows) - len(measured)
    rows, first, scale = base_step(rows, new)
    selection = select(make_design(rows, new, refused, first), progress=progress)
    _, estimate, index = selection.estimate()
    low, high = estimate.interval()
    effects = []
    for candidate, verdict in zip(selection.chosen, selection.verdicts, strict=True):
        own = np.isin(index, candidate.tested)
        term = Term(candidate.form, tuple(estimate.coefficients[own].tolist()))
        effects.append(Effect(term, low[own], high[own], verdict.p_value, verdict.gain, verdict.between))
    own = np.isin(index, selection.design.fixed)
    terms, base_terms = selection.terms(), selection.terms(lambda form: False)
    planner_terms = selection.terms(lambda form: form.known_before, without=(MEASURED_SLOPE,))
    ranges = driven_ranges(measured.features)
    return Fitted(
        selection,
        low[own],
        high[own],
        tuple(sorted(effects, key=lambda e: -e.share)),
        Correction(terms, planner_terms, ranges, rows.features.drives, first, rows.charge),
        base_terms,
        scale,
        float(np.sqrt(estimate.between)),
    )
