"""`python -m tests.loop --effects turning,wind --seeds 8`: validate a calibrator on unseen cases and print the table.

Base models and finished outcomes are kept in --work: a run that was cut off continues, and `--table` alone prints
what is there. Two effects together are joined by "+". No effect is "none", of which more seeds are used: a rare event
needs many cases.
"""

from __future__ import annotations

import argparse
import datetime as dt
import os
import platform
import sys
from pathlib import Path

from joulemap.model.field.hidden_draws import EFFECT_NAMES
from tests.loop.cases import append_outcome, read_outcomes
from tests.loop.many import outcomes
from tests.loop.table import LEGEND, summary_of, table_of

PAIRS = ("turning+wind", "payload+hotel_load", "terrain_class+turning", "braking+temperature", "drift+cross_slope")
CALIBRATOR = "tests.loop.calibrators:Joulemap"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.loop", description=__doc__.splitlines()[0])
    parser.add_argument("--effects", default="all", help="names joined by commas, or all, singles, pairs")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--none-seeds", type=int, default=24, help="at least so many cases without an effect")
    parser.add_argument("--calibrator", default=CALIBRATOR, metavar="MODULE:NAME", help=f"[default: {CALIBRATOR}]")
    parser.add_argument(
        "--work", type=Path, default=Path("data/validation"), help="base models and outcomes are kept here"
    )
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the document (model/loop/VALIDATION.md) too")
    parser.add_argument("--table", action="store_true", help="run nothing, only show what is there")
    options = parser.parse_args()
    singles = ("none", *EFFECT_NAMES)
    known = {"all": (*singles, *PAIRS), "singles": singles, "pairs": PAIRS}
    cases = known.get(options.effects) or tuple(options.effects.split(","))
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    quiet = range(seeds.stop, options.first_seed + options.none_seeds) if "none" in cases else ()
    options.work.mkdir(parents=True, exist_ok=True)
    kept = options.work / f"{options.calibrator.replace(':', '.')}.jsonl"
    done = {(o.case, o.seed): o for o in read_outcomes(kept)}
    wanted = [(case, seed) for seed in seeds for case in cases]  # cut off, every case has as many seeds
    wanted += [("none", seed) for seed in quiet]
    if not options.table:
        todo = [key for key in wanted if key not in done]
        for number, outcome in enumerate(outcomes(todo, options.calibrator, options.work, options.jobs), start=1):
            append_outcome(kept, outcome)
            done[outcome.case, outcome.seed] = outcome
            print(
                f"{number}/{len(todo)} {outcome.case} {outcome.seed}: {', '.join(outcome.found) or 'nothing'}"
                f" {outcome.new_before:.3f} -> {outcome.new_after:.3f} ({outcome.tried_s:.0f} s)",
                file=sys.stderr,
            )
    there = [done[key] for key in wanted if key in done]
    text = f"{summary_of(there)}\n\n{table_of(there)}"
    print(text)
    if options.write is not None:
        options.write.write_text(document(text, options), encoding="utf-8")


def document(table: str, options: argparse.Namespace) -> str:
    """What is committed: the table with its command, date and machine."""
    command = f"python -m tests.loop --effects {options.effects} --seeds {options.seeds}"
    command += f" --first-seed {options.first_seed}" if options.first_seed else ""
    command += f" --none-seeds {options.none_seeds}" if options.none_seeds != 24 else ""
    command += f" --calibrator {options.calibrator}" if options.calibrator != CALIBRATOR else ""
    return (
        "# Validation on unseen cases\n\n"
        "The simulated field hides effects in runs (`model/field/validation_case.py`), and the calibration gets only "
        "the runs. Field and calibration share no formula.\n\n"
        f"`{command}`, {dt.date.today()}, {os.cpu_count()} cores of {_processor()}, Python {platform.python_version()}."
        f"\n\n{table}\n\n{LEGEND}\n"
    )


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


if __name__ == "__main__":
    main()
