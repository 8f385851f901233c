"""`python -m tests.coverage`: are the odds of route energies right?

Prints the share of routes inside their 50, 80 and 90 % intervals, Brier scores of verdicts beside those of a verdict
from the mean and of one that asks for 20 % more, and the reliability curve: on simulated sites that the shipped network
never saw, and on the real runs of Cuadriga and DRIVE with whole campaigns left out.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.energy.uncertainty import fit_spread
from tests.coverage.real import cuadriga, drive, keep, kept, left_out, real_folder, routes_of
from tests.coverage.scores import Judged, judged, pooled, scores
from tests.coverage.simulated import FIT_SEED, simulated

REAL = {"cuadriga": cuadriga, "drive": drive}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulated", action="store_true", help="only the simulated sites")
    parser.add_argument("--real", action="store_true", help="only the real runs")
    parser.add_argument("--sites", type=int, default=210, metavar="N", help="simulated sites, a drive on each (210)")
    parser.add_argument("--fit", action="store_true", help="print the spread of the shipped network on other sites")
    parser.add_argument("--kept", type=Path, metavar="DIR", help="keep predictions of real runs here, or read them")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all figures here")
    asked = parser.parse_args()
    if asked.fit:
        held, _ = simulated(asked.sites, seed=FIT_SEED)
        spread = fit_spread(held.measured, held.predicted, held.std, held.run)
        print(json.dumps(asdict(spread), indent=2))
        return
    figures: dict[str, Any] = {}
    if not asked.real:
        held, eq5 = simulated(asked.sites)
        routes = judged("simulated", load_predictor("default").spread, held, shortest=20, longest=300, cuts=2)
        figures["simulated"] = _say(routes)
        shares = np.array([held.measured[held.run == k].sum() / eq5[held.run == k].sum() for k in np.unique(held.run)])
        figures["simulated"]["physics"] = float(np.median(np.abs(shares - 1.0)))
        print(f"  equation 5, declared: median error of whole drives {figures['simulated']['physics']:.0%}")
    if not asked.simulated:
        folder = real_folder()
        if folder is None:
            print("real runs: skipped, there are none here (set JOULEMAP_REAL_DATA to their folder)")
        else:
            figures |= _real(folder, asked.kept)
    if asked.json is not None:
        asked.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def _real(folder: Path, keeping: Path | None) -> dict[str, Any]:
    figures, every = {}, []
    for name, read in REAL.items():
        there = keeping / name if keeping is not None else None
        found = kept(there) if there is not None else {}
        if not found:
            found = left_out(*read(folder))
            if there is not None:
                keep(there, found)
        routes = pooled(routes_of(found), name)
        every.append(routes)
        figures[name] = _say(routes)
    figures["real"] = _say(pooled(every, "real"))
    return figures


def _say(routes: Judged) -> dict[str, Any]:
    found = scores(routes)
    covered = ", ".join(f"{level} %: {100 * share:.1f} %" for level, share in found["coverage"].items())
    brier = ", ".join(f"{name} {value:.4f}" for name, value in found["brier"].items())
    print(f"{routes.name}: {found['routes']} routes, inside {covered}; below the mean {found['below the mean']:.0%}")
    print(f"  Brier score: {brier}")
    curve = ", ".join(f"{said:.2f}:{happened:.2f}" for said, happened, _ in found["reliability"])
    print(f"  reliability (said:happened): {curve}")
    return found


if __name__ == "__main__":
    main()
