"""What random slopes of runs do to the cost of a radian, with known truth: `python -m tests.loop.slopes`.

Twelve runs, levels that differ, fits by statsmodels. Why calibration has levels of runs and no slopes is in
docs/explanation/calibration.md.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from statsmodels.regression.mixed_linear_model import MixedLM

FloatArray = NDArray[np.float64]
RUNS, ROWS, TRUE_J = 12, 120, 30.0
RUN = np.repeat(np.arange(RUNS), ROWS)
_FIVE_PER_CENT = 5.14  # of a half-and-half mixture of chi-squared with 1 and 2 degrees of freedom


def drawn(
    rng: np.random.Generator, *, by_ground: bool = False, spread_j: float = 0.0, memory: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Columns (n, 2), of going on and of the turned angle, and energies (n,) [J]. Curves are ten rows long.

    by_ground : every second run is on ice, where a radian takes 2 J. spread_j : standard deviation of runs. memory :
    correlation of noise from row to row.
    """
    turning = rng.random(len(RUN) // 10) < 0.4
    turned = np.repeat(np.abs(rng.normal(0.0, 0.6, len(turning))) * turning, 10)
    noise = rng.standard_normal(len(RUN))
    for i in np.flatnonzero(np.diff(RUN, prepend=-1) == 0):
        noise[i] = memory * noise[i - 1] + np.sqrt(1.0 - memory**2) * noise[i]
    slope = TRUE_J - 28.0 * (float(by_ground) * (RUN % 2 == 0)) + spread_j * rng.standard_normal(RUNS)[RUN]
    straight = 100.0 * (1.0 + 0.05 * rng.standard_normal(RUNS))[RUN]
    return np.column_stack([np.ones(len(RUN)), turned]), straight + slope * turned + 2.0 * noise


def fitted(x: FloatArray, energy: FloatArray, *, slopes: bool, prior_rows: float = 0.0) -> tuple[float, float]:
    """Cost of a radian [J], and twice the restricted log likelihood.

    slopes : random ones beside the levels. prior_rows : rows of these data that a prior of nothing is worth.
    """
    z = x[:, : 1 + slopes]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a variance at its border
        found = MixedLM(energy, x, RUN, exog_re=z).fit(reml=True)
    normal, target = np.diag([0.0, prior_rows * np.mean(x[:, 1] ** 2) / found.scale]), np.zeros(2)
    for run in range(RUNS):
        mine = run == RUN
        inverse = np.linalg.inv(found.scale * np.eye(ROWS) + z[mine] @ np.asarray(found.cov_re) @ z[mine].T)
        normal += x[mine].T @ inverse @ x[mine]
        target += x[mine].T @ inverse @ energy[mine]
    return float(np.linalg.solve(normal, target)[1]), 2.0 * float(found.llf)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.slopes", description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=40)
    sets = range(parser.parse_args(arguments).sets)
    print("| 30 J/rad | levels | levels and slopes | the same, with a prior of one row | slopes 'vary' at 5 % |")
    print("| --- | --- | --- | --- | --- |")
    cases: dict[str, dict[str, Any]] = {
        "in all runs": {},
        "in all runs, noise correlated by 0.5": {"memory": 0.5},
        "in all runs, noise correlated by 0.9": {"memory": 0.9},
        "in the mean of runs that differ by 14": {"spread_j": 14.0},
        "on loam, 2 on ice": {"by_ground": True},
    }
    for words, given in cases.items():
        rows = []
        for seed in sets:
            x, energy = drawn(np.random.default_rng(seed), **given)
            (level, before), (free, after) = (fitted(x, energy, slopes=slopes) for slopes in (False, True))
            prior = fitted(x, energy, slopes=True, prior_rows=1.0)[0]
            rows.append((level, free, prior, after - before > _FIVE_PER_CENT))
        *costs, found = np.mean(rows, axis=0)
        print(f"| {words} | {' | '.join(f'{cost:.1f}' for cost in costs)} | {found:.0%} |", flush=True)


if __name__ == "__main__":
    main()
