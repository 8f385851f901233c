"""Which rules of the calibration pay? Each is taken away in turn: `python -m tests.loop.ablation`.

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

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.loop import _base_step as base_step
from joulemap.model.loop import _design as design
from joulemap.model.loop import _mixed_model as mixed_model
from joulemap.model.loop import _procedure as procedure
from joulemap.model.loop import _selection as selection
from joulemap.model.loop import _variation as variation
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.runs.calibration_runs import CalibrationRuns
from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.residuals import Residuals
from joulemap.service.loop.measured import measure
from tests.coverage.real import cuadriga, drive, real_folder
from tests.loop import blind, nulls
from tests.loop.calibrator import answer_of, segments_of
from tests.loop.document import wrapped
from tests.loop.generators.case import make_case
from tests.loop.generators.hidden import KINDS, PAIRS, drawn_effects
from tests.loop.generators.logs import Log
from tests.loop.parallel import Row, rows_of


def _one_row(columns: design.Design, _around: variation.Variation) -> FloatArray:
    return np.ones(columns.columns.shape[1])


def _white(found: variation.Variation, *_given: Any) -> variation.Variation:
    return replace(found, length_rows=1.0, process=0.0)


RULES: dict[str, Callable[[], AbstractContextManager[Any]]] = {
    "nothing": nullcontext,
    "where the drives coast": lambda: patch.object(base_step, "drives_of", lambda rows: rows.features.drives),
    "Huber's weights": lambda: patch.object(variation, "HUBER", 1e9),
    "the wide prior of base parameters": lambda: patch.object(design, "_prior_rows", _one_row),
    "serial correlation": lambda: patch.object(variation, "_correlated", _white),
    "the variation around the largest model": lambda: patch.object(selection, "_largest", lambda columns: []),
    "the prior of what differs between runs": lambda: patch.object(mixed_model, "RUN_SPREAD", 1e6),
    "tests inside runs": lambda: patch.object(mixed_model.MixedModel, "test_within", lambda *_given: 1.0),
    "tests between runs": lambda: patch.object(mixed_model.MixedModel, "test_between", lambda *_given: 1.0),
    "the least gain on left-out runs": lambda: patch.object(selection, "LEAST_GAIN", 0.0),
    "the standard error of a gain": lambda: patch.object(
        selection, "within_one_error", lambda gains: gains.sum() <= 0.0
    ),
    "forms with a name first": lambda: patch.object(procedure, "UNNAMED", ()),
    "structure without a name": lambda: patch.object(design, "UNNAMED", ()),
    "forces of effects": lambda: patch.object(Features, "resisted_by", lambda rows, _added: rows),
    "effects chosen once more": lambda: patch.object(selection.Selection, "settled", lambda found, _kept: found),
    "limits of sign and size": lambda: patch.object(selection, "_physical", lambda *_given: True),
}
"""How each rule is taken away, by what is taken away."""


def try_without(key: str) -> Row:
    """One case under every rule: "blind|kinds:number:seed:runs", with so many baseline runs, or
    "null|cell:number:seed:declared"; with some rules joined by commas after a further bar, under these.
    """
    group, case_key, *some = key.split("|")
    name, number, seed, rest = case_key.split(":")
    if group == "null":
        case = make_case(nulls.config_of(name, int(number), rest), int(seed))
    else:
        config = replace(blind.config_of(int(number)), base_runs=int(rest), other_runs=0)
        case = make_case(config, int(seed), drawn_effects(name, int(seed)))

    def _rows(logs: Sequence[Log]) -> tuple[Residuals, dict[str, Any]]:
        segments = segments_of(logs, case.declared)
        return residuals_on(PhysicsPredictor(), case.new.site.heightmap, case.declared, segments)[:2]

    measured, electric = _rows(case.new.logs)
    base = _rows(case.base)[0] if case.base else None
    further = _rows(case.test.logs)[0] if case.test.logs else None
    out: Row = {}
    for rule in some[0].split(",") if some else RULES:
        with RULES[rule]():
            found = calibrate(measured, electric=electric, base=base, cross_validate=False)
        right = [[effect.is_named_by(answer_of(e).words) for effect in case.effects] for e in found.effects]
        out[rule] = {
            "named": [effect.term.form.name for effect in found.effects],
            "first": bool(right) and any(right[0]),
            "all": all(any(of_answer[k] for of_answer in right) for k in range(len(case.effects))),
            "wrong": any(not any(of_answer) for of_answer in right),
            "after": None if further is None else found.errors_on(further)["after"]["mean_relative"],
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
    for rule in good[0]["rules"] if good else ():
        ratio = [row[rule]["after"] / row["nothing"]["after"] for row in hidden]
        cells = [rule, *(str(sum(row[rule][key] for row in hidden)) for key in ("first", "all", "wrong"))]
        cells.append(f"{np.median(ratio):.3f}; {max(ratio):.2f}" if ratio else "")
        cells.append(str(sum(bool(row[rule]["named"]) for row in empty)))
        lines.append("| " + " | ".join(cells) + " |")
    if failed := [row for row in rows if "error" in row]:
        lines += ["", *(f"- failed: {row['key']}: {row['error']}" for row in failed)]
    return "\n".join(lines)


def real_table(folder: Path) -> str:
    """Markdown: errors per metre on left-out runs of real robots, without each rule."""
    kinds: dict[str, tuple[Callable[[Path], tuple[CalibrationRuns, list[str]]], str]] = {
        "DRIVE [J]": (drive, "after"),
        "Cuadriga [A s]": (cuadriga, "after"),
        "Cuadriga, planner [A s]": (cuadriga, "after_planner"),
    }
    read = {load: load(folder) for load in (drive, cuadriga)}
    lines = [f"| without | {' | '.join(kinds)} | named |", "|---|" + "---|" * (len(kinds) + 1)]
    for rule, without in RULES.items():
        with without():
            found = {}
            for load, (runs, campaigns) in read.items():
                measured = measure("physics", PhysicsPredictor(), runs)
                found[load] = calibrate(measured.residuals, electric=measured.electric, groups=campaigns)
        errors = [f"{found[load].errors[state]['rmse']:.4g}" for load, state in kinds.values()]
        named = "; ".join(", ".join(e.term.form.name for e in one.effects) or "nothing" for one in found.values())
        lines.append("| " + " | ".join([rule, *errors, named]) + " |")
    return "\n".join(lines)


def _on_hills(key: str) -> bool:
    """Whether a null case is hilly: every second one, where a cell has both kinds of ground."""
    return int(key.split(":")[1]) % 2 == 1


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.ablation", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, help="cases of each hidden effect [default: 1]")
    parser.add_argument("--nulls", type=int, default=1, help="cases of each hilly cell without an effect [default: 1]")
    parser.add_argument("--base", type=int, default=0, help="baseline runs; 0 takes an eighth of the time [default: 0]")
    parser.add_argument("--every", type=int, default=1, help="only one of so many cases [default: 1]")
    parser.add_argument("--rules", help="only these, joined by commas; 'nothing' must be one")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of finished cases, to continue")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table with its command")
    parser.add_argument("--real", action="store_true", help="the real runs in place of generated cases")
    options = parser.parse_args(arguments)
    if options.real:
        folder = real_folder()
        if folder is None:
            parser.error("there are no real runs here (set JOULEMAP_REAL_DATA to their folder)")
        print(real_table(folder))
        return
    keys = [
        f"blind|{name}:{k}:{blind.seed_of(name, options.first_seed + k)}:{options.base}"
        for k in range(options.seeds)
        for name in (*KINDS, *PAIRS)
    ]
    cells = [cell for cell in nulls.cells() if ("nobase" in cell) == (options.base == 0) and "flat" not in cell]
    seeds = 1000 * options.first_seed
    keys += [f"null|{key}" for key in nulls.keys_of(cells, 2 * options.nulls, seeds, "mixed") if _on_hills(key)]
    end = f"|{options.rules}" if options.rules else ""
    keys = [key + end for key in keys[:: options.every]]
    text = table_of(rows_of(try_without, keys, jobs=options.jobs, kept=options.kept))
    print(text)
    if options.write is not None:
        options.write.write_text(wrapped("Without a rule", "tests.loop.ablation", text, arguments), encoding="utf-8")


if __name__ == "__main__":
    main()
