"""The threshold at which an effect that is limited to a part of the operating range begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from joulemap.model.loop.effects import Term, inside
from joulemap.model.loop.evidence import Evidence
from joulemap.model.loop.quantities import quantity
from joulemap.model.loop.residual import Residuals

_STEPS = np.linspace(0.05, 0.95, 37)
_LEAST_PART = 30  # segments on either side of a threshold


def bounded(residuals: Residuals, terms: Sequence[Term], silent: Sequence[Term]) -> tuple[list[Term], list[list[Term]]]:
    """Choose the threshold of every limited term by the held-out error.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    terms : sequence of Term
        Of which those that act above or below a value are changed.
    silent : sequence of Term
        Fitted along, as they are.

    Returns
    -------
    tuple of (list of Term, list of list of Term)
        The terms with the threshold of least held-out squared error; and all terms again, once for every other
        threshold whose error is larger by at most one standard error.

    References
    ----------
    Breiman et al. 1984, section 3.4.3.
    """
    out = list(terms)
    rivals: list[tuple[int, Term]] = []
    for k, term in enumerate(terms):
        if "over" not in term.where:
            continue
        moved = (replace(term, where=_moved(term, v)).bent(residuals) for v in _values(residuals, term))
        parts = [part for part in moved if inside(residuals.drive, part.where)[residuals.moving].sum() >= _LEAST_PART]
        others = [*silent, *out[:k], *out[k + 1 :]]
        evidence = Evidence(residuals, [*others, term, *parts], level_doubt=0.0)
        fixed = evidence.columns_of(range(len(others)))
        errors = np.stack([evidence.held_out(np.append(fixed, c)) for c in evidence.columns[len(others) :]])
        best = int(np.argmin(errors.sum(axis=1)))
        worse = errors - errors[best]
        near = worse.sum(axis=1) <= worse.std(axis=1, ddof=1) * np.sqrt(worse.shape[1])
        every = [term, *parts]
        out[k] = every[best]
        rivals += [(k, every[j]) for j in np.flatnonzero(near) if j != best]
    return out, [[*out[:k], rival, *out[k + 1 :]] for k, rival in rivals]


def _values(residuals: Residuals, term: Term) -> list[float]:
    values = quantity(residuals.drive, term.where["over"])[residuals.moving]
    return [float(v) for v in np.unique(np.quantile(values[np.isfinite(values)], _STEPS).round(6))]


def _moved(term: Term, value: float) -> dict[str, object]:
    return {"over": term.where["over"], "above" if "above" in term.where else "below": value}
