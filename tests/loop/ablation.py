"""Which rules of the calibration pay? Each is taken away in turn: `python -m tests.loop.ablation --seeds 1 --nulls 22`.

The cases are those of `tests.loop.blind` and `tests.loop.nulls`, whose sites, robots, drives and effects share no
formula with the calibration. A rule stays if taking it away costs right answers, adds wrong ones, names something where
nothing is, or makes the error on further runs larger.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from joulemap.model.loop import base_step, design, mixed_model, selection, variation
from tests.loop import blind, nulls
from tests.loop.calibrator import joulemap
from tests.loop.document import wrapped
from tests.loop.generators.case import make_case
from tests.loop.generators.hidden import KINDS, PAIRS, drawn_effects
from tests.loop.parallel import Row, rows_of


def _largest_gain(
    columns: design.Design,
    verdicts: Sequence[selection.Verdict],
    chosen: Sequence[design.Candidate],
    *,
    unnamed: bool,
) -> int | None:
    able = [
        k
        for k, verdict in enumerate(verdicts)
        if not verdict.why_not
        and not any(columns.candidates[k] is c for c in chosen)
        and (unnamed or not isinstance(columns.candidates[k].form, selection.UNNAMED))
    ]
    return max(able, key=lambda k: verdicts[k].gain, default=None)


def _together() -> AbstractContextManager[Any]:
    simplest = selection._simplest
    return patch.object(selection, "_simplest", lambda *given, unnamed: simplest(*given, unnamed=True))


def _white(found: variation.Variation, *_given: Any) -> variation.Variation:
    return replace(found, length_rows=1.0, process=0.0)


RULES: dict[str, Callable[[], AbstractContextManager[Any]]] = {
    "nothing": nullcontext,
    "where the drives coast": lambda: patch.object(base_step, "drives_of", lambda rows: rows.features.drives),
    "Huber's weights": lambda: patch.object(variation, "HUBER", 1e9),
    "serial correlation": lambda: patch.object(variation, "_correlated", _white),
    "the variation around the largest model": lambda: patch.object(selection, "_largest", lambda columns: []),
    "tests inside runs": lambda: patch.object(
        mixed_model.MixedModel, "test_within", lambda *_given: mixed_model._NO_TEST
    ),
    "tests between runs": lambda: patch.object(
        mixed_model.MixedModel, "test_between", lambda *_given: mixed_model._NO_TEST
    ),
    "the least gain on left-out runs": lambda: patch.object(selection, "LEAST_GAIN", 0.0),
    "the one-standard-error rule": lambda: patch.object(selection, "_simplest", _largest_gain),
    "forms with a name first": _together,
    "structure without a name": lambda: patch.object(design, "UNNAMED", ()),
    "limits of sign and size": lambda: patch.object(selection, "_physical", lambda *_given: True),
}
"""How each rule is taken away, by what is taken away."""


def try_without(key: str) -> Row:
    """One case under every rule: "blind|kinds:number:seed" or "null|cell:number:seed:declared"."""
    group, case_key = key.split("|")
    name, number, seed, *declared = case_key.split(":")
    if group == "null":
        case = make_case(nulls.config_of(name, int(number), *declared), int(seed))
    else:
        case = make_case(blind.config_of(int(number)), int(seed), drawn_effects(name, int(seed)))
    out: Row = {}
    for rule, without in RULES.items():
        with without():
            found = joulemap(case.new.site, case.declared, case.new.logs, case.base)
        right = [[effect.is_named_by(answer.words) for effect in case.effects] for answer in found.answers]
        out[rule] = {
            "named": [answer.name for answer in found.answers],
            "first": bool(right) and any(right[0]),
            "all": all(any(of_answer[k] for of_answer in right) for k in range(len(case.effects))),
            "wrong": any(not any(of_answer) for of_answer in right),
            "after": found.error_on(case.test.site, case.test.logs) if group == "blind" else None,
        }
    return {"rules": out, "said": ", ".join(out["nothing"]["named"]) or "nothing"}


def table_of(rows: Sequence[Row]) -> str:
    """Markdown: a line for each rule."""
    good = [row for row in rows if "error" not in row]
    hidden = [row["rules"] for row in good if row["key"].startswith("blind")]
    empty = [row["rules"] for row in good if row["key"].startswith("null")]
    lines = [
        f"| without | first right, of {len(hidden)} | all right | wrong beside | error after, over that with all rules "
        f"(median; worst) | named where nothing is, of {len(empty)} |",
        "|---|---|---|---|---|---|",
    ]
    for rule in RULES:
        ratio = [row[rule]["after"] / row["nothing"]["after"] for row in hidden]
        cells = [rule, *(str(sum(row[rule][key] for row in hidden)) for key in ("first", "all", "wrong"))]
        cells.append(f"{np.median(ratio):.3f}; {max(ratio):.2f}" if ratio else "")
        cells.append(str(sum(bool(row[rule]["named"]) for row in empty)))
        lines.append("| " + " | ".join(cells) + " |")
    if failed := [row for row in rows if "error" in row]:
        lines += ["", *(f"- failed: {row['key']}: {row['error']}" for row in failed)]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.ablation", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, help="cases of each hidden effect [default: 1]")
    parser.add_argument("--nulls", type=int, default=22, help="cases without an effect [default: 22]")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of finished cases, to continue")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table with its command")
    options = parser.parse_args(arguments)
    keys = [
        f"blind|{name}:{k}:{blind.seed_of(name, options.first_seed + k)}"
        for k in range(options.seeds)
        for name in (*KINDS, *PAIRS)
    ]
    cells = nulls.cells()[:: max(1, len(nulls.cells()) // max(options.nulls, 1))][: options.nulls]
    keys += [f"null|{key}" for key in nulls.keys_of(cells, 1, options.first_seed, "mixed")]
    text = table_of(rows_of(try_without, keys, jobs=options.jobs, kept=options.kept))
    print(text)
    if options.write is not None:
        options.write.write_text(wrapped("Without a rule", "tests.loop.ablation", text, arguments), encoding="utf-8")


if __name__ == "__main__":
    main()
