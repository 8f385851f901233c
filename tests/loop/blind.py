"""Are hidden effects found that the calibration was not written for? `python -m tests.loop.blind --seeds 6 --jobs 2`.

The effects are those of `generators.hidden`, under other names and forms than the candidates'. An answer is right if it
names the quantity on which the effect depends, be it with a form or as structure without one; which words count is
declared beside each effect. Every case is calibrated twice with the same baseline runs: on the runs with the effect,
and on their twins, the same drives with the same variation but without it. The twins' error is what "clean" means, so
that both sides have the same corrections of the base parameters.
"""

from __future__ import annotations

import argparse
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.loop.calibrator import Answer, joulemap
from tests.loop.document import wrapped
from tests.loop.generators.case import Case, make_case
from tests.loop.generators.config import CaseConfig, RobotConfig
from tests.loop.generators.hidden import KINDS, PAIRS, drawn_effects
from tests.loop.parallel import Row, rows_of

UNITS = {"kg/kg": {"", "kg/kg", "1"}}
"""Other ways to write a unit of a true coefficient."""

LEAST_GAIN = 0.01
"""Mean relative error on the second site that knowing the effect saves; below, no share of it is stated."""

LEGEND = (
    "*first*: the first answer is right. *all*: every hidden effect has a right answer. *wrong*: answers that are "
    "right for none of the effects. *before*, *after*: mean relative error of the base model, and of the calibrated "
    "one, on three further runs of the same day. *clean*: the same as *after* for the twins. *second site*: errors "
    "there of the model calibrated on the twins, of the one calibrated on the effect, and of the former on that site's "
    "own twins; *gain*: how much of the difference between the first and the last the second makes up. *covered*: true "
    "coefficients inside the stated 95 % interval, where the unit is the same; *coefficient*: median of "
    "|stated - true| / |true|. *s*: median seconds of a case, with its twin."
)


def config_of(number: int) -> CaseConfig:
    """Settings of a case; every second robot is declared 10 % off."""
    return CaseConfig(robot=replace(RobotConfig(), declared_off=0.10 * (number % 2)), test_runs=3, other_runs=3)


def try_blind(key: str) -> Row:
    """One case, given as "kinds:number:seed", with ":stated" after it for the error that the report states."""
    kinds, number, seed, *rest = key.split(":")
    stated = "".join(rest)
    case = make_case(config_of(int(number)), int(seed), drawn_effects(kinds, int(seed)))
    assert case.other is not None
    found = joulemap(case.new.site, case.declared, case.new.logs, case.base, cross_validate=stated == "stated")
    clean = joulemap(case.new.site, case.declared, case.new.twins, case.base)
    answers = found.answers
    right = [[effect.is_named_by(answer.words) for effect in case.effects] for answer in answers]
    named = [answer.name for answer in answers]
    home, away = case.test.site, case.other.site
    before, after = (found.error_on(home, case.test.logs, state=state) for state in ("before", "after"))
    spared = clean.error_on(home, case.test.twins)
    return {
        "named": named,
        "said": f"{', '.join(named) or 'nothing'} {before:.3f} -> {after:.3f} ({spared:.3f})",
        "first": bool(right) and any(right[0]),
        "all": all(any(of_answer[k] for of_answer in right) for k in range(len(case.effects))),
        "wrong": [name for name, of_answer in zip(named, right, strict=True) if not any(of_answer)],
        "before": before,
        "after": after,
        "clean": spared,
        "stated": found.stated if stated == "stated" else None,
        "clean_named": [answer.name for answer in clean.answers],
        "other": [
            clean.error_on(away, case.other.logs),
            found.error_on(away, case.other.logs),
            clean.error_on(away, case.other.twins),
        ],
        "fits": fits_of(case, answers),
    }


def fits_of(case: Case, answers: Sequence[Answer]) -> list[Row]:
    """Every true coefficient against the first right answer that states as many in the same unit.

    Of a curve over a switch, which is off in the baseline runs, it is what is stated where it is on. A coefficient that
    no answer states in its unit is there with `value` None. Where the sign is a convention (a log
    that is shifted to the east, or a map to the west), it is that which fits better.
    """
    out: list[Row] = []
    for effect in case.effects:
        true = effect.stated(case.robot, case.declared)
        if not true:
            continue
        units = UNITS.get(effect.unit, {effect.unit})
        stated = next(
            (
                same[-len(true) :]
                for answer in answers
                if effect.is_named_by(answer.words)
                and len(same := [c for c in answer.coefficients if c.unit in units])
                in (len(true), len(true) + effect.switch)
            ),
            None,
        )
        if stated is None:
            out += [{"kind": effect.kind, "true": value, "value": None} for value in true]
            continue
        along = sum(c.value * value for c, value in zip(stated, true, strict=True))
        sign = -1.0 if effect.either_sign and along < 0.0 else 1.0
        for c, value in zip(stated, true, strict=True):
            low, high = sorted((sign * c.low, sign * c.high))
            out.append({"kind": effect.kind, "true": value, "value": sign * c.value, "low": low, "high": high})
    return out


def table_of(rows: Sequence[Row]) -> str:
    """Markdown: what was required and reached, a line for each kind, and which coefficients do not count."""
    good = [row for row in rows if "error" not in row]
    head = (
        "| hidden | cases | first | all | before | after | clean | after / clean | second site | gain | coefficient "
        "| covered | wrong | s |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
    )
    names = list(dict.fromkeys(_kinds(row) for row in good))
    lines = [_line(name, [row for row in good if _kinds(row) == name]) for name in names]
    failed = [f"- failed: {row['key']}: {row['error']}" for row in rows if "error" in row]
    return "\n".join([*_summary(good), *failed, "", head, *lines, "", LEGEND, "", *_why_not(good)])


def _summary(rows: Sequence[Row]) -> list[str]:
    single = [row for row in rows if "+" not in _kinds(row)]
    pairs = [row for row in rows if "+" in _kinds(row)]
    narrow = [row for row in single if _kinds(row) in ("furrows", "late_meter")]
    fits = [fit for row in rows for fit in row["fits"] if fit["value"] is not None]
    there = [row for row in rows if _transfers(row)]
    told = sum(row["other"][0] - row["other"][2] for row in there)
    gained = sum(row["other"][0] - row["other"][1] for row in there)
    out = [
        _share("one effect is named first (95 % required)", [row["first"] for row in single]),
        _share("both of two are named (85 % required)", [row["all"] for row in pairs]),
        _share("narrow headings and a late meter are found (80 % required)", [row["all"] for row in narrow]),
        _share("the error after is within 1.10 of clean", [row["after"] <= 1.10 * row["clean"] for row in rows]),
        _share("true coefficients are covered (90 to 98 % required)", [_covered(fit) for fit in fits]),
    ]
    if rows:
        ratio = np.median([row["after"] / row["clean"] for row in rows])
        out.append(f"- median of the error after over clean: {ratio:.3f}")
        told_after = [row["after"] / row["stated"] for row in rows if row["stated"]]
        if told_after:
            out.append(f"- median of the error after on further runs over the stated one: {np.median(told_after):.3f}")
        out.append(_share("something wrong is named beside", [bool(row["wrong"]) for row in rows]))
        out.append(_share("something is named on the twins, where nothing is", [bool(r["clean_named"]) for r in rows]))
    if told > 0:
        out.append(f"- share of the possible gain on the second site (80 % required): {gained / told:.0%}")
    return [line for line in out if line]


def _why_not(rows: Sequence[Row]) -> list[str]:
    """Which coefficients take no part in the coverage, and why."""
    kinds = sorted({kind for row in rows for kind in _kinds(row).split("+")})
    lines = [f"- {name}: {KINDS[name].why_none}" for name in kinds if KINDS[name].why_none]
    missing = Counter(fit["kind"] for row in rows for fit in row["fits"] if fit["value"] is None)
    every = Counter(fit["kind"] for row in rows for fit in row["fits"])
    lines += [
        f"- {name}: not stated in {KINDS[name].unit} in {count} of {every[name]} cases"
        for name, count in sorted(missing.items())
    ]
    return ["No true coefficient to cover:", "", *lines] if lines else []


def _line(name: str, rows: Sequence[Row]) -> str:
    fits = [fit for row in rows for fit in row["fits"] if fit["value"] is not None]
    shares = [
        (row["other"][0] - row["other"][1]) / (row["other"][0] - row["other"][2])
        for row in rows
        if _transfers(row) and row["other"][0] - row["other"][2] > LEAST_GAIN
    ]
    wrong = Counter(word for row in rows for word in row["wrong"])
    near = [abs(fit["value"] - fit["true"]) / abs(fit["true"]) for fit in fits]
    cells = [
        name,
        str(len(rows)),
        f"{sum(row['first'] for row in rows)}/{len(rows)}",
        f"{sum(row['all'] for row in rows)}/{len(rows)}",
        *(f"{np.mean([row[key] for row in rows]):.1%}" for key in ("before", "after", "clean")),
        f"{np.mean([row['after'] / row['clean'] for row in rows]):.2f}",
        ", ".join(f"{value:.1%}" for value in np.mean([row["other"] for row in rows], axis=0)),
        f"{np.median(shares):.0%}" if shares else "",
        f"{np.median(near):.0%}" if near else "",
        f"{sum(map(_covered, fits))}/{len(fits)}" if fits else "",
        ", ".join(f"{word} {count}" for word, count in wrong.most_common()),
        f"{np.median([row['s'] for row in rows]):.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def _kinds(row: Row) -> str:
    return str(row["key"].split(":")[0])


def _transfers(row: Row) -> bool:
    return all(KINDS[kind].transfers for kind in _kinds(row).split("+"))


def _covered(fit: Row) -> bool:
    return bool(fit["low"] <= fit["true"] <= fit["high"])


def _share(words: str, hits: Sequence[bool]) -> str:
    return f"- {words}: {sum(hits)} of {len(hits)} ({sum(hits) / len(hits):.1%})" if hits else ""


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.blind", description=__doc__.splitlines()[0])
    parser.add_argument("--effects", default="all", help="kinds or pairs joined by commas, or all, singles, pairs")
    parser.add_argument("--seeds", type=int, default=4, help="cases of each [default: 4]")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--stated", action="store_true", help="compare the error that the report states, too (slow)")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of finished cases, to continue")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table with its command")
    options = parser.parse_args(arguments)
    groups = {"all": (*KINDS, *PAIRS), "singles": tuple(KINDS), "pairs": PAIRS}
    names = groups.get(options.effects) or tuple(options.effects.split(","))
    end = ":stated" if options.stated else ""
    keys = [f"{name}:{k}:{seed_of(name, options.first_seed + k)}{end}" for k in range(options.seeds) for name in names]
    text = table_of(sorted(rows_of(try_blind, keys, jobs=options.jobs, kept=options.kept), key=_order(names)))
    print(text)
    if options.write is not None:
        options.write.write_text(wrapped("Hidden effects", "tests.loop.blind", text, arguments), encoding="utf-8")


def seed_of(name: str, number: int) -> int:
    """Seed of a case; every kind has sites and robots of its own, so that cases are independent."""
    return 1000 * number + zlib.crc32(name.encode()) % 1000


def _order(names: Sequence[str]) -> Callable[[Row], int]:
    return lambda row: names.index(_kinds(row))


if __name__ == "__main__":
    main()
