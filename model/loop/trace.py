"""Trace a residual to the effects that the model lacks: select one, test again what remains, until nothing is left.

Forward: of all effects that are significant and help on held-out runs by more than a practical floor, the one that
helps most is taken; where a physical form does as well as a fitted curve, the physical one. Columns that respond to the
drive (commands, measured attitude) come after everything else. An interaction brings along those of its main effects
that are significant beside it. After each step every effect is chosen again given the others, and one that became
needless is dropped. In the end causes are distinguished from collinear covariates: a covariate only corrects the form
of a cause. It helps to predict, but is no cause of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from joulemap.model.loop.candidates import Candidate
from joulemap.model.loop.evidence import Evidence, Verdict
from joulemap.model.loop.naming import by_worth, rivals, shadows_of
from joulemap.model.loop.residual import Residuals
from joulemap.model.loop.selection import Floors, Found, Search

MAX_EFFECTS = 6


@dataclass(frozen=True)
class Trace:
    """The effects that were found.

    Attributes
    ----------
    found : list of Found
        The most important first.
    ranking : list of tuple of (Candidate, Verdict)
        Every candidate's best variant before anything was taken, the best first.
    confounded : dict
        Names of candidates that these runs cannot distinguish from an effect found, by its name.
    remaining : list of tuple of (Candidate, Verdict)
        Candidates that were not taken, given those that were.
    remaining_p : float
        p-value of the best of them.
    evidence : Evidence
        Of all terms.
    shadows : list of Found
        Those found that are collinear covariates and no causes of their own.
    """

    found: list[Found]
    ranking: list[tuple[Candidate, Verdict]]
    confounded: dict[str, list[str]]
    remaining: list[tuple[Candidate, Verdict]]
    remaining_p: float
    evidence: Evidence = field(repr=False)
    shadows: list[Found] = field(default_factory=list)

    @property
    def chosen(self) -> list[int]:
        """Indices of the terms found."""
        return [f.verdict.term for f in self.found]

    @property
    def causes(self) -> Trace:
        """The same without collinear covariates."""
        return replace(self, found=[f for f in self.found if f not in self.shadows], shadows=[])

    def without(self, one: Found) -> Trace:
        """Return the same with one effect fewer; nothing is found where only collinear covariates remain.

        Parameters
        ----------
        one : Found
            The effect to leave out.

        Returns
        -------
        Trace
            Where the effect is among the remaining candidates.
        """
        found = [f for f in self.found if f is not one]
        if all(f in self.shadows for f in found):
            found = []
        names = {f.candidate.name for f in found}
        remaining = sorted([*self.remaining, (one.candidate, one.verdict)], key=lambda pair: -pair[1].gain)
        return replace(
            self,
            found=found,
            remaining=remaining,
            shadows=[f for f in self.shadows if f in found],
            confounded={k: v for k, v in self.confounded.items() if k in names},
        )


def trace(
    residuals: Residuals,
    candidates: Sequence[Candidate],
    *,
    level_doubt: float,
    level_freedom: int = 0,
    floors: Floors | None = None,
    shared: Callable[[int], float] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Trace:
    """Trace residuals to effects.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    candidates : sequence of Candidate
        To test.
    level_doubt : float
        Relative uncertainty of the base model's scale on any day.
    level_freedom : int
        Degrees of freedom with which it is known; 0 if it is assumed.
    floors : Floors, optional
        Smallest gains that count.
    shared : callable, optional
        Gain of a term that the baseline runs show as well, which does not count.
    seed : int
        Of the permutations.
    progress : callable, optional
        Called with the share of the work that is done, 0..1.

    Returns
    -------
    Trace
        With an empty `found` where nothing is significant.
    """
    owner = [c for c in candidates for _ in c.variants]
    terms = [v for c in candidates for v in c.variants]
    evidence = Evidence(residuals, terms, level_doubt=level_doubt, level_freedom=level_freedom, seed=seed)
    search = Search(evidence, owner, floors or Floors(), shared or (lambda term: 0.0), progress)
    ranking = search.best_of_each([])
    found: list[Found] = []
    verdicts = ranking
    needless: set[str] = set()
    while len(found) < MAX_EFFECTS:
        taken = search.pick([v for v in verdicts if v[0].name not in needless], found)
        if taken is None:
            break
        before = {f.candidate.name for f in [*found, taken]}
        found = search.settle(search.with_parts([*found, taken]))
        needless |= before - {f.candidate.name for f in found}  # otherwise it would be taken and dropped forever
        if wrong := search.turned(found):  # it replaced others, and so may what was built on it: start again
            search.refuse(wrong)
            found, needless = [], set()
        verdicts = search.best_of_each(found)
    found = by_worth(search, search.two_named(found))
    shadows = shadows_of(search, found)
    remaining = [v for v in verdicts if v[0].name not in {f.candidate.name for f in found}]
    names = {f.candidate.name: rivals(search, found, f) for f in found if f not in shadows}
    least = min((v.p_value for _, v in remaining if search.clears_floor(v)), default=None)
    if least is None:
        least = max((v.p_value for _, v in remaining), default=1.0)
    if progress is not None:
        progress(1.0)
    return Trace(found, ranking, {k: v for k, v in names.items() if v}, remaining, least, evidence, shadows)
