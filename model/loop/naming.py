"""Interpretation of the effects found: which are causes, which are collinear covariates, and which candidates could
replace them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from joulemap.model.loop.selection import ALPHA, CURVES, Found, Search, interactions_of

_TOLERANCE = 0.1


def shadows_of(search: Search, found: Sequence[Found]) -> list[Found]:
    """Return the collinear covariates among the effects: they only correct the form of others.

    Parameters
    ----------
    search : Search
        That found them.
    found : sequence of Found
        All effects.

    Returns
    -------
    list of Found
        In the order of `found`.
    """
    causes = list(found)
    while shadows := [f for f in causes if not interactions_of(f, causes) and _shadow(search, causes, f)]:
        causes.remove(min(shadows, key=lambda f: search.worth(causes, f)))
    return [f for f in found if f not in causes]


def _shadow(search: Search, found: Sequence[Found], one: Found) -> bool:
    """Whether an effect is only a covariate of others.

    It is a curve over the ground, or over what responds to the drive on it, and the others explain nine tenths of all
    that it explains alone (a tolerance below 0.1: Marquardt 1970).
    """
    rest = [f.verdict.term for f in search.beside(found, one)]
    follows = one.candidate.response or search.evidence.terms[one.verdict.term].reads_ground
    if search.named(one) or not follows or not rest:
        return False
    own = [k for k, c in enumerate(search.owner) if c.name == one.candidate.name]
    alone = max(search.saved([], [k]) for k in own)
    return search.saved(rest, [one.verdict.term]) < _TOLERANCE * alone


def by_worth(search: Search, found: list[Found]) -> list[Found]:
    """Return the effects in order of importance; what responds to the drive comes after what explains it.

    Parameters
    ----------
    search : Search
        That found them.
    found : list of Found
        All effects.

    Returns
    -------
    list of Found
        The most important first.
    """
    return sorted(found, key=lambda f: (f.candidate.response, -search.worth(found, f)))


def _contains(search: Search, rival: int, term: int) -> bool:
    """Whether a rival is the same effect and something more."""
    its, mine = (search.evidence.x[:, search.evidence.columns[k]] for k in (rival, term))
    if its.shape[1] <= mine.shape[1]:
        return False
    rest = mine - its @ np.linalg.lstsq(its, mine, rcond=None)[0]
    return bool((rest**2).sum() < 1e-6 * (mine**2).sum())


def rivals(search: Search, found: Sequence[Found], one: Found) -> list[str]:
    """Return the candidates that could replace an effect: the held-out error would not grow by more than noise.

    Parameters
    ----------
    search : Search
        That found it.
    found : sequence of Found
        All effects.
    one : Found
        Of these.

    Returns
    -------
    list of str
        Names of candidates, without curves over the effect's own quantity.
    """
    rest = [f.verdict.term for f in found if f is not one]
    names = {CURVES.get(one.candidate.name), *(f.candidate.name for f in found)}
    mine = search.evidence.columns_of([*rest, one.verdict.term])
    gained = search.error(rest) - search.error([*rest, one.verdict.term])
    out = []
    for candidate, verdict in search.best_of_each([f for f in found if f is not one]):
        more = verdict.p_value <= ALPHA and search.clears_floor(verdict)
        if candidate.name in names or not (more or search.may_copy(verdict)):
            continue
        if _contains(search, verdict.term, one.verdict.term):
            continue
        its = search.evidence.columns_of([*rest, verdict.term])
        blocks = search.evidence.own(mine) or search.evidence.own(its)
        worse = search.evidence.held_out(its, blocks=blocks) - search.evidence.held_out(mine, blocks=blocks)
        noise = float(worse.std(ddof=1)) * np.sqrt(worse.size)
        if worse.sum() < noise and worse.sum() < 0.1 * gained:
            out.append(candidate.name)
    return out
