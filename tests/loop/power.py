"""How large must an effect be, and how many runs does it take? `python -m tests.loop.power --cases 20 --jobs 2`.

Two kinds of curves. For effects that vary within a run: the share of cases that name the effect against its size (1 is
the usual size of `generators.hidden`) on six runs. For effects that are constant within a run, such as weather and
payload: the same share against the number of runs, for several spreads between runs, because these hide them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from tests.loop.calibrator import joulemap
from tests.loop.document import wrapped
from tests.loop.generators.case import make_case
from tests.loop.generators.config import CaseConfig, NoiseConfig, RobotConfig
from tests.loop.generators.hidden import KINDS, drawn_effects
from tests.loop.parallel import Row, rows_of

SIZES = (0.03, 0.06, 0.125, 0.25, 0.5, 1.0)
RUNS = (4, 6, 8, 12, 16, 24)
SPREADS = (0.02, 0.05, 0.10)
_ALL = "all of them"


def try_power(key: str) -> Row:
    """One case, given as "kind:size:runs:spread:base:seed"."""
    kind, size, runs, spread, base, seed = key.split(":")
    config = CaseConfig(
        robot=replace(RobotConfig(), declared_off=0.10 * (int(seed) % 2)),
        noise=NoiseConfig(run_sd=float(spread)),
        new_runs=int(runs),
        base_runs=int(base),
    )
    case = make_case(config, int(seed), drawn_effects(kind, int(seed), size=float(size)))
    answers = joulemap(case.new.site, case.declared, case.new.logs, case.base).answers
    right = [case.effects[0].is_named_by(answer.words) for answer in answers]
    named = [answer.name for answer in answers]
    said = ", ".join(named) or "nothing"
    return {"named": named, "found": any(right), "said": said, "share": case.new.extra_share / float(size)}


def curve(rows: Sequence[Row], place: int, head: str) -> str:
    """Markdown: a line for each kind, spread and number of baseline runs, and for all kinds together; a column for each
    value of part `place`."""
    parts = [row["key"].split(":") for row in rows]
    values = sorted({part[place] for part in parts}, key=float)
    lines = [
        f"| effect | energy at size 1 | run-to-run spread | base runs | cases "
        f"| {' | '.join(f'{head} {v}' for v in values)} |",
        "|---" * (5 + len(values)) + "|",
    ]
    kinds = sorted({part[0] for part in parts})
    for kind in [*kinds, _ALL] if len(kinds) > 1 else kinds:
        of_kind = [(row, part) for row, part in zip(rows, parts, strict=True) if kind in (part[0], _ALL)]
        for spread, base in sorted({(float(part[3]), int(part[4])) for _, part in of_kind}):
            cells, counts, shares = [], [], []
            for value in values:
                mine = [
                    row
                    for row, part in of_kind
                    if (float(part[3]), int(part[4])) == (spread, base) and part[place] == value and "error" not in row
                ]
                counts.append(len(mine))
                shares += [row["share"] for row in mine]
                cells.append(_share(mine))
            lines.append(
                f"| {kind} | {np.median(shares) if shares else 0.0:+.1%} | {spread:.0%} | {base} "
                f"| {min(counts)} to {max(counts)} | {' | '.join(cells)} |"
            )
    return "\n".join(lines)


def _share(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    hits = sum(row["found"] for row in rows)
    interval = binomtest(hits, len(rows)).proportion_ci()
    return f"{hits / len(rows):.0%} ({interval.low:.0%} to {interval.high:.0%})"


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.power", description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", default="all", help="kinds joined by commas [default: all]")
    parser.add_argument("--sizes", default=",".join(map(str, SIZES)), help="of effects within runs")
    parser.add_argument("--runs", default=",".join(map(str, RUNS)), help="numbers of runs, for effects between runs")
    parser.add_argument("--spreads", default=",".join(map(str, SPREADS)), help="between runs, for effects between runs")
    parser.add_argument(
        "--between", type=float, default=1.0, metavar="SIZE", help="of effects between runs [default: 1]"
    )
    parser.add_argument("--base", type=int, default=6, help="baseline runs; 0 for none [default: 6]")
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of finished cases, to continue")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the tables with their command")
    options = parser.parse_args(arguments)
    kinds = list(KINDS) if options.kinds == "all" else options.kinds.split(",")
    seeds = range(options.first_seed, options.first_seed + options.cases)
    within = [
        f"{kind}:{size}:6:0.02:{options.base}:{seed}"
        for seed in seeds
        for kind in kinds
        if not KINDS[kind].between
        for size in options.sizes.split(",")
    ]
    between = [
        f"{kind}:{options.between}:{runs}:{spread}:{options.base}:{seed}"
        for seed in seeds
        for kind in kinds
        if KINDS[kind].between
        for runs in options.runs.split(",")
        for spread in options.spreads.split(",")
    ]
    rows = {row["key"]: row for row in rows_of(try_power, within + between, jobs=options.jobs, kept=options.kept)}
    text = "\n\n".join(
        curve([rows[key] for key in keys], place, head)
        for keys, place, head in ((within, 1, "size"), (between, 2, "runs"))
        if keys
    )
    failed = sum("error" in row for row in rows.values())
    text += f"\n\nShare of cases that name the effect (95 % interval). {failed} of {len(rows)} cases failed."
    print(text)
    if options.write is not None:
        options.write.write_text(wrapped("Power", "tests.loop.power", text, arguments), encoding="utf-8")


if __name__ == "__main__":
    main()
