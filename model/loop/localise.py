"""Where an effect acts: everywhere, or in a part of the operating range or of the map only."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.effects import Term, inside
from joulemap.model.loop.evidence import Evidence
from joulemap.model.loop.places import field_settings
from joulemap.model.loop.quantities import quantity
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

_OVER = ("grade", "cross_slope", "roughness", "hollow", "speed", "turning", "x", "y", "since_start")
_STEPS = np.linspace(0.1, 0.9, 9)
_LEAST_PART = 30  # segments on either side of a threshold
_WORTH = 0.15  # of what the effect explains must come on top
_OUTSIDE = 0.3  # of its strength inside is as good as none outside
_FINER = (0.7, 0.5)
_EVERYWHERE = frozenset({"disk", "place", "words", "by_run", "smooth", "drift"})


def localised(
    residuals: Residuals,
    terms: Sequence[Term],
    silent: Sequence[Term],
    *,
    whole: Collection[str] = (),
    progress: Callable[[], None] | None = None,
) -> list[Term]:
    """Restrict terms to the part of the operating range in which they act, if they clearly act in one part only.

    A part is taken if the held-out squared error falls by a good share of what the effect explains, in most folds, and
    if the effect is nearly absent outside. All thresholds over all quantities are tried.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    terms : sequence of Term
        To restrict.
    silent : sequence of Term
        Fitted along, as they are.
    whole : collection of str
        Names of terms that are left as they are.
    progress : callable, optional
        Called after each term.

    Returns
    -------
    list of Term
        In the order of `terms`.
    """
    out = list(terms)
    for k, term in enumerate(out):
        if term.formula == "place":
            out[k] = _sharpest(residuals, term, [*silent, *out[:k], *out[k + 1 :]])
        if term.formula in _EVERYWHERE or term.where or term.name in whole:
            continue
        parts = [replace(term, where=where).bent(residuals) for where in _parts(residuals)]
        if not parts:
            continue
        others = [*silent, *out[:k], *out[k + 1 :]]
        evidence = Evidence(residuals, [*others, term, *parts], level_doubt=0.0)
        fixed = np.concatenate([evidence.nuisance[:0], *evidence.columns[: len(others)]]).astype(np.int64)
        everywhere = np.concatenate([fixed, evidence.columns[len(others)]])
        error, without = evidence.held_out(everywhere), evidence.held_out(fixed)
        explained = float((without - error).sum())
        errors = [evidence.held_out(np.concatenate([fixed, c])) for c in evidence.columns[len(others) + 1 :]]
        best = int(np.argmin([e.sum() for e in errors]))
        fell = error - errors[best]
        both = np.concatenate([everywhere, evidence.columns[len(others) + 1 + best]])
        strength = evidence.coefficients(both)[fixed.size :].reshape(2, -1)  # outside; what is more inside
        outside = np.abs(strength[0]).sum() < _OUTSIDE * np.abs(strength.sum(axis=0)).sum()
        if fell.sum() > _WORTH * explained and (fell > 0).mean() > 0.6 and outside:
            out[k] = parts[best]
        if progress is not None:
            progress()
    return out


def _sharpest(residuals: Residuals, term: Term, others: Sequence[Term]) -> Term:
    """A field as fine as held-out runs support. It was found by the coarsest one, which cannot follow details."""
    drive = residuals.drive.take(residuals.moving)
    fields = [term]
    for finer in _FINER:
        settings = {**term.settings, **field_settings(drive, term.settings["width_m"] * finer)}
        field = replace(term, settings=settings, units=(term.units[0],) * len(settings["centres"]))
        fields.append(field.bent(residuals))
    evidence = Evidence(residuals, [*others, *fields], level_doubt=0.0)
    fixed = np.concatenate([evidence.nuisance[:0], *evidence.columns[: len(others)]]).astype(np.int64)
    errors = [evidence.held_out(np.concatenate([fixed, c])).sum() for c in evidence.columns[len(others) :]]
    return fields[int(np.argmin(errors))]


def _parts(residuals: Residuals) -> Iterator[Mapping[str, Any]]:
    drive, moving = residuals.drive, residuals.moving
    columns = [f"column:{key}" for key in ("temperature", "wind_speed", "payload") if key in drive.columns]
    for over in (*_OVER, *columns):
        values = quantity(drive, over)[moving]
        known = values[np.isfinite(values)]
        if known.size < 2 * _LEAST_PART or np.ptp(known) <= 0:
            continue
        for value in np.unique(np.quantile(known, _STEPS).round(6)):
            for side in ("above", "below"):
                yield from _if_large(residuals, {"over": over, side: float(value)})
    for key, words in drive.words.items():
        for word in np.unique(words[moving]):
            if word:
                yield from _if_large(residuals, {"word": key, "is": str(word)})


def _if_large(residuals: Residuals, where: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    part = inside(residuals.drive, where)[residuals.moving]
    if _LEAST_PART <= part.sum() <= part.size - _LEAST_PART:
        yield where
