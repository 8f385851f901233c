"""The table of many outcomes in Markdown: a row for each kind of case, and the requirements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from tests.loop.cases import Outcome

HEAD = (
    "| hidden | cases | first right | all named | before | after | without effects | floor | after / without effects "
    "| second site: before, after, informed, without effects | gain | coefficient | covered | wrong names "
    "| covariates | s |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)

LEGEND = (
    "*first right*: the first effect named is the hidden one (none: nothing is named). *before*, *after*: mean "
    "relative error on held-out runs of new/ as the report states it; *without effects*: of the same base model on the "
    "same drives without any hidden effect; *floor*: of a model that knows terrain and effects. *Second site*: the "
    "base model, the calibrated one, an informed prediction (the base model plus the true energy of the effect), and "
    "the base model without the effect; *gain*: the share of the informed prediction's gain that the calibrated model "
    "has (median; none for a place, or for a wind or payload that is not logged). *coefficient*: median of "
    "|stated - true| / |true| where a unit is shared; *covered*: true ones within the stated 95 % interval. "
    "*covariates*: collinear covariates that the calibrated model contains and that are no causes. *s*: median "
    "duration of the calibration [s]."
)


def table_of(outcomes: Sequence[Outcome]) -> str:
    """Rows by case in order of first appearance, and a row of all."""
    names = list(dict.fromkeys(o.case for o in outcomes))
    rows = [_row(name, [o for o in outcomes if o.case == name]) for name in names]
    hidden = [o for o in outcomes if o.true]
    if len({o.case for o in hidden}) > 1:
        rows.append(_row("**all hidden**", hidden))
    return "\n".join([HEAD, *rows])


def summary_of(outcomes: Sequence[Outcome]) -> str:
    """The requirements, and what was reached."""
    single = [o for o in outcomes if len(o.true) == 1]
    several = [o for o in outcomes if len(o.true) > 1]
    quiet = [o for o in outcomes if not o.true]
    hidden = single + several
    fits = [fit for o in outcomes for fit in o.fits]
    known = [o for o in hidden if o.knowable]
    possible = sum(o.other_before - o.other_informed for o in known)
    gained = sum(o.other_before - o.other_after for o in known)
    near = sum(o.new_after <= 1.10 * o.new_clean for o in hidden)
    lines = [
        _share("the one hidden effect is named first (95 % required)", sum(o.first_right for o in single), len(single)),
        _share("of two, both are named (85 % required)", sum(o.all_right for o in several), len(several)),
        _share(
            "without an effect, something is reported (at most 5 %)", sum(not o.first_right for o in quiet), len(quiet)
        ),
        _share("error after within 1.10 of the error without effects", near, len(hidden)),
        _share(
            "true coefficients within the 95 % interval (90 to 98 %)",
            sum(f.low <= f.true <= f.high for f in fits),
            len(fits),
        ),
        f"- on the second site, share of the possible reduction of the error, all cases together (80 % required): "
        f"{gained / possible:.0%}"
        if possible > 0
        else "",
        f"- a calibration takes at most {max((o.tried_s for o in outcomes), default=0.0):.0f} s of a 6-run case",
    ]
    return "\n".join(line for line in lines if line)


def _share(words: str, count: int, of: int) -> str:
    return f"- {words}: {count} of {of} ({count / of:.1%})" if of else ""


def _row(name: str, cases: Sequence[Outcome]) -> str:
    fits = [fit for case in cases for fit in case.fits]
    shares = [case.gain_share for case in cases if case.gain_share is not None]
    wrong = Counter(name for case in cases for name in case.false_finds)
    covariates = Counter(name + " (hidden)" * case.hit(name) for case in cases for name in case.covariates)
    near = _median([abs(fit.value - fit.true) / abs(fit.true) for fit in fits])
    inside = sum(fit.low <= fit.true <= fit.high for fit in fits)
    second = [_mean(cases, each) for each in (_before, _after, _informed, _clean)]
    cells = [
        name,
        str(len(cases)),
        f"{sum(case.first_right for case in cases)}/{len(cases)}",
        f"{sum(case.all_right for case in cases)}/{len(cases)}",
        f"{_mean(cases, lambda o: o.new_before):.1%}",
        f"{_mean(cases, lambda o: o.new_after):.1%}",
        f"{_mean(cases, lambda o: o.new_clean):.1%}",
        f"{_mean(cases, lambda o: o.floor):.1%}",
        f"{_mean(cases, lambda o: o.new_after / o.new_clean):.2f}",
        ", ".join(f"{value:.1%}" for value in second),
        f"{_median(shares):.0%}" if shares else "",
        f"{near:.0%}" if fits else "",
        f"{inside}/{len(fits)}" if fits else "",
        *(", ".join(f"{word} {count}" for word, count in names.most_common()) for names in (wrong, covariates)),
        f"{_median([case.tried_s for case in cases]):.0f}",
    ]
    return "| " + " | ".join(cells) + " |"


def _before(case: Outcome) -> float:
    return case.other_before


def _after(case: Outcome) -> float:
    return case.other_after


def _informed(case: Outcome) -> float:
    return case.other_informed


def _clean(case: Outcome) -> float:
    return case.other_clean


def _mean(cases: Sequence[Outcome], value: Callable[[Outcome], float]) -> float:
    return float(np.mean([value(case) for case in cases]))


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")
