"""The steps of a selection of effects: judge each candidate, take the best, and revise those taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from joulemap.model.loop.candidates import Candidate
from joulemap.model.loop.evidence import Evidence, Verdict

ALPHA = 0.05
SENSELESS = "its sign or its size is not physical"
CURVES = {
    "braking": "learned:grade",
    "climbing": "learned:grade",
    "cross_slope": "learned:cross_slope",
    "speed": "learned:speed",
    "temperature": "learned:temperature",
    "payload": "learned:payload",
    "local_friction": "learned:place",
}
"""The curve over the quantity of a physical effect: it could only correct the form of that effect."""

_STEADY = 0.6  # of the folds must gain
_COEFFICIENT, _MOST = 0.01, 0.04
_NEARLY, _FAIRLY = 0.85, 0.7  # of a fitted curve's gain is enough for a physical form; within the noise, less
_SURE, _LITTLE = 0.01, 0.02
_ROUNDS = 3
_LEFT = 0.75  # of the work remains after each judging of all candidates, as a guess


@dataclass(frozen=True)
class Floors:
    """Smallest held-out gain that counts, as a share of the squared error.

    Less may be the base model's own error, which depends on ground and place too. Between runs that error is known, and
    part of the p-value.

    Attributes
    ----------
    physical : float
        Of a physical form.
    learned : float
        Of a fitted curve.
    place : float
        Of a field over the map.
    between_runs : float
        Of what differs between runs only.
    """

    physical: float = 0.06
    learned: float = 0.10
    place: float = 0.12
    between_runs: float = 0.02


@dataclass(frozen=True)
class Found:
    """An effect that was taken.

    Attributes
    ----------
    candidate : Candidate
        The effect.
    verdict : Verdict
        On its variant, when it was taken.
    """

    candidate: Candidate
    verdict: Verdict


def interactions_of(one: Found, found: Sequence[Found]) -> list[Found]:
    """Return the interactions that an effect is part of: they need the effect.

    Parameters
    ----------
    one : Found
        The effect.
    found : sequence of Found
        All effects.

    Returns
    -------
    list of Found
        Of `found`.
    """
    return [f for f in found if one.candidate.name in f.candidate.parts]


class Search:
    """The steps of the selection on one body of evidence.

    Parameters
    ----------
    evidence : Evidence
        Of all terms.
    owner : list of Candidate
        Candidate of each term.
    floors : Floors
        Smallest gains.
    shared : callable
        Gain of a term that the baseline runs show as well.
    progress : callable or None
        Called with the share of the work that is done, 0..1.
    """

    def __init__(
        self,
        evidence: Evidence,
        owner: list[Candidate],
        floors: Floors,
        shared: Callable[[int], float],
        progress: Callable[[float], None] | None,
    ) -> None:
        self.evidence, self.owner, self.floors, self.shared = evidence, owner, floors, shared
        self.progress = progress
        self._refused: frozenset[str] = frozenset()
        self._best: dict[tuple[tuple[int, ...], frozenset[str]], list[tuple[Candidate, Verdict]]] = {}

    def refuse(self, names: set[str]) -> None:
        """Exclude candidates from now on.

        Parameters
        ----------
        names : set of str
            Of the candidates.
        """
        self._refused |= names

    def floor(self, term: int) -> float:
        """Return the smallest gain of a term that counts.

        Parameters
        ----------
        term : int
            Index of the term.

        Returns
        -------
        float
            See `Floors`.
        """
        if self.evidence.terms[term].formula in ("place", "disk"):
            return self.floors.place
        if self.between(term):
            return self.floors.between_runs
        return self.floors.learned if self.owner[term].learned else self.floors.physical

    def between(self, term: int) -> bool:
        """Return whether a term differs between runs only.

        Parameters
        ----------
        term : int
            Index of the term.

        Returns
        -------
        bool
            False for an effect on the scale of all runs.
        """
        return self.evidence.differs[term] and not self.evidence.moves_level([term])

    def clears_floor(self, verdict: Verdict) -> bool:
        """Return whether a term helps enough, beyond what the baseline runs show.

        Parameters
        ----------
        verdict : Verdict
            On the term.

        Returns
        -------
        bool
            True if so.
        """
        worth = min(verdict.gain, verdict.net)
        if worth < self.floor(verdict.term) or verdict.steady < _STEADY:
            return False
        return worth - self.shared(verdict.term) >= self.floor(verdict.term)

    def score(self, verdict: Verdict) -> float:
        """Return the gain minus a price per coefficient: of two equally good terms the simpler one is better.

        Parameters
        ----------
        verdict : Verdict
            On the term.

        Returns
        -------
        float
            A share of the error.
        """
        return round(verdict.gain - self.price(verdict.term), 6)  # some are identical on these runs

    def price(self, term: int) -> float:
        """Return the price of the coefficients of a term beyond the first.

        Parameters
        ----------
        term : int
            Index of the term.

        Returns
        -------
        float
            A share of the error.
        """
        price = _COEFFICIENT * (len(self.evidence.columns[term]) - 1)
        return price if self.evidence.terms[term].formula == "by_run" else min(price, _MOST)

    def best_of_each(self, found: Sequence[Found]) -> list[tuple[Candidate, Verdict]]:
        """Return the best variant of each candidate, given the effects found.

        A curve over the quantity of a physical effect that was found is not tested: it would only correct the effect's
        form.

        Parameters
        ----------
        found : sequence of Found
            Effects taken already.

        Returns
        -------
        list of tuple of (Candidate, Verdict)
            The best first.
        """
        taken = sorted(f.verdict.term for f in found)
        key = tuple(taken), self._refused
        if key in self._best:
            return self._best[key]
        names = {f.candidate.name for f in found}
        names |= self._refused | {CURVES[name] for name in names if name in CURVES}
        tried = [k for k, c in enumerate(self.owner) if c.name not in names]
        forms: dict[str, list[Verdict]] = {}
        for verdict in self.evidence.judge(taken, tried):
            if self.senseless(taken, verdict.term):
                verdict = replace(verdict, p_value=1.0, why=SENSELESS)
            forms.setdefault(self.owner[verdict.term].name, []).append(verdict)
        best = [(self.owner[v[0].term], self._best_form(v)) for v in forms.values()]
        self._best[key] = sorted(best, key=lambda pair: -pair[1].gain)
        if self.progress is not None:
            self.progress(1.0 - _LEFT ** len(self._best))
        return self._best[key]

    def senseless(self, taken: Sequence[int], term: int) -> bool:
        """Return whether the sign or the size of a term is not physical.

        Parameters
        ----------
        taken : sequence of int
            Terms taken already.
        term : int
            Index of the term.

        Returns
        -------
        bool
            True if so.
        """
        sign, most = self.owner[term].sign, self.owner[term].most
        if not sign and math.isinf(most):
            return False
        size = self.evidence.size_of(taken, term)
        return sign * size < 0 or abs(size) > most

    def turned(self, found: Sequence[Found]) -> set[str]:
        """Return effects whose sign or size is no longer physical beside all others.

        Parameters
        ----------
        found : sequence of Found
            All effects.

        Returns
        -------
        set of str
            Names of candidates.
        """
        return {
            f.candidate.name
            for f in found
            if f.candidate.name not in self._refused
            and self.senseless([g.verdict.term for g in found if g is not f], f.verdict.term)
        }

    def _best_form(self, forms: Sequence[Verdict]) -> Verdict:
        """The best of the variants of an effect. If one of them is significant the effect is, and its variant is chosen
        by what helps most.
        """
        helps = [v for v in forms if self.clears_floor(v) and not v.why]
        chance = min((v.p_value for v in helps), default=1.0)
        if chance > ALPHA:
            return max(forms, key=self.score)
        return replace(max(helps, key=self.score), p_value=chance)

    def pick(self, verdicts: Sequence[tuple[Candidate, Verdict]], found: Sequence[Found]) -> Found | None:
        """Return the effect to take next.

        Of the effects that do as well as the best, a physical one is taken that no logged column explains better. Hour,
        temperature and distance driven are near-collinear between runs: if one of them is significant, another one that
        does as well may be the cause. A curve whose physical form has an impossible sign comes last.

        Parameters
        ----------
        verdicts : sequence of tuple of (Candidate, Verdict)
            As `best_of_each` returned them.
        found : sequence of Found
            Effects taken already.

        Returns
        -------
        Found or None
            None when there is no further effect.
        """
        good = [Found(c, v) for c, v in verdicts if v.p_value <= ALPHA and self.clears_floor(v)]
        first = [f for f in good if not f.candidate.response] or good
        if not first:
            return None
        taken = [f.verdict.term for f in found]
        best = max(first, key=lambda f: self.score(f.verdict))
        copies = [
            Found(c, replace(v, p_value=best.verdict.p_value))
            for c, v in verdicts
            if v.p_value > ALPHA and self.may_copy(v)
        ]
        alike = [f for f in first + copies if f is best or self.as_good(taken, f, best)]
        opposed = {CURVES.get(c.name) for c, v in verdicts if v.why == SENSELESS}
        alike.sort(key=lambda f: (self.named(f), f.candidate.name not in opposed, self.score(f.verdict)), reverse=True)
        chosen = alike[0]
        above = [f for f in alike[1:] if self.score(f.verdict) > self.score(chosen.verdict)]
        return next((c for c in above if self.tells_more(taken, c, chosen)), chosen)

    def may_copy(self, verdict: Verdict) -> bool:
        """Return whether a term may be near-collinear with a significant one: it differs between runs only, and helps.

        Parameters
        ----------
        verdict : Verdict
            On the term.

        Returns
        -------
        bool
            True if so.
        """
        return not verdict.why and self.between(verdict.term) and self.clears_floor(verdict)

    def named(self, one: Found) -> bool:
        """Return whether an effect has a physical form.

        A curve, a drift, a field over the map and coefficients for every run say only that something changes.

        Parameters
        ----------
        one : Found
            The effect.

        Returns
        -------
        bool
            True if so.
        """
        curve = self.evidence.terms[one.verdict.term].formula in ("smooth", "heading", "place")
        return not (curve or one.candidate.name == "drift" or self.by_run(one))

    def by_run(self, one: Found) -> bool:
        """Return whether every run has coefficients of its own.

        Parameters
        ----------
        one : Found
            The effect.

        Returns
        -------
        bool
            True if so.
        """
        return self.evidence.own(self.evidence.columns[one.verdict.term])

    def as_good(self, taken: Sequence[int], one: Found, best: Found) -> bool:
        """Return whether an effect does as well as the best on held-out data.

        Parameters
        ----------
        taken : sequence of int
            Terms taken already.
        one : Found
            The effect.
        best : Found
            The best.

        Returns
        -------
        bool
            True if its error is within one standard error and no small part of the gain is lost, or nearly none.

        References
        ----------
        Breiman et al. 1984, section 3.4.3.
        """
        mine, its = (self.evidence.columns_of([*taken, f.verdict.term]) for f in (one, best))
        blocks = self.evidence.own(mine) or self.evidence.own(its)
        before = self.evidence.held_out(self.evidence.columns_of(taken), blocks=blocks).sum()
        error = self.evidence.held_out(its, blocks=blocks)
        worse = self.evidence.held_out(mine, blocks=blocks) - error
        gained = float(before - error.sum())
        noise = 0.0 if blocks else float(worse.std(ddof=1)) * np.sqrt(worse.size)
        return bool(worse.sum() <= max((1.0 - _NEARLY) * gained, min(noise, (1.0 - _FAIRLY) * gained)))

    def tells_more(self, taken: Sequence[int], column: Found, other: Found) -> bool:
        """Return whether a logged column encompasses another effect.

        Parameters
        ----------
        taken : sequence of int
            Terms taken already.
        column : Found
            A curve over a logged column.
        other : Found
            The other effect.

        Returns
        -------
        bool
            True if the column explains what the other effect leaves, and that one nothing of what the column leaves.

        References
        ----------
        Mizon & Richard 1986.
        """
        name = column.candidate.name
        over = str(self.evidence.terms[column.verdict.term].settings.get("over", ""))
        if not over.startswith("column:") or over.removeprefix("column:") == other.candidate.name:
            return False
        slopes = [k for k, c in enumerate(self.owner) if c.name == name and self.evidence.columns[k].size == 1]
        constant = [k for k, t in enumerate(self.evidence.terms) if t.formula == "friction"]
        more = self.evidence.judge([*taken, other.verdict.term, *constant], slopes)
        if min((v.p_value for v in more), default=1.0) > _SURE:
            return False
        back = self.evidence.judge([*taken, column.verdict.term], [other.verdict.term])[0]
        return back.p_value > ALPHA or min(back.gain, back.net) < _LITTLE

    def with_parts(self, found: list[Found]) -> list[Found]:
        """Return the effects with the main effects of every interaction, which would otherwise include them.

        The effect that is modified is added if it is significant without the interaction, the other one if it is so
        beside the interaction as well. The interaction is then what comes in addition, if anything does.

        Parameters
        ----------
        found : list of Found
            Effects taken.

        Returns
        -------
        list of Found
            At least as many.

        References
        ----------
        Nelder 1977 (marginality).
        """
        for one in [f for f in found if f.candidate.parts]:
            modified, other = one.candidate.parts
            rest = [f for f in found if f is not one]
            rest += self.shown(modified, rest)
            if modified in {f.candidate.name for f in rest}:
                found = rest + self.shown(one.candidate.name, rest)
            found += self.shown(other, rest, found)
        return found

    def shown(self, name: str, *beside: Sequence[Found]) -> list[Found]:
        """Return the best variant of an effect that is significant beside each of some choices, the best by the first.

        It is tested alone and known to matter, so that a little gain is enough.

        Parameters
        ----------
        name : str
            Of the candidate.
        *beside : sequence of Found
            The choices.

        Returns
        -------
        list of Found
            One or none; none if it is among them.
        """
        tried = [k for k, c in enumerate(self.owner) if c.name == name]
        kept: dict[int, Verdict] = {}
        for found in reversed(beside):
            if name in {f.candidate.name for f in found}:
                return []
            taken = [f.verdict.term for f in found]
            verdicts = [v for v in self.evidence.judge(taken, tried) if not self.senseless(taken, v.term)]
            kept = {v.term: v for v in verdicts if v.p_value <= ALPHA and min(v.gain, v.net) >= _LITTLE}
            tried = list(kept)
        best = max(kept.values(), key=self.score, default=None)
        return [] if best is None else [Found(self.owner[best.term], best)]

    def settle(self, found: list[Found]) -> list[Found]:
        """Revise the effects: each may be replaced given the others, and those that became needless are dropped.

        Parameters
        ----------
        found : list of Found
            Effects taken.

        Returns
        -------
        list of Found
            At least one.

        References
        ----------
        Miller 2002, section 3.7 (sequential replacement).
        """
        for _ in range(_ROUNDS):
            before = list(found)
            for k, one in enumerate(before):
                if interactions_of(one, found):
                    continue
                rest = self.beside(found, found[k])
                again = self.pick(self.best_of_each(rest), rest)
                others = {f.candidate.name for f in found if f is not found[k]}
                if again is not None and again.candidate.name not in others and self.better(rest, again, one):
                    found = [*found[:k], again, *found[k + 1 :]]
            least, k = min((self.worth(found, f), k) for k, f in enumerate(found) if not interactions_of(f, found))
            if len(found) > 1 and least < 0.5 * self.floor(found[k].verdict.term):
                found = found[:k] + found[k + 1 :]
            if found == before:
                break
        return found

    def two_named(self, found: list[Found]) -> list[Found]:
        """Replace effects without a physical form by two with one, if two do as well together.

        Taken one by one, the first may have included both.

        Parameters
        ----------
        found : list of Found
            Effects taken.

        Returns
        -------
        list of Found
            The two, or `found`.
        """
        if len(found) not in (1, 2) or all(self.named(f) for f in found) or any(f.candidate.response for f in found):
            return found
        most = 1.0 + _LITTLE if len(found) == 2 else 1.0 - self.floors.learned
        single = [k for k, c in enumerate(self.owner) if self.evidence.columns[k].size == 1 and not c.learned]
        single = [k for k in single if self.evidence.terms[k].formula not in ("disk", "turning")]
        pairs = [
            (self.error([j, k]), j, k)
            for j in single
            for k in single
            if j < k and self.owner[j].name != self.owner[k].name
        ]
        error, *best = min(pairs, default=(np.inf, 0, 0))
        if error > most * self.error([f.verdict.term for f in found]):
            return found
        both = [(k, [b for b in best if b != k]) for k in best]
        verdicts = [self.evidence.judge(other, [k])[0] for k, other in both]
        absurd = any(self.senseless(other, k) for k, other in both)
        if absurd or any(v.p_value > ALPHA or not self.clears_floor(v) for v in verdicts):
            return found
        return [Found(self.owner[v.term], v) for v in verdicts]

    def better(self, rest: Sequence[Found], again: Found, one: Found) -> bool:
        """Return whether to replace an effect: the fit gets better by it, or gets a physical form.

        Parameters
        ----------
        rest : sequence of Found
            The other effects.
        again : Found
            The new one.
        one : Found
            The old one.

        Returns
        -------
        bool
            True if so.
        """
        taken = [f.verdict.term for f in rest]
        new, old = (self.error([*taken, f.verdict.term]) for f in (again, one))
        if again.candidate.name == one.candidate.name:
            return new < (1.0 - 1e-6) * old  # variants may be identical on these runs
        named = self.named(again) and not self.named(one)
        return new < (1.0 + _LITTLE if named else 1.0 - _LITTLE) * old

    def error(self, chosen: Sequence[int], *, blocks: bool = False) -> float:
        """Return the held-out squared error of a choice of terms.

        Parameters
        ----------
        chosen : sequence of int
            Indices of terms.
        blocks : bool
            As in `Evidence.held_out`.

        Returns
        -------
        float
            Sum of squares [scaled].
        """
        return float(self.evidence.held_out(self.evidence.columns_of(chosen), blocks=blocks).sum())

    def saved(self, rest: Sequence[int], terms: Sequence[int]) -> float:
        """Return the held-out squared error that terms explain in addition to others.

        Parameters
        ----------
        rest : sequence of int
            The others.
        terms : sequence of int
            The terms.

        Returns
        -------
        float
            Sum of squares [scaled].
        """
        blocks = self.evidence.own(self.evidence.columns_of([*rest, *terms]))
        return self.error(rest, blocks=blocks) - self.error([*rest, *terms])

    def beside(self, found: Sequence[Found], one: Found) -> list[Found]:
        """Return the effects with which an effect is compared.

        They are not an interaction that it is part of. A column that responds to the drive makes nothing needless that
        explains it: a measured tilt may say the same as a slope, and say it better.

        Parameters
        ----------
        found : sequence of Found
            All effects.
        one : Found
            The effect.

        Returns
        -------
        list of Found
            Of `found`.
        """
        others = [f for f in found if f is not one and one.candidate.name not in f.candidate.parts]
        return [f for f in others if one.candidate.response or not f.candidate.response]

    def worth(self, found: Sequence[Found], one: Found) -> float:
        """Return the share by which the held-out error grows without an effect and the interactions it is part of.

        Parameters
        ----------
        found : sequence of Found
            All effects.
        one : Found
            The effect.

        Returns
        -------
        float
            May be negative.
        """
        rest = [f.verdict.term for f in self.beside(found, one)]
        its = [f.verdict.term for f in (one, *interactions_of(one, found))]
        return self.saved(rest, its) / max(self.error(rest), 1e-12)
