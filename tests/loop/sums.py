"""Are predicted energies right on average? `python -m tests.loop.sums --cases 4`.

A network is fine-tuned (`train`), and `physics` is calibrated, on runs of a generated case. Each predicts further runs
on the same site and on another. A route is a sum, so that the sum of the predictions counts beside the error per metre.
Noise differs from case to case: plain, heavy-tailed, and with disturbances that only ever cost more.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS, load_predictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.loop.calibrate import calibrate
from joulemap.service.loop.calibration import correction_of
from tests.coverage.scores import Held, Judged, judged, scores
from tests.loop.calibrator import segments_of
from tests.loop.generators.case import Case, make_case
from tests.loop.generators.config import CaseConfig, DriveConfig, NoiseConfig, RobotConfig
from tests.reference.one_site import evaluate_on_runs, train_on_runs

NOISES = {
    "plain": NoiseConfig(white_sd=0.08),
    "heavy tails": NoiseConfig(white_sd=0.08, freedom=3.0),
    "disturbances": NoiseConfig(hit_share=0.05),
    "serial": NoiseConfig(white_sd=0.0, serial_sd=0.08),
}


def case_of(number: int, seed: int, *, runs: int, length_m: float) -> tuple[str, Case]:
    """A case without hidden effects, and the name of its noise."""
    name = list(NOISES)[number % len(NOISES)]
    robot = replace(RobotConfig(), declared_off=0.10 * (number % 2))
    config = CaseConfig(
        robot=robot,
        noise=NOISES[name],
        drive=DriveConfig(length_m=length_m),
        new_runs=runs,
        base_runs=0,
        test_runs=3,
        other_runs=3,
    )
    return name, make_case(config, seed)


def errors_of_training(case: Case) -> list[tuple[float, float]]:
    """Sum of the predictions over that of the measured, minus 1, and error per metre: same site, other site."""
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder)
        case.write(there)
        ground = case.new.site.heightmap
        train_on_runs(
            ground,
            case.declared,
            sorted((there / "new").glob("*.csv")),
            out=there / "made",
            start_from=Path(str(SHIPPED_WEIGHTS)),
        )
        made = load_predictor(there / "made")
        out = []
        assert case.other is not None
        for heightmap, name in ((ground, "test"), (case.other.site.heightmap, "other_site")):
            found = evaluate_on_runs(made, heightmap, case.declared, sorted((there / name).glob("*.csv")))
            mean_j = found["mean_absolute_error_j"] / found["error_share"]
            out.append((-found["bias_j"] / mean_j, found["error_share"]))
    return out


def errors_of_calibration(case: Case) -> list[tuple[float, float]]:
    """The same of `physics` after a calibration."""
    physics, out = PhysicsPredictor(), []
    measured, electric, _ = residuals_on(
        physics, case.new.site.heightmap, case.declared, segments_of(case.new.logs, case.declared)
    )
    found = calibrate(measured, electric=electric, cross_validate=False)
    assert case.other is not None
    for place in (case.test, case.other):
        rows, *_ = residuals_on(physics, place.site.heightmap, case.declared, segments_of(place.logs, case.declared))
        said = found.fitted.states(rows, elsewhere=place is case.other)["after_planner"][rows.moving]
        energy = rows.measured[rows.moving]
        out.append((said.sum() / energy.sum() - 1.0, np.abs(said - energy).sum() / energy.sum()))
    return out


def routes_of_calibration(case: Case) -> list[Judged]:
    """Routes of further runs, with the odds that a calibration of `physics` gives."""
    physics, out = PhysicsPredictor(), []
    given = case.new.site.heightmap, case.declared, segments_of(case.new.logs, case.declared)
    measured, electric, std = residuals_on(physics, *given)
    found = calibrate(measured, electric=electric)
    spread = correction_of(found, std).spread
    assert spread is not None
    assert case.other is not None
    for place in (case.test, case.other):
        ground = place.site.heightmap, case.declared, segments_of(place.logs, case.declared)
        rows, _, own = residuals_on(physics, *ground)
        said = found.states(rows, elsewhere=place is case.other)["proposed"]
        held = Held(*(column[rows.moving] for column in (rows.measured, said, own, rows.run, rows.run)))
        out.append(judged("simulated", spread, held, shortest=20, longest=100, cuts=2))
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.sums", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--length", type=float, default=150.0)
    parser.add_argument("--what", default="train,calibrate")
    parser.add_argument("--odds", action="store_true", help="are the odds of a calibration right, in place of sums?")
    options = parser.parse_args(arguments)
    if options.odds:
        cases = (
            case_of(k, options.first_seed + k, runs=options.runs, length_m=options.length)[1]
            for k in range(options.cases)
        )
        found = scores([routes for case in cases for routes in routes_of_calibration(case)])
        print(", ".join(f"{key}: {value}" for key, value in found.items()))
        return
    print("| noise | model | sum, same site | other | error per metre, same | other |\n|---|---|---|---|---|---|")
    kinds = {"train": errors_of_training, "calibrate": errors_of_calibration}
    every: dict[str, list[float]] = {}
    for number in range(options.cases):
        name, case = case_of(number, options.first_seed + number, runs=options.runs, length_m=options.length)
        for what in options.what.split(","):
            bias_and_error = kinds[what](case)
            every.setdefault(what, []).append([value for pair in zip(*bias_and_error, strict=True) for value in pair])
            cells = [f"{value:+.2%}" for value in every[what][-1]]
            print(f"| {name} | {what} | {' | '.join(cells)} |", flush=True)
    for what, rows in every.items():
        print(
            f"| mean of {len(rows)} | {what} | " + " | ".join(f"{value:+.2%}" for value in np.mean(rows, axis=0)) + " |"
        )


if __name__ == "__main__":
    main()
