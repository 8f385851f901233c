"""Steps on noisy surveys: `python -m tests.bench.survey_steps --sites 16`.

Prints by side of a cell and noise: of square metres of simulated ground, how many have a step by the survey and not on
the true ground, and the other way round. A straight kerb of 1.5 wheel radii lies on the line between two cells, or in
the middle of one: printed is in how many of the square metres that it crosses it is found, without noise and where the
noise is a tenth and a fifth of it.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from joulemap.model.field.sites import random_site
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.training.simulated_set import smooth_site
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.limits import ground_limits

ROBOT = Robot()
NOISES_M = (0.0, 0.01, 0.03, 0.05, 0.1)
CELLS_M = (0.1, 0.2, 0.25)
SHARES = (0.0, 0.1, 0.2)
KERB_M = 1.5 * ROBOT.wheel_radius_m
SIDE_M = 40.0


def stepped(ground: Heightmap, cells: GridFrame) -> NDArray[np.bool_]:
    """Which cells have a step in their square metre, but for those at the edge."""
    _, _, blocked, _, beside = ground_limits(ground, cells, ROBOT)
    return (beside | (blocked == Blocked.STEP))[1:-1, 1:-1]


def grounds(sites: int, seed: int) -> dict[tuple[float, float], tuple[float, float, float]]:
    """(cells, noise) -> shares of the square metres: steps on the true ground, invented ones, missed ones."""
    found: dict[tuple[float, float], list[tuple[float, float, float]]] = {}
    for number in range(sites):
        rng = np.random.default_rng([seed, number])
        site = smooth_site(rng) if number % 4 == 0 else random_site(rng, max_slope_deg=20.0)
        cells = site.terrain.frame.respaced(1.0)
        truth = stepped(site.terrain, cells)
        for cells_m in CELLS_M:
            for noise_m in NOISES_M:
                said = stepped(degrade(site.terrain, SurveyQuality(cells_m, noise_m), rng=rng).without_noise, cells)
                parts = found.setdefault((cells_m, noise_m), [])
                parts.append((truth.mean(), (said & ~truth).mean(), (truth & ~said).mean()))
    return {key: tuple(np.mean(parts, axis=0)) for key, parts in found.items()}  # type: ignore[misc]


def kerb(cells_m: float, inside: float, share: float, rng: np.random.Generator) -> float:
    """Share of the square metres from x = 20 m on in which a kerb is found that lies in the column of cells there.

    inside : where in that column, as a share of a cell. share : standard deviation of the noise over the kerb's height.
    """
    count = round(SIDE_M / cells_m)
    x = (np.arange(count) + 0.5) * cells_m
    column = round(20.25 / cells_m)
    heights = KERB_M * np.clip(np.arange(count) + 1.0 - column - inside, 0.0, 1.0) + np.sin(x / 9.0)[:, None]
    heights += share * KERB_M * rng.standard_normal(heights.shape)
    survey = Heightmap(heights.astype(np.float32), GridFrame(0.0, SIDE_M, cells_m, count, count))
    return float(stepped(survey.without_noise, survey.frame.respaced(1.0))[:, 19].mean())


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    print("square metres with a step on the true ground / invented / missed [% of all]")
    for (cells_m, noise_m), shares in grounds(given.sites, given.seed).items():
        print(f"{cells_m:4g} m cells, {1000 * noise_m:4.0f} mm", *(f"{100 * share:5.1f}" for share in shares))
    rng = np.random.default_rng(given.seed)
    print(f"kerb of {KERB_M:.2f} m found, on the line between cells / in the middle of one [% of the square metres]")
    for cells_m in CELLS_M:
        for share in SHARES:
            seen = [np.mean([kerb(cells_m, inside, share, rng) for _ in range(3)]) for inside in (0.0, 0.5)]
            print(f"{cells_m:4g} m cells, noise {share:g} of the kerb", *(f"{100 * part:5.1f}" for part in seen))


if __name__ == "__main__":
    main()
