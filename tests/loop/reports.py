"""Does every calibration end in a report? `python -m tests.loop.reports --cases 60 --first-seed 0`.

The cases are those of `tests.loop.blind` with shorter runs: every kind of hidden effect and every pair in turn, and
nothing hidden, always with baseline runs. Each is written as files and goes through `joulemap calibrate` to the files
that it leaves. Every fifth case repeats the calibration without each run; the others are quick. Whether an answer is
right is not asked here.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from joulemap.model.loop.calibration_file import read_calibrated
from joulemap.service.cli import app
from joulemap.service.loop.summary import summary_lines
from tests.loop.blind import config_of, seed_of
from tests.loop.generators.case import Case, make_case
from tests.loop.generators.hidden import KINDS, PAIRS, drawn_effects
from tests.loop.parallel import Row, rows_of

EVERY = (*KINDS, *PAIRS, "none")
_WHOLE = 5  # of so many cases one is not quick


def case_of(key: str) -> Case:
    """The case "kinds:number:seed:runs:metres"; with as many baseline runs, and one test run."""
    kinds, number, seed, runs, metres = key.split(":")
    config = config_of(int(number))
    config = replace(
        config,
        drive=replace(config.drive, length_m=float(metres)),
        new_runs=int(runs),
        base_runs=int(runs),
        test_runs=1,
        other_runs=0,
    )
    return make_case(config, int(seed), drawn_effects(kinds, int(seed)))


def try_report(key: str) -> Row:
    """Take a case, as `case_of`, through the command line: what was found, and what the report lacks."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        case_of(key).write(folder)
        paths = {"heightmap": "dem.tif", "robot": "robot.toml", "runs": "new", "baseline-runs": "base"}
        paths |= {"test-runs": "test", "out": "found"}
        options = [word for name, path in paths.items() for word in (f"--{name}", str(folder / path))]
        options += ["--quick"] if int(key.split(":")[1]) % _WHOLE else []
        done = CliRunner().invoke(app, ["calibrate", "--model", "physics", *options])
        lacks = [_last_call(done.exception)] if done.exit_code else list(_lacking(folder / "found", done.output))
        report = folder / "found" / "report.json"
        document = json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {"effects": []}
    effects = [effect["name"] for effect in document["effects"]]
    curves = [e["name"] for e in document["effects"] if e["form"] == "curve" and not e["settings"]["centred"]]
    said = f"a report, found: {', '.join(effects) or 'nothing'}" if not lacks else f"NO REPORT: {'; '.join(lacks)}"
    return {"lacks": lacks, "effects": effects, "against_baseline": curves, "said": said}


def _last_call(error: BaseException | None) -> str:
    """An error with the place of this project's code where it was raised."""
    frames = traceback.extract_tb(error.__traceback__) if error else []
    frames = [frame for frame in frames if "site-packages" not in frame.filename]
    where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def _lacking(out: Path, output: str) -> Iterator[str]:
    """What is not there, or not whole, of what a calibration writes and says."""
    document = json.loads((out / "report.json").read_text(encoding="utf-8"), parse_constant=_no_number)
    page = (out / "report.html").read_text(encoding="utf-8")
    if not (page.startswith("<!doctype html>") and page.endswith("</html>\n")):
        yield "report.html is not whole"
    yield from (f"report.html lacks {e['label']}" for e in document["effects"] if escape(e["label"]) not in page)
    said = " ".join(output.split())
    yield from (f"not said: {line}" for line in summary_lines(document) if " ".join(line.split()) not in said)
    correction, _, version = read_calibrated(out / "model")
    if version != document["model"]["after"]:
        yield "the model has another version than the report says"
    if {effect["name"] for effect in document["effects"]} - {term.form.name for term in correction.terms}:
        yield "the model lacks an effect"


def _no_number(text: str) -> Any:
    raise ValueError(f"report.json has {text}, which is no number")


def keys_of(cases: int, first_seed: int, runs: int, metres: float, effects: Sequence[str] = EVERY) -> list[str]:
    """Keys of cases: every kind and pair in turn, with sites and robots of its own."""
    out = []
    for k in range(cases):
        kinds, number = effects[k % len(effects)], first_seed + k // len(effects)
        out.append(f"{kinds}:{k}:{seed_of(kinds, number)}:{runs}:{metres:g}")
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.reports", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=60, help="in all [default: 60]")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--effects", default="all", help="kinds or pairs joined by commas [default: all in turn]")
    parser.add_argument("--runs", type=int, default=6, help="new runs, and as many baseline runs [default: 6]")
    parser.add_argument("--metres", type=float, default=150.0, help="length of a run [default: 150]")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of finished cases, to continue")
    options = parser.parse_args(arguments)
    effects = EVERY if options.effects == "all" else tuple(options.effects.split(","))
    keys = keys_of(options.cases, options.first_seed, options.runs, options.metres, effects)
    rows = rows_of(try_report, keys, jobs=options.jobs, kept=options.kept)
    failed = [row for row in rows if row.get("error") or row["lacks"]]
    for row in failed:
        print(f"{row['key']}: {row.get('error') or '; '.join(row['lacks'])}")
    curves = sum(bool(row.get("against_baseline")) for row in rows)
    print(f"{len(rows) - len(failed)} of {len(rows)} reports, {curves} of them with a curve against the baseline runs.")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
