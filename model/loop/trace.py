"""Trace a residual to the effects that the model lacks: select, test again what remains, until nothing more is found.

Forward: of all effects that chance cannot explain and that help on held-out runs by more than a practical floor, the
one that helps most is taken; where a physical form does as well as a learned curve, the physical one. Columns that
answer to the drive (commands, measured attitude) come once nothing else is found. An interaction brings along those of
the effects it joins that show themselves beside it. After each step every effect is chosen anew given the others, and
one that the others make needless is dropped. In the end causes are told from shadows: what only fills in where the form
of a cause is not quite right helps to predict, but is no reason of its own.
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
    """What was found. ranking : every candidate's best verdict before anything was taken, best first. confounded :
    names that these runs cannot tell from an effect found. remaining_p : of the best candidate left, over all.
    shadows : those found that are no causes of their own.
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
        return [f.verdict.term for f in self.found]

    @property
    def causes(self) -> Trace:
        """The same without shadows."""
        return replace(self, found=[f for f in self.found if f not in self.shadows], shadows=[])

    def without(self, one: Found) -> Trace:
        """The same with an effect fewer; shadows alone are nothing found."""
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

    level_doubt : how far the base model's level may be off on any day, a share of the energy, known with so many
    degrees of level_freedom. shared : gain of a term that the base model's own runs show as well, which is no news and
    does not count.
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
        needless |= before - {f.candidate.name for f in found}  # or it would be taken and dropped for ever
        if wrong := search.turned(found):  # it stood for others, and what was built on it may too: begin anew
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
