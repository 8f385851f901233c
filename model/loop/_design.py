"""What may be chosen: the columns of every candidate on the rows of all runs, and the variation around a choice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop._mixed_model import IntArray, MixedModel
from joulemap.model.loop._variation import Variation, fit_variation
from joulemap.model.loop.forms import CHANGES, NAMED, UNNAMED, Form
from joulemap.model.loop.forms._base_parameters import BaseParameters
from joulemap.model.loop.forms.log_faults import Energy, LogFault
from joulemap.model.loop.forms.structure import PlaceField
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.residuals import Residuals

_EXPENSIVE = 0.95  # quantile of the energies of rows
_CHEAP = 0.05  # of the usual energy of a metre: what costs less, or gives back, varies as much
_ROUNDS = 3
_STEP = 1e-3  # of a shift or a lag, for its derivative
_DIRECTED = frozenset({"heading", "wind_speed", "wind_from"})  # say something even where they are constant


@dataclass(frozen=True)
class Candidate:
    """A form with its columns in the design."""

    form: Form  # with its settings
    tested: IntArray  # columns whose coefficients are the effect
    beside: IntArray  # columns in the baseline runs too, whose coefficients are the base model's own error
    shared: IntArray  # to which of the tested ones each of them belongs
    new_only: bool  # whether the tested columns are nil in the baseline runs

    @property
    def both(self) -> IntArray:
        """All its columns."""
        return np.append(self.tested, self.beside)


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of everything that may be chosen, on the n rows of all runs."""

    residuals: Residuals  # of new runs, and of baseline runs where there are any
    new: NDArray[np.bool_]  # (n,), False in the baseline runs
    columns: FloatArray = field(repr=False)  # (n, k), the base parameters first
    low: FloatArray = field(repr=False)  # (k,), physical limits of the coefficients
    high: FloatArray = field(repr=False)
    base: BaseParameters
    candidates: tuple[Candidate, ...] = field(repr=False)  # all that are tested
    without: tuple[str, ...] = ()  # base parameters that are in no model
    beyond: FloatArray | float = 0.0  # what a fault of the log adds to its columns, (n,)
    first: FloatArray | None = None  # base parameters before any effect: levels are shares of their prediction

    @property
    def fixed(self) -> IntArray:
        """Columns of the base parameters in every model."""
        return np.flatnonzero([name not in self.without for name in self.base.names])

    @cached_property
    def first_of(self) -> dict[str, Candidate]:
        """The first variant of each name."""
        return {c.form.name: c for c in reversed(self.candidates)}

    def index(self, chosen: Sequence[Candidate]) -> IntArray:
        """Columns of the base parameters and of some candidates, one after the other, (q,)."""
        return np.concatenate([self.fixed, *(c.both for c in chosen)])

    def where(self, candidate: Candidate) -> NDArray[np.bool_]:
        """Rows in which it is tested, (n,)."""
        return self.new | (not candidate.new_only)

    def on(self, rows: Features) -> Design:
        """The same on rows with another prediction."""
        columns = self.columns.copy()
        columns[:, : len(self.base.names)] = self.base.columns(rows)
        for candidate in self.candidates:
            every = candidate.form.columns(rows)
            columns[:, candidate.tested] = every * self.where(candidate)[:, None]
            columns[:, candidate.beside] = every[:, candidate.shared]
        return replace(self, residuals=replace(self.residuals, features=rows), columns=columns, beyond=0.0)

    def about(self, candidate: Candidate, size: FloatArray, energy: Energy) -> Design:
        """The same with the columns of a fault of the log about its size, (k,). energy : of rows without it."""
        new, columns, beyond = np.flatnonzero(self.new), self.columns.copy(), np.zeros(len(self.new))
        rows = self.residuals.features.take(new)
        columns[np.ix_(new, candidate.tested)], beyond[new] = linearised(candidate.form, rows, size, energy)
        return replace(self, columns=columns, beyond=self.beyond + beyond)


def linearised(fault: Form, rows: Features, size: FloatArray, energy: Energy) -> tuple[FloatArray, FloatArray]:
    """Columns of a fault of the log about its size, (n, k), and what `simulated` adds to these times the size, (n,)."""
    assert isinstance(fault, LogFault)
    here = fault.simulated(rows, size, energy)
    changed = (fault.simulated(rows, size + step, energy) - here for step in _STEP * np.eye(len(size)))
    columns = np.stack(list(changed), axis=1) / _STEP
    return columns, here - columns @ size


def make_design(residuals: Residuals, new: NDArray[np.bool_], first: Term) -> Design:
    """The columns of all forms on the rows of all runs, without forms whose columns are nil there.

    new : False in the baseline runs, (n,). first : the base parameters before any effect.

    With baseline runs a law of the robot or of the ground is tested by its columns in the new runs, beside the same
    columns in all runs, as far as these cover them: what the baseline runs show as well is the base model's own error.
    A law of the weather may hold in both, and is tested so too.
    """
    rows = residuals.features
    shown = replace(
        rows, columns={k: v for k, v in rows.columns.items() if k not in residuals.refused or k in _DIRECTED}
    )
    base, compared = first.form, not new.all()
    assert isinstance(base, BaseParameters)
    kinds: tuple[type[Form], ...] = (*NAMED, *(CHANGES if compared else ()), *UNNAMED)
    parameters = base.columns(rows)
    coverage = _coverage(residuals, parameters, new) if compared else None
    blocks, candidates, count = [parameters], [], len(base.names)
    energy = np.maximum(np.abs(residuals.measured), np.abs(residuals.said))[new]
    low, high = [base.lowest(rows)], [np.full(count, np.inf)]

    def _add(form: Form, columns: FloatArray, shared: IntArray, *, new_only: bool) -> None:
        nonlocal count
        blocks.extend([columns * new[:, None] if new_only else columns, columns[:, shared]])
        tested = count + np.arange(columns.shape[1])
        beside = count + columns.shape[1] + np.arange(len(shared))
        candidates.append(Candidate(form, tested, beside, shared, new_only))
        count += columns.shape[1] + len(shared)
        least, most = _limits(columns[new], energy) if form.on_map else np.full((2, len(tested)), [[-np.inf], [np.inf]])
        low.append(np.append(np.maximum(form.low, least), np.full(len(shared), -np.inf)))
        high.append(np.append(np.minimum(form.high, most), np.full(len(shared), np.inf)))

    for form in (form for kind in kinds for form in kind.variants(shown.take(np.flatnonzero(new)))):
        columns = form.columns(rows)
        if not compared and (
            isinstance(form, PlaceField) or (isinstance(form, UNNAMED) and form.covariates == ("grade",))
        ):
            continue  # without baseline runs these are the base model's own errors, of the slope and of the map
        if not np.all(np.abs(columns[new]).max(axis=0) > 0.0) or not np.isfinite(columns).all():
            continue
        nothing = np.zeros(0, dtype=np.int64)
        if not compared or form.weather:
            _add(form, columns, nothing, new_only=False)
        if compared and isinstance(form, CHANGES):
            _add(form, columns, nothing, new_only=True)
        elif coverage is not None:
            form = form.against_baseline()
            columns = form.columns(rows)
            _add(form, columns, np.flatnonzero(coverage(columns)), new_only=True)
    ends, values = (np.concatenate(low), np.concatenate(high)), np.asarray(first.coefficients)
    return Design(residuals, new, np.concatenate(blocks, axis=1), *ends, base, tuple(candidates), first=values)


def _limits(columns: FloatArray, energy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest value of each coefficient, (k,): an effect takes no more than all the energy, (n,), of the
    rows in which it is at work, and gives back no more than an expensive row takes, as these rows may without it.
    """
    size = np.abs(columns)
    total = np.maximum(size.sum(axis=0), 1e-300)
    mine = (size > 0.0) * energy[:, None]
    without = (size > 0.0) * np.maximum(energy, np.quantile(energy, _EXPENSIVE))[:, None]
    return -without.sum(axis=0) / total, mine.sum(axis=0) / total


def _coverage(
    residuals: Residuals, parameters: FloatArray, new: NDArray[np.bool_]
) -> Callable[[FloatArray], NDArray[np.bool_]]:
    """How to say which columns, (k,), the baseline runs say as much about as ten rows of the new runs (Harrell 2015,
    section 4.4); of the others they say nothing.
    """
    said = residuals.said

    def _basis(part: NDArray[np.bool_]) -> FloatArray:
        levels = np.stack([(residuals.run[part] == k) * said[part] for k in np.unique(residuals.run[part])], axis=1)
        left, size, _ = np.linalg.svd(np.concatenate([parameters[part], levels], axis=1), full_matrices=False)
        return left[:, size > np.finfo(float).eps * len(left) * size[0]]

    bases = [(part, _basis(part)) for part in (~new, new)]

    def _covered(columns: FloatArray) -> NDArray[np.bool_]:
        left = [((columns[part] - q @ (q.T @ columns[part])) ** 2).sum(axis=0) for part, q in bases]
        return np.asarray(left[0] >= 10.0 * left[1] / max(int(new.sum()), 1))

    return _covered


def fit_model(design: Design, chosen: Sequence[Candidate], start: Variation | None = None) -> MixedModel:
    """Fit the variation around a choice of effects: all columns under it, for tests.

    start : the variation around another choice, from which the fit starts.
    """
    residuals, index, energy = design.residuals, design.index(chosen), np.zeros(len(design.new))
    x, said = design.columns[:, index], residuals.said
    z = residuals.measured - said - design.beyond
    usual = np.maximum(said, max(float(np.median(np.abs(residuals.measured))), 1e-12))
    variation = start or Variation(residuals.run, residuals.moving, usual, np.ones(len(z)))
    for _ in range(1 if start else 2):  # the spread needs a fit, and the fit a spread
        energy = x @ _mean_of(design, index, variation, energy)
        grown = np.where(residuals.moving, energy, np.maximum(energy, 0.0))  # a stop varies as if declared, or more
        variation = fit_variation(variation, said + grown, z - energy, x)
    return _under(design, variation, energy)


def mean_model(design: Design, chosen: Sequence[Candidate], start: Variation) -> MixedModel:
    """All columns under a variance in proportion to the energy, for estimates of the mean.

    Whatever the variance is, such a fit makes the sums of what is predicted and measured agree (quasi-likelihood of
    Poisson's variance: McCullagh & Nelder 1989, section 9.2; Santos Silva & Tenreyro 2006). A standard deviation in
    proportion to the energy, which tests have, lets the cheap metres decide where no law fits all of them; weights of
    outliers pull a mean to the median.

    start : the variation around the choice, for tests.
    """
    residuals, index = design.residuals, design.index(chosen)
    variation = fit_model(design, chosen, start).variation
    size = float(np.linalg.norm(variation.scale[residuals.moving]))
    usual = float(np.median(np.abs(residuals.measured[residuals.moving])))
    for _ in range(_ROUNDS):  # the variance follows the mean, and the mean the variance
        energy = residuals.said + design.columns[:, index] @ _mean_of(design, index, variation)
        scale = np.sqrt(np.maximum(np.abs(energy), _CHEAP * usual))
        scale *= size / float(np.linalg.norm(scale[residuals.moving]))
        variation = replace(variation, scale=scale, weight=np.ones_like(scale))
    return _under(design, variation)


def _mean_of(design: Design, index: IntArray, variation: Variation, energy: FloatArray | float = 0.0) -> FloatArray:
    """Coefficients of some columns, (q,), within their limits."""
    model = _under(design, variation, energy, index)
    return model.coefficients(np.arange(len(index)), design.low[index], design.high[index])


def _under(
    design: Design, variation: Variation, energy: FloatArray | float = 0.0, index: IntArray | slice = np.s_[:]
) -> MixedModel:
    """All columns, or some, under a variation. energy : of base parameters, (n,), where the design has none."""
    residuals, first = design.residuals, design.first
    known = np.zeros(len(residuals)) if residuals.charge else residuals.features.predicted  # what base parameters move
    level = known + (energy if first is None else design.columns[:, design.fixed] @ first[design.fixed])
    z, worth = residuals.measured - residuals.said - design.beyond, _prior_rows(design, variation)
    columns = design.columns[:, index]
    return MixedModel(variation, columns, z, level, residuals.unit, worth[index], whole_runs=residuals.whole_runs)


def _prior_rows(design: Design, variation: Variation) -> FloatArray:
    """Rows that each column's prior is worth, (k,): one of an effect; a base parameter's is as wide as all energy."""
    energy = np.maximum(np.abs(design.residuals.measured), np.abs(design.residuals.said))
    worth = 1.0 / max(float(np.mean((energy / variation.scale) ** 2)), 1e-12)
    return np.where(np.isin(np.arange(design.columns.shape[1]), design.fixed), worth, 1.0)
