"""Which effects the runs show: stepwise selection by left-out runs, each candidate with a p-value of its own.

References: docs/explanation/calibration.md; Hastie, Tibshirani & Friedman 2009, sections 3.3.2 (stepwise selection) and
7.10 (one-standard-error rule).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from joulemap.model.loop._design import Candidate, Design, fit_model, mean_model
from joulemap.model.loop._mixed_model import Estimate, IntArray, MixedModel
from joulemap.model.loop.forms import UNNAMED
from joulemap.model.loop.forms._base_parameters import BaseParameters, with_base_parameters, with_forces
from joulemap.model.loop.forms.change import Change
from joulemap.model.loop.forms.log_faults import LogFault
from joulemap.model.loop.forms.structure import PlaceField
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import Features, FloatArray

ALPHA = 0.01
"""Largest p-value of an effect, allowing for every test: one false find in a hundred calibrations."""
LEAST_GAIN = 0.05
"""Setting: share of the left-out squared error that is worth a line in a report. With thousands of rows every small
error of a base model is significant (Cohen 1994)."""
_ROUNDS = 4
MOST_EFFECTS = 8
"""A report of more effects is a model of the noise, or of a base model that is no model of this robot."""


class Verdict(NamedTuple):
    """What the runs say of a candidate beside chosen ones."""

    candidate: Candidate
    p_value: float  # allowing for every test
    gain: float  # reduction of the left-out error, as a share of the error without it
    between: bool  # whether the levels of runs show it more clearly than their course
    why_not: str = ""  # why it cannot be taken; empty where it can

    @property
    def name(self) -> str:
        """That of its effect."""
        return self.candidate.form.name


@dataclass(frozen=True, eq=False)
class Selection:
    """What was chosen."""

    taken: tuple[Verdict, ...]  # on each chosen candidate beside the others
    design: Design
    alone: tuple[Verdict, ...]  # on every candidate beside the base parameters
    last: tuple[Verdict, ...]  # on every candidate beside the chosen ones
    model: MixedModel  # all columns under the variation around the chosen ones

    @property
    def chosen(self) -> list[Candidate]:
        """The chosen candidates."""
        return [verdict.candidate for verdict in self.taken]

    @property
    def by_name(self) -> dict[str, tuple[Verdict, Verdict]]:
        """What was said, alone and last, of the candidate of the smallest p-value alone, for each name."""
        pairs = zip(self.alone, self.last, strict=True)
        out: dict[str, tuple[Verdict, Verdict]] = {}
        for alone, last in sorted(pairs, key=lambda pair: (pair[0].p_value, -pair[0].gain)):
            out.setdefault(alone.name, (alone, last))
        return out

    @cached_property
    def rivals(self) -> dict[str, list[str]]:
        """Candidates that these runs cannot distinguish from the effects that were chosen, by effect: in its place
        their left-out error is within one standard error. Only effects that have any.
        """
        now = self.design.index(self.chosen)
        tau2 = self.model.tau2(now)
        error = self.model.left_out(now, tau2)
        names = {verdict.name for verdict in self.taken}
        possible = [v for v in self.alone if v.p_value <= ALPHA and v.name not in names]
        out = {}
        for effect in self.chosen:
            others = self.design.index([c for c in self.chosen if c is not effect])
            more = ((v, self.model.left_out(np.append(others, v.candidate.both), tau2) - error) for v in possible)
            out[effect.form.name] = list(dict.fromkeys(v.name for v, gains in more if within_one_error(gains)))
        return {name: rivals for name, rivals in out.items() if rivals}

    def estimate(
        self, kept: Sequence[Candidate], without: tuple[str, ...] = ()
    ) -> tuple[Estimate, IntArray, tuple[Term, ...]]:
        """Fit the base parameters and some effects together: the coefficients of the mean, the columns to which these
        belong, (q,), and the terms as new runs have them.

        without : base parameters that are not fitted.
        """
        design = replace(self.design, without=without)
        model = mean_model(design, kept, self.model.variation)
        index = design.index(kept)
        classes = [c.tested for c in kept if c.form.pooled]
        if classes:
            model = model.pooled(classes, index, design.fixed)
        estimate = model.estimate(index, design.low[index], design.high[index], design.fixed)
        return estimate, index, self._terms(kept, estimate.coefficients, index)

    def _terms(self, kept: Sequence[Candidate], coefficients: FloatArray, index: IntArray) -> tuple[Term, ...]:
        value = np.zeros(len(self.design.low))
        value[index] = coefficients
        base = BaseParameters(tuple(name for k, name in enumerate(self.design.base.names) if k in index))
        terms = [Term(base, tuple(coefficients[: len(base.names)].tolist()))]
        for candidate in kept:
            total = value[candidate.tested]
            total[candidate.shared] += value[candidate.beside]  # the base model's own error
            terms.append(Term(candidate.form, tuple(total.tolist())))
        return tuple(terms)

    def settled(self, kept: Sequence[Candidate]) -> Selection:
        """With some effects in what resists, and faults of the log about their size (Gauss-Newton)."""
        found, forces = self, [k for k, c in enumerate(kept) if c.form.resists]
        faults = [k for k, c in enumerate(kept) if isinstance(c.form, LogFault)]
        rows, new, first = self.design.residuals.features, self.design.new, np.asarray(self.design.first)
        known = self.design.residuals.moving & (new.all() | ~new)  # what the coasting was fitted to
        for _ in range(_ROUNDS if forces or faults else 0):
            design, (estimate, index, (base, *terms)) = found.design, found.estimate(kept)
            where = [design.where(kept[k]) for k in forces]
            costs = [lambda r, w=w, t=terms[k]: w * t.energy(r) for k, w in zip(forces, where, strict=True)]
            _, added = with_forces(rows, first, base.form, base.by_name, costs)
            if forces:
                rows = replace(rows, drives=replace(rows.drives, resisted_tan=float(added[known].mean())))
            design = design.on(with_forces(rows, first, base.form, base.by_name, costs)[0])
            for k in faults:
                size = estimate.coefficients[np.isin(index, kept[k].tested)]
                design = design.about(kept[k], size, partial(found._energy, [base, *terms[:k], *terms[k + 1 :]]))
            found = replace(found, design=design, model=fit_model(design, kept, self.model.variation))
        return found

    def _energy(self, terms: Sequence[Term], rows: Features) -> FloatArray:
        rows = with_base_parameters(rows, self.design.base, np.asarray(self.design.first))
        said = 0.0 if self.design.residuals.charge else rows.predicted
        return np.asarray(sum((t.energy(rows) for t in terms), start=said))


def within_one_error(gains: FloatArray) -> bool:
    """Whether the sum of differences by unit, (units,), is at most the standard error of the sum."""
    return float(gains.sum()) <= float(gains.std(ddof=1)) * np.sqrt(gains.size)


def select(
    design: Design,
    asked: Sequence[Candidate],
    start: Sequence[Verdict] = (),
    *,
    progress: Callable[[float], None] | None = None,
) -> Selection:
    """Choose effects among some candidates by stepwise selection (Efroymson 1960).

    start : the choice to begin with. `progress` is called with the share that is done, 0..1.
    """
    model, chosen, gone = fit_model(design, _largest(design)), list(start), set[int]()
    alone = tuple(_verdict(design, model, candidate, []) for candidate in asked)
    while True:
        own = [_verdict(design, model, v.candidate, [o for o in chosen if o is not v]) for v in chosen]
        needed = {name for v in chosen for name in v.candidate.form.parts}
        if failed := [k for k, verdict in enumerate(own) if verdict.why_not and verdict.name not in needed]:
            gone.add(id(chosen.pop(max(failed, key=lambda k: own[k].p_value)).candidate))
            continue
        last = tuple(_verdict(design, model, candidate, chosen) for candidate in asked) if chosen else alone
        gone |= {id(verdict.candidate) for verdict in chosen}  # what was dropped is not taken again
        able = [verdict for verdict in last if not verdict.why_not and id(verdict.candidate) not in gone]
        if not able or len(chosen) >= MOST_EFFECTS:
            return Selection(tuple(own), design, alone, last, fit_model(design, [v.candidate for v in chosen]))
        best = max(able, key=lambda verdict: verdict.gain)
        parts = _missing_parts(design, best.candidate, chosen)
        chosen = [v for v in chosen if v.name != best.name] + [
            best._replace(candidate=c) for c in (best.candidate, *parts)
        ]
        if progress is not None:
            progress(len(chosen) / (MOST_EFFECTS + 1))


def _largest(design: Design) -> list[Candidate]:
    """The first variant of every named form, as far as there are ten rows for each coefficient (Harrell 2015, section
    4.4): the variation is that around the largest model, so that no effect counts as noise in the test of another.
    """
    out: dict[str, Candidate] = {}
    room = len(design.residuals) // 10
    for candidate in design.candidates:
        known = sum(len(c.both) for c in out.values())
        smooth = isinstance(candidate.form, (*UNNAMED, PlaceField))  # would take the serial correlation for an effect
        if not smooth and known + len(candidate.both) <= room:
            out.setdefault(candidate.form.name, candidate)
    return list(out.values())


def _verdict(design: Design, model: MixedModel, candidate: Candidate, chosen: Sequence[Verdict]) -> Verdict:
    """Test one candidate beside the chosen ones. Half of the error of the first kind goes to each family of tests."""
    now = design.index([v.candidate for v in chosen])
    others = [v for v in chosen if v.name != candidate.form.name]  # another form of one effect takes its place
    parts = _missing_parts(design, candidate, others)
    if len(parts) < len(set(candidate.form.parts) - {v.name for v in others}):
        return Verdict(candidate, 1.0, 0.0, False, f"it needs {' and '.join(candidate.form.parts)} beside it")
    tested = np.concatenate([c.tested for c in (candidate, *parts)])
    beside = np.concatenate([design.index([v.candidate for v in others]), *(c.beside for c in (candidate, *parts))])
    levels = np.concatenate([now[:0], *(v.candidate.tested for v in others if v.between)])
    inside, across = model.test_within(tested, beside), model.test_between(tested, beside, levels)
    whole = across < inside
    in_time = isinstance(candidate.form, Change)  # whether the robot changed is another question than what it lacks
    tests = sum(isinstance(c.form, Change) == in_time for c in design.candidates)
    p_value = min(1.0, 2.0 * tests * min(inside, across))
    if p_value > ALPHA:
        return Verdict(candidate, p_value, 0.0, whole, "not significant")
    both = np.append(beside, tested)
    tau2 = model.tau2(both)
    without = model.left_out(now, tau2)
    gains = without - model.left_out(both, tau2)
    gain = float(gains.sum()) / max(float(without.sum()), 1e-12)
    if whole:  # a level hides what an effect explains of it
        error = float(model.left_out(now, tau2, whole=True).sum())
        gain = max(gain, 1.0 - float(model.left_out(both, tau2, whole=True).sum()) / max(error, 1e-12))
    why_not = ""
    if within_one_error(gains):
        why_not = "its gain on left-out runs is within one standard error of none"
    elif gain < LEAST_GAIN and len(others) == len(chosen):
        why_not = f"it explains less than {LEAST_GAIN:.0%} of the error on left-out runs"
    elif not _physical(design, model, candidate, beside):
        why_not = "its coefficient has an impossible sign or size"
    return Verdict(candidate, p_value, gain, whole, why_not)


def _missing_parts(design: Design, candidate: Candidate, chosen: Sequence[Verdict]) -> list[Candidate]:
    """The main effects that an interaction brings with it: the first variant of each that is not chosen yet."""
    known = {v.name for v in chosen}
    return [design.first_of[n] for n in candidate.form.parts if n not in known and n in design.first_of]


def _physical(design: Design, model: MixedModel, candidate: Candidate, beside: IntArray) -> bool:
    """Whether the free estimate lies within the physical limits."""
    every = np.append(candidate.tested, beside)
    low, high = (limits[candidate.tested] for limits in (design.low, design.high))
    if np.isinf(low).all() and np.isinf(high).all():
        return True
    free = model.coefficients(every, *np.full((2, every.size), [[-np.inf], [np.inf]]))[: low.size]
    return bool(np.all((free >= low) & (free <= high)))
