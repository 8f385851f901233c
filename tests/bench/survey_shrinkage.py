"""How far the shipped network's answers should be shrunk to equation 5: `python -m tests.bench.survey_shrinkage`.

Prints by side of a cell and noise: the share of what the network adds to equation 5 that fits the driven energies of
some grounds best (least squares, relative to the prediction), its standard error (jackknife over grounds), and, over
other grounds, the sum of the predicted over the driven energy and the mean error, as the network says it and with that
share.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.examples import MAX_TURN_RAD
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.robot_dynamics import FieldRobot
from joulemap.model.field.simulation import simulate_segments
from joulemap.model.field.sites import random_site
from joulemap.model.robot import Robot
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.training.simulated_set import level_ground, rolling_resistance_on, smooth_site

Driven = NDArray[np.float64]
"""Energy [J] of segments as driven, by equation 5, and by the network, (3, n)."""

NOISES_M, CELLS_M = (0.01, 0.03, 0.05, 0.1), (0.1, 0.25, 1.0)
WAYPOINTS = 24
LEAST_J = 20.0  # of a metre, that errors are relative to: a usual robot's idle power takes as much


def driven(seed: int, sites: int) -> dict[tuple[float, float], list[Driven]]:
    """(cells, noise) -> per ground, its straight segments."""
    models = load_predictor("physics"), load_predictor("default")
    found: dict[tuple[float, float], list[Driven]] = {}
    for number in range(sites):
        rng = np.random.default_rng([seed, number])
        site = random_site(rng, max_slope_deg=20.0) if number % 4 else smooth_site(rng)
        declared = replace(Robot(), regeneration=0.0)
        truth = FieldRobot.drawn(declared, rng)
        resistance = rolling_resistance_on(level_ground(site.ground, rng), site.ground, truth)
        declared = replace(declared, rolling_resistance=resistance)
        drive = drive_along(random_waypoints(site.drivable, WAYPOINTS, rng), speed_mps=declared.speed_mps, rng=rng)
        segments = simulate_segments(site, replace(truth, declared=declared), drive, rng=rng)
        straight = np.abs(segments.heading_change_rad) < MAX_TURN_RAD
        places = segments.x[straight], segments.y[straight], segments.heading_rad[straight]
        for cells_m in CELLS_M:
            for noise_m in NOISES_M:
                ground = degrade(site.terrain, SurveyQuality(cells_m, noise_m=noise_m), rng=rng).without_noise
                said = [declared.price_per_m(model.segment_traction(ground, declared, *places)) for model in models]
                rows = np.stack([segments.energy_j[straight], *said])
                found.setdefault((cells_m, noise_m), []).append(rows[:, np.isfinite(rows).all(axis=0)])
    return found


def best_share(grounds: list[Driven]) -> tuple[float, float]:
    """The share of what the network adds, and its standard error."""
    sums = []
    for energy, physics, network in grounds:
        weight, added = 1.0 / np.maximum(network, LEAST_J) ** 2, network - physics
        sums.append((weight @ (added * (energy - physics)), weight @ added**2))
    over, under = np.array(sums).T
    without = (over.sum() - over) / (under.sum() - under)
    return over.sum() / under.sum(), float(np.sqrt((len(sums) - 1) * np.var(without)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, nargs=2, default=(48, 24), help="grounds to fit the share to, and others")
    parser.add_argument("--seeds", type=int, nargs=2, default=(71, 5))
    given = parser.parse_args()
    fitted, others = (driven(seed, sites) for seed, sites in zip(given.seeds, given.sites, strict=True))
    print(f"{'':24s} share           sum: network, shrunk   error: network, shrunk [%]")
    for (cells_m, noise_m), grounds in fitted.items():
        share, error = best_share(grounds)
        row = []
        for used in (1.0, share):
            said = [(e, p + used * (q - p)) for e, p, q in others[cells_m, noise_m]]
            row.append([np.mean([[q.sum() / e.sum(), 100.0 * np.abs(q - e).sum() / e.sum()] for e, q in said], axis=0)])
        (sums, errors) = np.array(row)[:, 0].T
        print(
            f"{cells_m:4g} m cells, {1000 * noise_m:4.0f} mm   {share:.2f} +- {error:.2f}    "
            f"{sums[0]:.3f} {sums[1]:.3f}            {errors[0]:5.1f} {errors[1]:5.1f}"
        )


if __name__ == "__main__":
    main()
