"""What six runs make of a noisy survey, beside the exact law of the simulator refitted on the same map.

`python -m tests.bench.survey_training --sites 2` prints, by side of a cell and noise, the mean error per metre over the
mean energy, and the sum of the predicted over that of the measured energies, on straight metres of further runs of the
same site: of the network after training on six runs, of the simulator's own equations on the surveyed heights, of the
shipped network, and of equation 5. A share and an offset of the exact law, and the friction of equation 5, are fitted
to the six runs. Of the exact law the better one of the survey as it is and of the survey without its noise counts.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from joulemap.model.energy.examples import MAX_TURN_RAD
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.prediction import predict_segments
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS, load_predictor
from joulemap.model.field.drives import Drive, drive_along, random_waypoints
from joulemap.model.field.logger import log_trace
from joulemap.model.field.robot_dynamics import FieldRobot
from joulemap.model.field.simulation import simulate_trace
from joulemap.model.field.sites import Site, random_site
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.reader import read_run
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.training.simulated_set import level_ground, rolling_resistance_on
from tests.paper.fieldwork import explained_j
from tests.reference.one_site import train_on_runs

FloatArray = NDArray[np.float64]

NOISES_M = (0.01, 0.03, 0.05, 0.1)
CELLS_M = (0.1, 0.25, 1.0)
RUNS, FURTHER, WAYPOINTS = 6, 3, 10
METHODS = ("trained", "exact law", "default", "equation 5")


@dataclass(frozen=True, eq=False)
class Driven:
    """A logged drive and its straight metres."""

    file: Path
    drive: Drive
    segments: Segments


def driven_on(site: Site, truth: FieldRobot, folder: Path, rng: np.random.Generator) -> list[Driven]:
    """Drive and log all runs."""
    found = []
    for number in range(RUNS + FURTHER):
        drive = drive_along(
            random_waypoints(site.drivable, WAYPOINTS, rng), speed_mps=truth.declared.speed_mps, rng=rng
        )
        file = log_trace(simulate_trace(site, truth, drive, rng=rng), truth, rng=rng).write_csv(
            folder / f"{number}.csv"
        )
        segments = cut_segments(read_run(file))
        found.append(Driven(file, drive, segments.take(segments.turned_abs_rad < MAX_TURN_RAD)))
    return found


def by_the_law(site: Site, truth: FieldRobot, surface: Heightmap, runs: list[Driven]) -> list[FloatArray]:
    """Energy of the metres of each run [J], by the equations and the parameters of the simulator on other heights."""
    frame = site.terrain.frame
    x, y = frame.centres()
    heights = surface.sample(*np.meshgrid(x, y)).astype(np.float32)
    there = replace(site, terrain=Heightmap(heights, frame), mu_factor=site.mu_factor_explained)
    rng = np.random.default_rng(0)  # moves only what is not explained
    return [explained_j(simulate_trace(there, truth, run.drive, rng=rng), run.segments, 0.0) for run in runs]


def refitted(said: list[FloatArray], runs: list[Driven]) -> FloatArray:
    """Energy of the further runs [J]: a share and an offset per metre are fitted to the others by least squares."""
    columns = [np.stack([energy, run.segments.driven_m], axis=1) for energy, run in zip(said, runs, strict=True)]
    fitted = np.linalg.lstsq(
        np.concatenate(columns[:RUNS]), np.concatenate([run.segments.energy_j for run in runs[:RUNS]]), rcond=None
    )[0]
    return np.concatenate(columns[RUNS:]) @ fitted


def with_fitted_friction(ground: Heightmap, robot: Robot, runs: list[Driven]) -> FloatArray:
    """Energy of the further runs by equation 5 [J], with the friction of least squared error on the others."""

    def _said(friction: float, some: list[Driven]) -> FloatArray:
        rolling = replace(robot, rolling_resistance=friction)
        parts = [predict_segments(PhysicsPredictor(), ground, rolling, run.segments).energy_j for run in some]
        return np.concatenate(parts)

    energy = np.concatenate([run.segments.energy_j for run in runs[:RUNS]])
    squares = lambda friction: float(np.nansum((_said(friction, runs[:RUNS]) - energy) ** 2))  # noqa: E731
    return _said(minimize_scalar(squares, bounds=(0.005, 1.0), method="bounded").x, runs[RUNS:])


def measure(
    number: int, seed: int, folder: Path, cells: Sequence[float]
) -> dict[tuple[float, float, str], tuple[float, float, float]]:
    """(cells, noise, method) -> sums of the absolute errors, of the predicted and of the measured energies [J]."""
    rng = np.random.default_rng([seed, number])
    site = random_site(rng, max_slope_deg=20.0)
    declared = replace(Robot(), regeneration=0.0)
    truth = FieldRobot.drawn(declared, rng)
    resistance = rolling_resistance_on(level_ground(site.ground, rng), site.ground, truth)
    declared = replace(declared, rolling_resistance=resistance)
    truth = replace(truth, declared=declared)
    runs = driven_on(site, truth, folder, rng)
    measured = np.concatenate([run.segments.energy_j for run in runs[RUNS:]])
    found = {}
    for cells_m in cells:
        for noise_m in NOISES_M:
            rng = np.random.default_rng([seed, number, round(1000 * cells_m), round(1000 * noise_m)])
            survey = degrade(site.terrain, SurveyQuality(cells_m, noise_m=noise_m), rng=rng)
            ground = survey.without_noise
            out = folder / f"{cells_m}_{noise_m}"
            train_on_runs(
                survey, declared, [run.file for run in runs[:RUNS]], out=out, start_from=Path(str(SHIPPED_WEIGHTS))
            )
            said = {
                name: np.concatenate([predict_segments(model, ground, declared, run.segments).energy_j for run in some])
                for name, model, some in (
                    ("trained", load_predictor(out), runs[RUNS:]),
                    ("default", load_predictor("default"), runs[RUNS:]),
                )
            }
            said["equation 5"] = with_fitted_friction(ground, declared, runs)
            laws = [refitted(by_the_law(site, truth, surface, runs), runs) for surface in (survey, ground)]
            known = np.isfinite(said["trained"]) & np.isfinite(said["equation 5"])
            said["exact law"] = min(laws, key=lambda law: float(np.abs(law - measured)[known].sum()))
            for name, energy in said.items():
                error = float(np.abs(energy - measured)[known].sum())
                found[cells_m, noise_m, name] = error, float(energy[known].sum()), float(measured[known].sum())
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cells", type=float, nargs="+", default=CELLS_M, help="sides of a cell [m]")
    given = parser.parse_args()
    parts = []
    for number in range(given.sites):
        with tempfile.TemporaryDirectory() as folder:
            parts.append(measure(number, given.seed, Path(folder), given.cells))
    print(f"{'':22s}", *(f"{name:>14s}" for name in METHODS), "trained / exact law")
    for cells_m in given.cells:
        for noise_m in NOISES_M:
            row, share = [], {}
            for name in METHODS:
                error, said, energy = np.sum([part[cells_m, noise_m, name] for part in parts], axis=0)
                share[name] = error / energy
                row.append(f"{100 * share[name]:6.1f} % {said / energy:5.3f}")
            print(
                f"{cells_m:4g} m cells, {1000 * noise_m:4.0f} mm",
                *row,
                f"{share['trained'] / share['exact law']:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
