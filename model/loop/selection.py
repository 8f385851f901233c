"""Which effects the runs show: forward selection by left-out runs, each candidate with a p-value of its own.

At every step each candidate is tested beside what is chosen already, inside runs and between them. Of those that are
significant, and whose gain on left-out runs exceeds its standard error, the simplest is taken whose gain is within one
standard error of the largest: first among forms with a name, then among those without, which are asked what remains.
At the end whatever is no longer significant beside the others is dropped.

References
----------
Hastie, Tibshirani & Friedman 2009, sections 3.3.2 (forward stepwise selection) and 7.10 (one-standard-error rule).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from joulemap.model.loop.features import Drives
from joulemap.model.loop.forms import CHANGES, NAMED, NOT_OF_SLOPE, UNNAMED, Form
from joulemap.model.loop.forms.base_parameters import SCALE, BaseParameters, with_base_parameters
from joulemap.model.loop.forms.structure import PlaceField
from joulemap.model.loop.mixed_model import Estimate, MixedModel, columns_of
from joulemap.model.loop.residuals import Residuals
from joulemap.model.loop.terms import Term
from joulemap.model.loop.variation import HUBER, Variation, fit_variation, starts_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ALPHA = 0.01
"""Largest p-value of an effect, allowing for every test: one false find in a hundred calibrations."""
LEAST_GAIN = 0.05
"""Setting: share of the left-out squared error by which an effect must reduce it to be worth a line in a report. With
thousands of rows every small error of a base model is significant (Cohen 1994)."""
_MOST_LOST = 0.6
"""Share of the declared rolling resistance that may be losses of the drives, which hold no robot back on a descent:
an efficiency of 40 %, about that of a small gear motor."""
_DIRECTED = frozenset({"heading", "wind_speed", "wind_from"})  # say something even where they are constant
_STEEPEST = 0.3
"""Largest tangent on which a robot coasts beyond the declared one: sand (Wong 2008, table 4.1)."""
MOST_EFFECTS = 8
"""A report of more effects is a model of the noise, or of a base model that is no model of this robot."""


@dataclass(frozen=True)
class Candidate:
    """A form with its columns in the design.

    Attributes
    ----------
    form : Form
        With its settings.
    tested : ndarray of int
        Columns whose coefficients are the effect.
    beside : ndarray of int
        Columns in the baseline runs too, whose coefficients are the base model's own error.
    shared : ndarray of int
        To which of the tested ones each of them belongs.
    """

    form: Form
    tested: IntArray
    beside: IntArray
    shared: IntArray

    @property
    def both(self) -> IntArray:
        """All its columns."""
        return np.append(self.tested, self.beside)

    @property
    def complexity(self) -> tuple[bool, int]:
        """Whether it has no formula, and its number of coefficients: the order of simplicity."""
        return isinstance(self.form, UNNAMED), len(self.tested) + self.form.tuned


class Verdict(NamedTuple):
    """What the runs say of a candidate beside the chosen ones.

    Attributes
    ----------
    p_value : float
        Allowing for every test.
    gain : float
        Reduction of the left-out error, as a share of the error without it.
    gains : ndarray of float, (units,)
        Reduction by unit.
    between : bool
        Whether the levels of runs show it more clearly than their course.
    why_not : str
        Why it cannot be taken; empty where it can.
    """

    p_value: float
    gain: float
    gains: FloatArray
    between: bool
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class Design:
    """Columns of everything that may be chosen, on the rows of all runs.

    Attributes
    ----------
    residuals : Residuals
        Of new runs, and of baseline runs where there are any.
    new : ndarray of bool, (n,)
        False in the baseline runs.
    columns : ndarray of float, (n, k)
        The base parameters first.
    base : Form
        Of the base parameters.
    candidates : tuple of Candidate
        All that are tested.
    """

    residuals: Residuals
    new: NDArray[np.bool_]
    columns: FloatArray = field(repr=False)
    base: BaseParameters
    candidates: tuple[Candidate, ...] = field(repr=False)

    @property
    def fixed(self) -> IntArray:
        """Columns of the base parameters."""
        return np.arange(len(self.base.coefficient_names()))


@dataclass(frozen=True, eq=False)
class Selection:
    """What was chosen.

    Attributes
    ----------
    chosen : tuple of Candidate
        In the order in which they were taken.
    verdicts : tuple of Verdict
        Of each chosen one beside the others.
    design : Design
        From which they were chosen.
    variation : Variation
        Around the chosen model.
    alone, last : list of Verdict
        Of every candidate beside the base parameters, and beside the chosen ones.
    model : MixedModel
        Of the chosen variation.
    """

    chosen: tuple[Candidate, ...]
    verdicts: tuple[Verdict, ...]
    design: Design
    variation: Variation
    alone: list[Verdict]
    last: list[Verdict]
    model: MixedModel

    def estimate(
        self, keep: Callable[[Form], bool] = lambda form: True, names: tuple[str, ...] | None = None
    ) -> tuple[list[Candidate], Estimate, IntArray]:
        """Fit the coefficients of the chosen effects.

        Parameters
        ----------
        keep : callable
            Says which forms are fitted.
        names : tuple of str, optional
            Base parameters that are fitted; all without it.

        Returns
        -------
        tuple of (list of Candidate, Estimate, ndarray of int)
            Those that are kept; the coefficients; and the columns to which they belong.
        """
        kept = [c for c in self.chosen if keep(c.form)]
        levels = [c.tested for c, v in zip(self.chosen, self.verdicts, strict=True) if v.between and keep(c.form)]
        index, low, high = _limits(self.design, kept, names)
        model = self.model if names is None else fit_model(self.design, kept, self.variation, names)[1]
        return kept, model.estimate(index, low, high, columns_of(levels)), index


def rivals_of(selection: Selection) -> dict[str, list[str]]:
    """Return the candidates that these runs cannot distinguish from the effects that were chosen.

    Parameters
    ----------
    selection : Selection
        What was chosen.

    Returns
    -------
    dict of str to list of str
        For an effect, the candidates in whose place the left-out error is within one standard error; only effects that
        have any.
    """
    design, model = selection.design, selection.model
    now = columns_of([design.fixed, *(c.both for c in selection.chosen)])
    tau2 = model.tau2(now)
    error = model.left_out(now, tau2)
    names = {c.form.name for c in selection.chosen}
    out: dict[str, list[str]] = {}
    for effect in selection.chosen:
        others = columns_of([design.fixed, *(c.both for c in selection.chosen if c is not effect)])
        for k, verdict in enumerate(selection.alone):
            rival = design.candidates[k]
            known = out.get(effect.form.name, [])
            if verdict.p_value > ALPHA or rival.form.name in names or rival.form.name in known:
                continue
            more = model.left_out(np.append(others, rival.both), tau2) - error
            if float(more.sum()) <= float(more.std(ddof=1)) * np.sqrt(more.size):
                out.setdefault(effect.form.name, []).append(rival.form.name)
    return out


def drives_of(residuals: Residuals) -> Drives:
    """Return where the drives coast.

    Parameters
    ----------
    residuals : Residuals
        Of all runs, as declared.

    Returns
    -------
    Drives
        With the least squared error of the base parameters beside effects that say nothing of the slope, scaled by the
        energy; outliers count in proportion to their size only. As declared where that is no better by `LEAST_GAIN`.
    """
    scale = np.maximum(np.abs(residuals.said), float(np.median(np.abs(residuals.measured))))
    levels = [(residuals.unit == u) * np.maximum(residuals.said, 0.0) for u in np.unique(residuals.unit)]

    def _rest(drives: Drives) -> FloatArray:
        moved = residuals.driven_by(drives)
        forms = (next(kind.variants(moved.features), None) for kind in NOT_OF_SLOPE)
        others = [form.columns(moved.features) for form in forms if form is not None]
        base = BaseParameters.of(charge=moved.charge, motors=moved.motors)
        x = np.column_stack([base.columns(moved.features), *others, *levels]) / scale[:, None]
        z = (moved.measured - moved.said) / scale
        return np.abs(z - x @ np.linalg.solve(x.T @ x + 1e-9 * len(z) * np.eye(x.shape[1]), x.T @ z))

    declared = residuals.features.drives
    limit = max(HUBER * 1.4826 * float(np.median(_rest(declared))), 1e-12)

    def _error(drives: Drives) -> float:
        away = _rest(drives) / limit
        return float(np.where(away < 1.0, away**2, 2.0 * away - 1.0).sum())

    tried = np.linspace(-_MOST_LOST * residuals.features.robot.rolling_resistance, _STEEPEST, 17)
    k = int(np.argmin([_error(replace(declared, coasting_shift=float(shift))) for shift in tried]))
    found = minimize_scalar(
        lambda shift: _error(replace(declared, coasting_shift=float(shift))),
        bounds=(tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]),
        method="bounded",
        options={"xatol": 1e-3},
    )
    better = float(found.fun) < (1.0 - LEAST_GAIN) * _error(declared)
    return replace(declared, coasting_shift=float(found.x)) if better else declared


def base_step(residuals: Residuals, known: Residuals) -> tuple[Residuals, Term]:
    """Fit the base parameters alone, before any effect.

    Parameters
    ----------
    residuals : Residuals
        Of all runs, as declared.
    known : Residuals
        Of the runs to fit: those of the baseline, where there are any, since no effect is at work there.

    Returns
    -------
    tuple of (Residuals, Term)
        All rows with what the base parameters make of the energy of motion; and the base parameters.
    """
    drives = drives_of(known)
    moved, fitted = residuals.driven_by(drives), known.driven_by(drives)
    term = _alone(fitted, BaseParameters.of(charge=fitted.charge, motors=fitted.motors))
    return replace(moved, features=with_base_parameters(moved.features, term.form, np.asarray(term.coefficients))), term


def scale_of(residuals: Residuals) -> Term:
    """Fit the scale and the zero that make a charge of the base model's prediction, as that of a battery.

    Parameters
    ----------
    residuals : Residuals
        Of a charge.

    Returns
    -------
    Term
        What the base model says before a calibration.
    """
    return _alone(residuals.driven_by(Drives()), BaseParameters(SCALE))


def _alone(residuals: Residuals, base: BaseParameters) -> Term:
    """Base parameters fitted without any effect."""
    empty = Design(residuals, np.ones(len(residuals), dtype=bool), base.columns(residuals.features), base, ())
    _, model = fit_model(empty, [])
    index, low, high = _limits(empty, [])
    return Term(base, tuple(model.estimate(index, low, high, index[:0]).coefficients.tolist()))


def make_design(residuals: Residuals, new: NDArray[np.bool_], refused: Sequence[str]) -> Design:
    """Return the columns of all forms on some rows.

    Parameters
    ----------
    residuals : Residuals
        Of all runs.
    new : ndarray of bool, (n,)
        False in the baseline runs.
    refused : sequence of str
        Logged columns that no effect may depend on.

    Returns
    -------
    Design
        Forms whose columns are nil on these rows are left out.

    Notes
    -----
    With baseline runs a law of the robot or of the ground is tested by its columns in the new runs, beside the same
    columns in all runs, as far as these cover them: what the baseline runs show as well is the base model's own error.
    A law of the weather may hold in both, and is tested so too.
    """
    rows = residuals.features
    shown = replace(rows, columns={k: v for k, v in rows.columns.items() if k not in refused or k in _DIRECTED})
    base = BaseParameters.of(charge=residuals.charge, motors=residuals.motors)
    compared = not new.all()
    kinds: tuple[type[Form], ...] = (*NAMED, *(CHANGES if compared else ()), *UNNAMED)
    parameters = base.columns(rows)
    blocks, candidates, count = [parameters], [], len(base.names)

    def _add(form: Form, columns: FloatArray, every: FloatArray, shared: IntArray) -> None:
        nonlocal count
        blocks.extend([columns, every[:, shared]])
        tested = count + np.arange(columns.shape[1])
        beside = count + columns.shape[1] + np.arange(len(shared))
        candidates.append(Candidate(form, tested, beside, shared))
        count += columns.shape[1] + len(shared)

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
            _add(form, columns, columns, nothing)
        if compared and isinstance(form, CHANGES):
            _add(form, columns * new[:, None], columns, nothing)
        elif compared:
            form = form.against_baseline()
            columns = form.columns(rows)
            covered = np.flatnonzero(_covered(residuals, columns, parameters, new))
            _add(form, columns * new[:, None], columns, covered)
    return Design(residuals, new, np.concatenate(blocks, axis=1), base, tuple(candidates))


def _covered(
    residuals: Residuals, columns: FloatArray, parameters: FloatArray, new: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which columns, (k,), the baseline runs say as much about as ten rows of the new runs (Harrell 2015, section 4.4);
    of the others they say nothing.
    """
    left = []
    for part in (~new, new):
        run = residuals.run[part]
        levels = np.stack([(run == k) * residuals.said[part] for k in np.unique(run)], axis=1)
        beside = np.concatenate([parameters[part], levels], axis=1)
        fit = np.linalg.lstsq(beside, columns[part], rcond=None)[0]
        left.append(((columns[part] - beside @ fit) ** 2).sum(axis=0))
    return np.asarray(left[0] >= 10.0 * left[1] / max(int(new.sum()), 1))


def select(design: Design, *, progress: Callable[[float], None] | None = None) -> Selection:
    """Choose effects.

    Parameters
    ----------
    design : Design
        With the candidates.
    progress : callable, optional
        Called with the share of the work that is done, 0..1.

    Returns
    -------
    Selection
        Without effects where none is significant.
    """
    chosen: list[Candidate] = []
    between: dict[str, bool] = {}
    seen: set[frozenset[int]] = set()
    _, model = fit_model(design, _largest(design))

    def _judge(candidates: Sequence[Candidate]) -> list[Verdict]:
        return [_verdict(design, model, c, [o for o in chosen if o is not c], between) for c in candidates]

    alone = verdicts = _judge(design.candidates)
    for unnamed in (False, True):  # what has no name is asked what remains
        while len(chosen) < MOST_EFFECTS and (best := _simplest(design, verdicts, chosen, unnamed=unnamed)) is not None:
            taken = design.candidates[best]
            names = [c.form.name for c in chosen]
            at = names.index(taken.form.name) if taken.form.name in names else len(chosen)
            parts = _missing_parts(design, taken, chosen)
            chosen[at : at + 1] = [taken, *parts]
            between |= dict.fromkeys([c.form.name for c in (taken, *parts)], verdicts[best].between)
            verdicts = _judge(design.candidates)
            if (now := frozenset(map(id, chosen))) in seen:  # two forms of one effect that take turns
                break
            seen.add(now)
            if progress is not None:
                progress(len(chosen) / (MOST_EFFECTS + 1))
    final = _judge(chosen)
    while chosen:
        worst = max(range(len(chosen)), key=lambda k: (bool(final[k].why_not), final[k].p_value))
        needed = {name for c in chosen for name in c.form.parts}
        if (final[worst].p_value <= ALPHA and not final[worst].why_not) or chosen[worst].form.name in needed:
            break
        chosen.pop(worst)
        final, verdicts = _judge(chosen), _judge(design.candidates)
    variation, last = fit_model(design, chosen)
    return Selection(tuple(chosen), tuple(final), design, variation, alone, verdicts, last)


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


def fit_model(
    design: Design,
    chosen: Sequence[Candidate],
    start: Variation | None = None,
    names: tuple[str, ...] | None = None,
) -> tuple[Variation, MixedModel]:
    """Fit the variation around a choice of effects.

    Parameters
    ----------
    design : Design
        With the columns.
    chosen : sequence of Candidate
        The choice.
    start : Variation, optional
        Around another choice, from which the fit starts.
    names : tuple of str, optional
        Base parameters in the model; all without it.

    Returns
    -------
    tuple of (Variation, MixedModel)
        The variation, and all columns under it.
    """
    residuals = design.residuals
    index, low, high = _limits(design, chosen, names)
    x = design.columns[:, index]
    said, z = residuals.said, residuals.measured - residuals.said
    size = max(float(np.median(np.abs(residuals.measured))), 1e-12)
    variation = start or Variation(
        residuals.run,
        starts_of(residuals.run, residuals.moving),
        residuals.moving,
        np.maximum(np.maximum(said, 0.0), size),
        np.ones(len(z)),
    )
    own = np.arange(len(index))
    fixed = len(index) - sum(len(c.both) for c in chosen)
    level = np.maximum(np.maximum(said, 0.0), size)
    for _ in range(1 if start else 2):  # the spread needs a fit, and the fit a spread
        model = MixedModel(variation, x, z, level, residuals.unit, whole_runs=residuals.whole_runs)
        coefficients = model.estimate(own, low, high, own[:0]).coefficients
        energy, level = x @ coefficients, said + x[:, :fixed] @ coefficients[:fixed]
        variation = fit_variation(variation, said + energy, z - energy, x)
    every = MixedModel(variation, design.columns, z, level, residuals.unit, whole_runs=residuals.whole_runs)
    return variation, every


def _limits(
    design: Design, chosen: Sequence[Candidate], names: tuple[str, ...] | None = None
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Columns of the base parameters and of a choice, with the physical limits of their coefficients."""
    kept = np.array([names is None or name in names for name in design.base.names])
    base = design.base.lowest(design.residuals.features)[kept]
    index, low, high = [design.fixed[kept]], [base], [np.full(len(base), np.inf)]
    for c in chosen:
        k, m = len(c.tested), len(c.beside)
        index.append(c.both)
        low.append(np.concatenate([np.full(k, c.form.low), np.full(m, -np.inf)]))
        high.append(np.concatenate([np.full(k, c.form.high), np.full(m, np.inf)]))
    return columns_of(index), np.concatenate(low), np.concatenate(high)


def _verdict(
    design: Design, model: MixedModel, candidate: Candidate, chosen: Sequence[Candidate], between: dict[str, bool]
) -> Verdict:
    """Test one candidate beside the chosen ones. Half of the error of the first kind goes to each family of tests."""
    nothing = np.zeros(model.units)
    now = columns_of([design.fixed, *(c.both for c in chosen)])
    replaced = any(c.form.name == candidate.form.name for c in chosen)
    chosen = [c for c in chosen if c.form.name != candidate.form.name]  # another form of one effect takes its place
    parts = _missing_parts(design, candidate, chosen)
    if len(parts) < len(set(candidate.form.parts) - {c.form.name for c in chosen}):
        return Verdict(1.0, 0.0, nothing, False, f"it needs {' and '.join(candidate.form.parts)} beside it")
    tested = columns_of([candidate.tested, *(c.tested for c in parts)])
    beside = columns_of([design.fixed, candidate.beside, *(c.beside for c in parts), *(c.both for c in chosen)])
    levels = columns_of([c.tested for c in chosen if between[c.form.name]])
    inside = model.test_within(tested, beside)
    across = model.test_between(tested, beside, levels)
    count = len(design.candidates)
    p_value = min(1.0, 2.0 * count * min(inside.p_value, across.p_value))
    if p_value > ALPHA:
        return Verdict(p_value, 0.0, nothing, across.p_value < inside.p_value, "not significant")
    tau2 = model.tau2(np.append(beside, tested))
    whole = across.p_value < inside.p_value
    without = model.left_out(now, tau2)
    gains = without - model.left_out(np.append(beside, tested), tau2)
    total, gain = float(gains.sum()), float(gains.sum()) / max(float(without.sum()), 1e-12)
    why_not = ""
    if total <= float(gains.std(ddof=1)) * np.sqrt(gains.size):
        why_not = "its gain on left-out runs is within one standard error of none"
    elif gain < LEAST_GAIN and not replaced:
        why_not = f"it explains less than {LEAST_GAIN:.0%} of the error on left-out runs"
    elif not _physical(model, candidate, beside):
        why_not = "its coefficient has an impossible sign or size"
    return Verdict(p_value, gain, gains, whole, why_not)


def _missing_parts(design: Design, candidate: Candidate, chosen: Sequence[Candidate]) -> list[Candidate]:
    """The main effects that an interaction brings with it: the first variant of each that is not chosen yet."""
    known = {c.form.name for c in chosen}
    first: dict[str, Candidate] = {}
    for other in design.candidates:
        first.setdefault(other.form.name, other)
    return [first[name] for name in candidate.form.parts if name not in known and name in first]


def _physical(model: MixedModel, candidate: Candidate, beside: IntArray) -> bool:
    """Whether the free estimate lies within the physical limits."""
    form, k = candidate.form, len(candidate.tested)
    if not (np.isfinite(form.low) or np.isfinite(form.high)):
        return True
    index = np.append(candidate.tested, beside)
    gram = model.marginal(index, model.tau2(index)).sum(axis=0)
    free = np.linalg.solve(model.with_prior(gram[:-1, :-1]), gram[:-1, -1]) / model.size[index]
    return bool(np.all((free[:k] >= form.low) & (free[:k] <= form.high)))


def _simplest(design: Design, verdicts: Sequence[Verdict], chosen: Sequence[Candidate], *, unnamed: bool) -> int | None:
    """The simplest candidate whose gain is within one standard error of the largest."""
    able = [
        k
        for k, (verdict, candidate) in enumerate(zip(verdicts, design.candidates, strict=True))
        if not verdict.why_not
        and not any(candidate is c for c in chosen)
        and (unnamed or not isinstance(candidate.form, UNNAMED))
    ]
    if not able:
        return None
    top = verdicts[max(able, key=lambda k: verdicts[k].gain)]

    def near(k: int) -> bool:
        less = top.gains - verdicts[k].gains
        return float(less.sum()) <= float(less.std(ddof=1)) * np.sqrt(less.size)

    close = [k for k in able if near(k)]


    def _complexity(k: int) -> tuple[bool, int]:
        unnamed, count = design.candidates[k].complexity
        return unnamed, count + sum(c.complexity[1] for c in _missing_parts(design, design.candidates[k], chosen))

    return min(close, key=lambda k: (_complexity(k), -verdicts[k].gain))
