"""Trace a residual to the effects that the model lacks: select, test again what remains, until nothing more is found.

Forward: of all effects that chance cannot explain and that help on held-out runs by more than a practical floor, the
one that helps most is taken; where a physical form does nearly as well as a learned curve, the physical one. Columns
that answer to the drive (commands, measured attitude) come once nothing else is found. Backward: an effect that the
others make needless is dropped, and each is put in the best of its forms given the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from model.loop.candidates import Candidate
from model.loop.evidence import Evidence, Verdict
from model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

ALPHA = 0.05
MAX_EFFECTS = 6

_STEADY = 0.6  # of the folds must gain
_COEFFICIENT, _MOST = 0.01, 0.04
_NEARLY = 0.85  # of a learned curve's gain is enough for a physical form


@dataclass(frozen=True)
class Floors:
    """Least held-out gain that counts: of a physical form, a learned curve, a field over the map. Less may be the base
    model's own error, which goes with ground and place too."""

    physical: float = 0.06
    learned: float = 0.10
    place: float = 0.12


@dataclass(frozen=True)
class Found:
    """An effect taken: its candidate, the index of its term, and the verdict when it was taken."""

    candidate: Candidate
    verdict: Verdict


@dataclass(frozen=True)
class Trace:
    """What was found. ranking : every candidate's best verdict before anything was taken, best first. confounded :
    names that these runs cannot tell from an effect found. remaining_p : of the best candidate left, over all."""

    found: list[Found]
    ranking: list[tuple[Candidate, Verdict]]
    confounded: dict[str, list[str]]
    remaining: list[tuple[Candidate, Verdict]]
    remaining_p: float
    evidence: Evidence = field(repr=False)

    @property
    def chosen(self) -> list[int]:
        return [f.verdict.term for f in self.found]


def trace(
    residuals: Residuals,
    candidates: Sequence[Candidate],
    *,
    level_doubt: float,
    floors: Floors | None = None,
    shared: Callable[[int], float] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Trace:
    """Trace residuals to effects.

    level_doubt : how far the base model's level may be off on any day, a share of the energy. shared : gain of a term
    that the base model's own runs show as well, which is no news and does not count.
    """
    owner = [c for c in candidates for _ in c.variants]
    evidence = Evidence(residuals, [v for c in candidates for v in c.variants], level_doubt=level_doubt, seed=seed)
    search = _Search(evidence, owner, floors or Floors(), shared or (lambda term: 0.0))
    ranking = search.best_of_each([])
    found: list[Found] = []
    verdicts = ranking
    while len(found) < MAX_EFFECTS:
        taken = search.pick(verdicts, found)
        if taken is None:
            break
        found = search.settle([*found, taken])
        verdicts = search.best_of_each(found)
        if progress is not None:
            progress(len(found) / MAX_EFFECTS)
    found = search.by_worth(found)
    remaining = [v for v in verdicts if v[0].name not in {f.candidate.name for f in found}]
    names = {f.candidate.name: search.rivals(found, f) for f in found}
    least = min((v.p_value for _, v in remaining if search.clears_floor(v)), default=None)
    if least is None:
        least = max((v.p_value for _, v in remaining), default=1.0)
    if progress is not None:
        progress(1.0)
    return Trace(found, ranking, {k: v for k, v in names.items() if v}, remaining, least, evidence)


class _Search:
    """The moves of the selection on one body of evidence. owner : candidate of each term."""

    def __init__(
        self, evidence: Evidence, owner: list[Candidate], floors: Floors, shared: Callable[[int], float]
    ) -> None:
        self.evidence, self.owner, self.floors, self.shared = evidence, owner, floors, shared

    def floor(self, term: int) -> float:
        if self.evidence.terms[term].formula in ("place", "disk"):
            return self.floors.place
        return self.floors.learned if self.owner[term].learned else self.floors.physical

    def clears_floor(self, verdict: Verdict) -> bool:
        worth = min(verdict.gain, verdict.net)
        if worth < self.floor(verdict.term) or verdict.steady < _STEADY:
            return False
        return worth - self.shared(verdict.term) >= self.floor(verdict.term)

    def score(self, verdict: Verdict) -> float:
        """Gain less a price for every coefficient: of two that help alike the simpler one."""
        return verdict.gain - self.price(verdict.term)

    def price(self, term: int) -> float:
        """Of the coefficients of a term beyond the first, as a share of the error."""
        price = _COEFFICIENT * (len(self.evidence.columns[term]) - 1)
        return price if self.evidence.terms[term].formula == "by_run" else min(price, _MOST)

    def best_of_each(self, found: Sequence[Found]) -> list[tuple[Candidate, Verdict]]:
        """Each candidate's best variant given what was found, best first."""
        names = {f.candidate.name for f in found}
        tried = [k for k, c in enumerate(self.owner) if c.name not in names]
        best: dict[str, tuple[Candidate, Verdict]] = {}
        for verdict in self.evidence.judge([f.verdict.term for f in found], tried):
            candidate = self.owner[verdict.term]
            before = best.get(candidate.name)
            if before is None or self._order(verdict) > self._order(before[1]):
                best[candidate.name] = candidate, verdict
        return sorted(best.values(), key=lambda pair: -pair[1].gain)

    def _order(self, verdict: Verdict) -> tuple[bool, float]:
        return verdict.p_value <= ALPHA and self.clears_floor(verdict), self.score(verdict)

    def pick(self, verdicts: Sequence[tuple[Candidate, Verdict]], found: Sequence[Found]) -> Found | None:
        """The effect to take next, None when there is none."""
        good = [Found(c, v) for c, v in verdicts if v.p_value <= ALPHA and self.clears_floor(v)]
        first = [f for f in good if not f.candidate.response] or good
        if not first:
            return None
        best = max(first, key=lambda f: self.score(f.verdict))
        near = [f for f in first if self.score(f.verdict) >= _NEARLY * self.score(best.verdict)]
        physical = [f for f in near if not f.candidate.learned]
        if best.candidate.learned and physical:
            return max(physical, key=lambda f: self.score(f.verdict))
        return best

    def settle(self, found: list[Found]) -> list[Found]:
        """Each effect in its best variant given the others, without those that the others make needless."""
        for _ in range(2):
            for k, one in enumerate(found):
                rest = [f.verdict.term for j, f in enumerate(found) if j != k]
                terms = [t for t, c in enumerate(self.owner) if c.name == one.candidate.name]
                better = min(terms, key=lambda t: self.error([*rest, t]) * (1.0 + self.price(t)))
                if better != one.verdict.term and self.error([*rest, better]) < self.error([*rest, one.verdict.term]):
                    found[k] = Found(one.candidate, self.evidence.judge(rest, [better])[0])
            worth = [(self.worth(found, f), k) for k, f in enumerate(found)]
            least, k = min(worth)
            if len(found) > 1 and least < 0.5 * self.floor(found[k].verdict.term):
                found = found[:k] + found[k + 1 :]
        return found

    def error(self, chosen: Sequence[int]) -> float:
        """Held-out squared error [scaled] of a choice of terms."""
        return float(self.evidence.held_out(self.active(chosen)).sum())

    def active(self, chosen: Sequence[int]) -> NDArray[np.int64]:
        return np.concatenate([self.evidence.columns_of(chosen), self.evidence.silent(chosen)])

    def worth(self, found: Sequence[Found], one: Found) -> float:
        """Share by which the held-out error would grow without an effect."""
        rest = [f.verdict.term for f in found if f is not one]
        whole = self.error([f.verdict.term for f in found])
        return (self.error(rest) - whole) / max(self.error(rest), 1e-12)

    def by_worth(self, found: list[Found]) -> list[Found]:
        return sorted(found, key=lambda f: -self.worth(found, f))

    def rivals(self, found: Sequence[Found], one: Found) -> list[str]:
        """Candidates that could stand in for an effect found: the held-out error would not grow by more than noise."""
        rest = [f.verdict.term for f in found if f is not one]
        names = {f.candidate.name for f in found}
        mine = self.active([*rest, one.verdict.term])
        gained = self.error(rest) - self.error([*rest, one.verdict.term])
        out = []
        for candidate, verdict in self.best_of_each([f for f in found if f is not one]):
            if candidate.name in names or verdict.p_value > ALPHA or not self.clears_floor(verdict):
                continue
            its = self.active([*rest, verdict.term])
            blocks = self.evidence.own(mine) or self.evidence.own(its)
            worse = self.evidence.held_out(its, blocks=blocks) - self.evidence.held_out(mine, blocks=blocks)
            noise = float(worse.std(ddof=1)) * np.sqrt(worse.size)
            if worse.sum() < noise and worse.sum() < 0.1 * gained:
                out.append(candidate.name)
        return out
