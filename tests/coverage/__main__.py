"""`python -m tests.coverage`: are the odds of route energies right?

Prints the share of routes inside their 50, 80 and 90 % intervals, Brier scores of verdicts beside those of a verdict
from the mean and of one that asks for 20 % more, and the reliability curve: on simulated sites that the shipped network
never saw, and on the real runs of Cuadriga and DRIVE with whole campaigns left out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.energy.uncertainty import fit_spread
from joulemap.model.field.sites import SURVEYS, random_survey
from tests.coverage.real import cuadriga, drive, keep, kept, left_out, real_folder, routes_of
from tests.coverage.scores import Judged, columns_of, judged, scores, taken
from tests.coverage.simulated import simulated

PARTS = 10
REAL = {"cuadriga": cuadriga, "drive": drive}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulated", action="store_true", help="only the simulated sites")
    parser.add_argument("--real", action="store_true", help="only the real runs")
    parser.add_argument("--sites", type=int, default=300, metavar="N", help="simulated sites, a drive on each (300)")
    parser.add_argument(
        "--survey",
        choices=(*SURVEYS, "any"),
        help="only simulated sites, as this survey shows them, by the network's own spread",
    )
    parser.add_argument("--kept", type=Path, metavar="DIR", help="keep all predictions here, or read them")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all figures here")
    asked = parser.parse_args()
    figures: dict[str, Any] = {}
    if asked.survey is not None:
        draw = random_survey if asked.survey == "any" else lambda _: SURVEYS[asked.survey]
        held, _, spread = simulated(asked.sites, survey=draw)
        figures[asked.survey] = _say(asked.survey, [judged(asked.survey, spread, held, shortest=20, longest=300)])
    elif not asked.real:
        figures["simulated"] = _simulated(asked.sites, asked.kept)
    if asked.survey is None and not asked.simulated:
        folder = real_folder()
        if folder is None:
            print("real runs: skipped, there are none here (set JOULEMAP_REAL_DATA to their folder)")
        else:
            figures |= _real(folder, asked.kept)
    if asked.json is not None:
        asked.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def _simulated(sites: int, keeping: Path | None) -> dict[str, Any]:
    """Routes of every tenth of the sites, by the spread that the others show."""
    there = keeping / "simulated" if keeping is not None else None
    found = kept(there) if there is not None else {}
    if not found:
        held, eq5, _ = simulated(sites)
        found = {"sites": (held, replace(held, predicted=eq5))}
        if there is not None:
            keep(there, found)
    held, eq5_held = found["sites"]
    names = np.unique(held.run)
    part = np.random.default_rng(0).permutation(names.size) % PARTS
    routes = []
    for k in range(PARTS):
        out = np.isin(held.run, names[part == k])
        spread = fit_spread(*columns_of(held, ~out))
        routes.append(judged("simulated", spread, taken(held, out), shortest=20, longest=300, cuts=2))
    figures = _say("simulated", routes)
    figures["drives"] = int(names.size)
    shares = [held.measured[held.run == k].sum() / eq5_held.predicted[held.run == k].sum() for k in names]
    figures["physics"] = float(np.median(np.abs(np.array(shares) - 1.0)))
    figures["spread"] = fit_spread(*columns_of(held, np.ones(held.run.size, dtype=bool))).as_dict()
    print(f"  {names.size} drives; equation 5, declared: median error of whole drives {figures['physics']:.0%}")
    print(f"  spread of the shipped network: {json.dumps(figures['spread'])}")
    return figures


def _real(folder: Path, keeping: Path | None) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    every: list[Judged] = []
    for name, read in REAL.items():
        there = keeping / name if keeping is not None else None
        found = kept(there) if there is not None else {}
        if not found:
            found = left_out(*read(folder))
            if there is not None:
                keep(there, found)
        routes = routes_of(found)
        every += routes
        figures[name] = _say(name, routes)
    figures["real"] = _say("real", every)
    return figures


def _say(name: str, routes: Sequence[Judged]) -> dict[str, Any]:
    found = scores(routes)
    covered = ", ".join(f"{level} %: {100 * share:.1f} %" for level, share in found["coverage"].items())
    brier = ", ".join(f"{name} {value:.4f}" for name, value in found["brier"].items())
    print(f"{name}: {found['routes']} routes, inside {covered}; below the median {found['below the median']:.0%}")
    print(f"  Brier score: {brier}")
    curve = ", ".join(f"{said:.2f}:{happened:.2f}" for said, happened, _ in found["reliability"])
    print(f"  reliability (said:happened): {curve}")
    return found


if __name__ == "__main__":
    main()
