"""What survey noise does to energies and limits: simulated grounds, driven, and priced on surveys of every quality.

`python -m tests.bench.survey_noise --sites 40` prints, by side of a cell and noise, the sum of predicted energies over
that of driven ones, and the mean error per metre (`survey_steps` has the steps).
With `--routes` it prints what the routes that are found on such surveys cost on the ground without noise, by the same
model: beside their own energies (a search finds what noise makes cheap), and beside the best routes there.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from joulemap.model.energy.examples import MAX_TURN_RAD
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import BlockedError
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import simulate_segments
from joulemap.model.field.sites import random_site
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.training.simulated_set import level_ground, rolling_resistance_on, smooth_site
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.lattice.survey_error import with_survey_error
from joulemap.planner.route import price_route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.verdict.energy_distribution import EnergyOdds
from tests.bench.maps import terrain

NOISES_M = (0.0, 0.01, 0.03, 0.05, 0.1, 0.15)
CELLS_M = (0.1, 0.25, 0.5, 1.0)
MODELS = ("physics", "default")


def drawn_noise(
    shape: tuple[int, int], resolution_m: float, correlation_m: float, rng: np.random.Generator
) -> np.ndarray:
    """Noise of unit standard deviation, white or with a Gaussian correlation of that length."""
    noise = rng.standard_normal(shape)
    if correlation_m > 0.0:
        noise = gaussian_filter(noise, correlation_m / resolution_m / np.sqrt(2.0), mode="wrap")
        noise /= noise.std()
    return noise


def measure(sites: int, *, correlation_m: float, given: bool, as_surveyed: bool, seed: int) -> dict[tuple, list]:
    """(model, cells, noise) -> per site: sum of predicted and of driven energies, error per metre."""
    predictors = {name: load_predictor(name) for name in MODELS}
    found = defaultdict(list)
    for number in range(sites):
        rng = np.random.default_rng([seed, number])
        site = smooth_site(rng) if number % 4 == 0 else random_site(rng, max_slope_deg=20.0)
        declared = replace(Robot(), regeneration=0.0)
        truth = FieldRobot.drawn(declared, rng)
        resistance = rolling_resistance_on(level_ground(site.ground, rng), site.ground, truth)
        declared = replace(declared, rolling_resistance=resistance)
        truth = replace(truth, declared=declared)
        drive = drive_along(random_waypoints(site.drivable, 12, rng), speed_mps=declared.speed_mps, rng=rng)
        driven = simulate_segments(site, truth, drive, rng=rng)
        straight = np.abs(driven.heading_change_rad) < MAX_TURN_RAD
        places = driven.x[straight], driven.y[straight], driven.heading_rad[straight]
        for cells_m in CELLS_M:
            clean = degrade(site.terrain, SurveyQuality(cells_m), rng=rng)
            unit = drawn_noise(clean.frame.shape, cells_m, correlation_m, rng)
            for noise_m in NOISES_M:
                heights = (clean.heights + noise_m * unit).astype(np.float32)
                known = {"given_noise_m": noise_m, "given_noise_length_m": correlation_m} if given else {}
                survey = Heightmap(heights, clean.frame, **known)
                ground = survey if as_surveyed else survey.without_noise
                for name, predictor in predictors.items():
                    traction, std = predictor.segment_traction_and_std(ground, declared, *places)
                    said = np.maximum(traction, 0.0) + declared.hotel_per_m
                    known = np.isfinite(said)
                    energy = driven.energy_j[straight][known]
                    error = np.abs(said[known] - energy) / energy
                    inside = (
                        np.nan if std is None else _inside(survey, declared, predictor, said[known], std[known], energy)
                    )
                    found[name, cells_m, noise_m].append((said[known].sum(), energy.sum(), error.mean(), inside))
    return found


def _inside(survey, robot, predictor, said_j, std_j, energy_j) -> bool:
    """Whether a drive's energy lies inside the interval of 90 %."""
    model, _ = with_survey_error({"spread": predictor.spread.as_dict()}, survey, robot, predictor)
    spread = Spread.from_dict(model["spread"])
    scale_j, freedom = spread.along(said_j, std_j)
    odds = EnergyOdds(np.cumsum(said_j), scale_j, freedom, spread.bias, spread.skew)
    return bool(odds.quantile(0.05)[-1] <= energy_j.sum() <= odds.quantile(0.95)[-1])


def routes(sites: int, *, correlation_m: float, as_surveyed: bool, seed: int) -> None:
    """Print energies of chosen routes over what they cost on the true ground, and that over the best there."""
    robot = Robot(max_grade_deg=35.0, max_cross_slope_deg=35.0)
    print(
        "predicted over true energy of the chosen routes / true energy over that of the best ones / routes that may "
        "not be driven on the true ground"
    )
    found = defaultdict(list)
    for number in range(sites):
        rng = np.random.default_rng([seed, number])
        site = smooth_site(rng) if number % 4 == 0 else random_site(rng, max_slope_deg=20.0)
        ends = rng.uniform(4.0, 26.0, (3, 2, 2))
        for cells_m in (0.25, 1.0):
            clean = degrade(site.terrain, SurveyQuality(cells_m), rng=rng)
            unit = drawn_noise(clean.frame.shape, cells_m, correlation_m, rng)
            for name in MODELS:
                model = load_predictor(name)
                truth = _open(build_lattice(replace(clean, given_noise_m=0.0), robot, model))
                best = [RoutePlanner(truth).plan(tuple(a), tuple(b)).route.energy_j for a, b in ends]
                for noise_m in NOISES_M[1:]:
                    heights = (clean.heights + noise_m * unit).astype(np.float32)
                    survey = Heightmap(heights, clean.frame, given_noise_m=0.0 if as_surveyed else None)
                    planner = RoutePlanner(_open(build_lattice(survey, robot, model)))
                    for (a, b), least in zip(ends, best, strict=True):
                        chosen = planner.plan(tuple(a), tuple(b)).route
                        try:
                            driven = price_route(truth, chosen.points[:, :2]).energy_j
                        except BlockedError:  # the true ground is steeper there than the robot may drive
                            found[name, cells_m, noise_m].append((0.0, 0.0, 0.0))
                        else:
                            found[name, cells_m, noise_m].append((chosen.energy_j, driven, least))
    for name in MODELS:
        for cells_m in (0.25, 1.0):
            row = []
            for noise_m in NOISES_M[1:]:
                energies = np.array(found[name, cells_m, noise_m])
                (said, driven, least), blocked = energies.sum(axis=0), (energies[:, 1] == 0.0).sum()
                row.append(f"{1000 * noise_m:4.0f} mm {said / driven:5.3f} {driven / least:5.3f} {blocked:2d}")
            print(f"{name:10s} {cells_m:4g} m cells", *row, sep="   ")


def times() -> None:
    """Print how much longer a lattice takes where noise is estimated and taken out, in time of the processor."""
    clean = terrain(300, 0.25)
    noise = 0.05 * np.random.default_rng(0).standard_normal(clean.frame.shape)
    noisy = (clean.heights + noise).astype(np.float32)
    surveys = {
        "noise given as none": (clean.heights, 0.0),
        "no noise, estimated": (clean.heights, None),
        "50 mm, estimated and taken out": (noisy, None),
    }
    for name in MODELS:
        model, found = load_predictor(name), []
        for words, (heights, noise_m) in surveys.items():
            took = []
            for _ in range(3):
                survey = Heightmap(heights, clean.frame, given_noise_m=noise_m)
                began = time.process_time()
                build_lattice(survey, Robot(), model)
                took.append(time.process_time() - began)
            found.append((words, min(took)))
        ratios = ", ".join(f"{words}: {took / found[0][1]:.2f}" for words, took in found)
        print(f"{name:10s} lattice of 300 x 300 cells: {ratios}", flush=True)


def _open(lattice: CostLattice) -> CostLattice:
    """The same prices without steps, so that every route exists on every survey."""
    closed = np.isin(lattice.blocked, [Blocked.STEP, Blocked.OBSTACLE])
    return replace(lattice, blocked=np.where(closed, Blocked.FREE, lattice.blocked), obstacles=None)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sites", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--correlation", type=float, default=0.0, help="length over which noise is alike [m]")
    parser.add_argument("--given", action="store_true", help="give noise and length instead of letting it be estimated")
    parser.add_argument("--as-surveyed", action="store_true", help="price the surveys as they are")
    parser.add_argument("--routes", action="store_true", help="what the routes that are found cost on the true ground")
    parser.add_argument(
        "--times", action="store_true", help="how much longer a lattice takes that has its noise taken out"
    )
    given = parser.parse_args()
    if given.times:
        times()
        return
    if given.routes:
        routes(given.sites, correlation_m=given.correlation, as_surveyed=given.as_surveyed, seed=given.seed)
        return
    found = measure(
        given.sites,
        correlation_m=given.correlation,
        given=given.given,
        as_surveyed=given.as_surveyed,
        seed=given.seed,
    )
    print("predicted over driven sum / mean error per metre [%] / drives inside the interval of 90 % [%]")
    print(f"{'':22s}", *(f"{1000 * noise_m:11.0f} mm" for noise_m in NOISES_M))
    for name in MODELS:
        for cells_m in CELLS_M:
            row = []
            for noise_m in NOISES_M:
                said, energy, error, inside = np.array(found[name, cells_m, noise_m], dtype=float).T
                ratio = np.mean(said / energy)
                row.append(f"{ratio:6.3f} {100 * error.mean():4.1f} {100 * inside.mean():3.0f}")
            print(f"{name:10s} {cells_m:4g} m cells", *row)


if __name__ == "__main__":
    main()
