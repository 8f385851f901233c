"""The whole procedure once: base parameters, the effects that the model lacks, and what is predicted with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop._base_step import base_step
from joulemap.model.loop._design import make_design
from joulemap.model.loop._proposal import simple_models
from joulemap.model.loop._selection import Selection, select
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms import UNNAMED
from joulemap.model.loop.forms._base_parameters import MEASURED_SLOPE
from joulemap.model.loop.forms.log_faults import LogFault
from joulemap.model.loop.terms import Effect, Term
from joulemap.model.runs.features import Drives, FloatArray, driven_ranges
from joulemap.model.runs.residuals import Residuals


@dataclass(frozen=True, eq=False)
class Fitted:
    """One run of the whole procedure."""

    selection: Selection  # the effects that were chosen
    base_low: FloatArray  # (k,), 95 % confidence intervals of the base parameters
    base_high: FloatArray
    effects: tuple[Effect, ...]  # those with a formula, then structure without; those that explain most first
    correction: Correction  # of the base model's prediction, by everything and by what is known before a drive
    base_terms: tuple[Term, ...]  # the base parameters alone, fitted for themselves
    in_logs: tuple[Term, ...]  # faults of the log beside the terms of plans, which are judged by that log
    scale: Term | None  # what makes a charge of the base model's prediction before any of this
    simple: dict[str, Term]  # what the calibration is judged beside: a constant, and few columns
    run_share: float  # standard deviation between runs that no effect explains, as a share of the energy

    @property
    def base(self) -> Term:
        """Corrections of the base parameters."""
        return self.correction.terms[0]

    def states(self, rows: Residuals, *, elsewhere: bool = False) -> dict[str, FloatArray]:
        """Predictions for some rows, (n,) [J, or A s], by state: before, corrected (with the base parameters), after,
        after_planner, constant and least_squares.

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
            "after_planner": _with([*self.correction.planner_terms, *self.in_logs]),
        } | {key: term.energy(rows.features) for key, term in self.simple.items()}


def fit(
    rows: Residuals,
    new: NDArray[np.bool_],
    *,
    progress: Callable[[float], None] | None = None,
) -> Fitted:
    """Run the whole procedure once. `progress` is called with the share of the work that is done, 0..1.

    rows : of the baseline runs, where there are any, and of the new runs. new : False in the baseline runs, (n,).
    """
    rows, first, scale = base_step(rows, new)
    design = make_design(rows, new, first)
    named = [c for c in design.candidates if not isinstance(c.form, UNNAMED)]
    selection = select(design, named, progress=progress)
    base_terms = selection.estimate([])[-1]
    faults = [c for c in selection.chosen if isinstance(c.form, LogFault)]  # until they are known, all else is moved
    settled = selection.settled(faults or selection.chosen)
    selection = select(settled.design, design.candidates, () if faults else selection.taken)
    selection = selection.settled(selection.chosen)
    estimate, index, terms = selection.estimate(selection.chosen)
    effects, (low, high) = [], estimate.interval()
    for verdict in selection.taken:
        own = np.isin(index, verdict.candidate.tested)
        term = Term(verdict.candidate.form, tuple(estimate.coefficients[own].tolist()))
        effects.append(Effect(term, low[own], high[own], verdict.p_value, verdict.gain, verdict.between))
    fixed = np.isin(index, selection.design.fixed)
    planned = [c for c in selection.chosen if c.form.known_before or isinstance(c.form, LogFault)]
    planner = selection if len(planned) == len(selection.chosen) else selection.settled(planned)
    planner_terms = planner.estimate(planned, without=(MEASURED_SLOPE,))[-1]
    in_logs = tuple(term for term in planner_terms if isinstance(term.form, LogFault))
    planner_terms = tuple(term for term in planner_terms if term not in in_logs)
    ranges = driven_ranges(rows.features.take(np.flatnonzero(new)))
    drives = selection.design.residuals.features.drives
    correction = Correction(terms, planner_terms, ranges, drives, first, rows.charge)
    ranked = tuple(sorted(effects, key=lambda e: (isinstance(e.term.form, UNNAMED), -e.share)))
    run_share = float(np.sqrt(estimate.tau2 * selection.model.sigma2(index)))
    simple = simple_models(rows.take(np.flatnonzero(new)))
    ends = low[fixed], high[fixed]
    return Fitted(selection, *ends, ranked, correction, base_terms, in_logs, scale, simple, run_share)
