"""How often does a calibration name something where nothing is hidden? `python -m tests.loop.nulls --cases 60`.

Each cell is one kind of variation. Its cases have random sites, robots and drives, and no effect. Half of the robots
are declared truly and half are off by 10 %, as `--declared` says; in cells that do not say flat or hilly, every second
site is flat. At most 5 % of a cell's cases may name anything, with a form or without.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

from scipy.stats import binomtest

from tests.loop.calibrator import joulemap
from tests.loop.document import wrapped
from tests.loop.generators.case import make_case
from tests.loop.generators.config import FLAT, HILLY, CaseConfig, NoiseConfig, RobotConfig
from tests.loop.parallel import Row, rows_of

KINDS: dict[str, NoiseConfig] = {
    **{f"offset{p}": NoiseConfig(run_sd=p / 100) for p in (0, 2, 5, 10)},
    "serial": NoiseConfig(white_sd=0.0, serial_sd=0.05),
    "walk": NoiseConfig(walk_sd=0.005),
    "student": NoiseConfig(freedom=3.0),
    "place": NoiseConfig(region_factor=3.0),
    "hits": NoiseConfig(hit_share=0.05),
}
"""Variation by name. Run offsets, and what the others have beside their own: 5 % of each metre, 2 % of a run."""

_GROUNDS = {"flat": FLAT, "hilly": HILLY}


def cells() -> list[str]:
    """Names of all cells: kind-base-runs-ground."""
    out = [
        f"{kind}-{base}-{runs}-both" for kind in list(KINDS)[:4] for base in ("base", "nobase") for runs in (4, 6, 12)
    ]
    out += [
        f"{kind}-{base}-6-{ground}" for kind in list(KINDS)[4:] for base in ("base", "nobase") for ground in _GROUNDS
    ]
    return out


def config_of(cell: str, number: int, declared: str = "mixed", *, inertia: bool = True) -> CaseConfig:
    """Settings of one case of a cell.

    Parameters
    ----------
    cell : str
        As `cells` names it.
    number : int
        Of the case: its parity chooses the ground, the next bit how the robot is declared.
    declared : str
        "true", "off" (by 10 %) or "mixed".
    inertia : bool
        Whether speeding up takes kinetic energy.

    Returns
    -------
    CaseConfig
        The settings.
    """
    kind, base, runs, ground = cell.split("-")
    site = (FLAT, HILLY)[number % 2] if ground == "both" else _GROUNDS[ground]
    off = declared == "off" or (declared == "mixed" and (number // 2) % 2 == 1)
    return CaseConfig(
        site=site,
        robot=replace(RobotConfig(), declared_off=0.10 if off else 0.0),
        noise=KINDS[kind],
        new_runs=int(runs),
        base_runs=6 if base == "base" else 0,
        inertia=inertia,
    )


def try_null(key: str) -> Row:
    """One case, as "cell:number:seed:declared", with ":weightless" after it for no kinetic energy."""
    cell, number, seed, declared, *rest = key.split(":")
    case = make_case(config_of(cell, int(number), declared, inertia=not rest), int(seed))
    found = joulemap(case.new.site, case.declared, case.new.logs, case.base)
    named = [answer.name for answer in found.answers]
    return {"named": named, "said": ", ".join(named) or "nothing"}


def keys_of(some: Sequence[str], cases: int, first_seed: int, declared: str) -> list[str]:
    """Keys of cases; seeds differ between cells, and are those of the same case whatever cells are asked for."""
    index = {cell: k for k, cell in enumerate(cells())}
    return [f"{c}:{k}:{first_seed + 10_000 * index[c] + k}:{declared}" for k in range(cases) for c in some]


def table_of(rows: Sequence[Row]) -> str:
    """Markdown: one line for each cell, and the counts in all."""
    lines = [
        "| variation | base runs | runs | ground | cases | naming anything | share (95 % interval) | names "
        "| failed | s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    tried, wrong, over = 0, 0, 0
    for cell in dict.fromkeys(row["key"].split(":")[0] for row in rows):
        mine = [row for row in rows if row["key"].split(":")[0] == cell]
        good = [row for row in mine if "error" not in row]
        names = Counter(name for row in good for name in row["named"])
        count = sum(bool(row["named"]) for row in good)
        tried, wrong, over = tried + len(good), wrong + count, over + (count > 0.05 * len(good))
        share = binomtest(count, len(good)).proportion_ci() if good else None
        kind, base, runs, ground = cell.split("-")
        cells_of_row = [
            kind,
            "yes" if base == "base" else "no",
            runs,
            ground,
            str(len(good)),
            str(count),
            f"{count / len(good):.0%} ({share.low:.0%} to {share.high:.0%})" if share is not None else "",
            ", ".join(f"{name} {n}" for name, n in names.most_common()),
            str(len(mine) - len(good)),
            f"{sorted(row['s'] for row in mine)[len(mine) // 2]:.1f}",
        ]
        lines.append("| " + " | ".join(cells_of_row) + " |")
    lines.append(
        f"\nSomething is named in {wrong} of {tried} cases ({wrong / max(tried, 1):.1%}); {over} cells are above 5 %; "
        f"{len(rows) - tried} cases failed."
    )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.nulls", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=60, help="in each cell [default: 60]")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cells", default="*", help="patterns of cells joined by commas; --list shows all")
    parser.add_argument("--declared", choices=["true", "off", "mixed"], default="mixed")
    parser.add_argument("--weightless", action="store_true", help="speeding up takes no kinetic energy")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of finished cases, to continue")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table with its command")
    parser.add_argument("--list", action="store_true", help="list the cells")
    options = parser.parse_args(arguments)
    some = [c for c in cells() if any(fnmatch(c, pattern) for pattern in options.cells.split(","))]
    if options.list:
        print("\n".join(some))
        return
    keys = keys_of(some, options.cases, options.first_seed, options.declared + ":weightless" * options.weightless)
    text = table_of(rows_of(try_null, keys, jobs=options.jobs, kept=options.kept))
    print(text)
    if options.write is not None:
        options.write.write_text(wrapped("Nothing hidden", "tests.loop.nulls", text, arguments), encoding="utf-8")


if __name__ == "__main__":
    main()
