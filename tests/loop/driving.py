"""Forecasts while driving: `python -m tests.loop.driving [simulated|real|fit|speed] ...`.

`simulated`: drives of the shipped network on sites that it never saw, with a hidden change: more rolling resistance
from the start, a payload from half way on, a cold battery, none. `real`: drives of real robots, each with a model that
had no part of it, beside three rivals. `fit`: the factors of `drive_prior.UNFITTED`. `speed`: updates with forecast a
second.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.energy.uncertainty import Spread, fit_spread
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.simulation import simulate_segments
from joulemap.model.field.sites import random_site
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.loop.drive_alarms import Cusum, threshold_of
from joulemap.model.loop.drive_filter import Ahead, DriveFilter, DrivePrior, limited
from joulemap.model.loop.drive_prior import (
    cause_columns,
    change_std,
    columns_of_rows,
    fit_drive_prior,
    prior_of_spread,
    unfitted,
)
from joulemap.model.runs.describe import planned_features
from joulemap.model.training.simulated_set import MAX_SLOPE_DEG, level_ground
from joulemap.service.loop.measured import measure
from tests.coverage.real import real_folder
from tests.coverage.simulated import _robot
from tests.loop.rivals import REAL

FloatArray = NDArray[np.float64]
SEED = 20261128
FIT_SEED = 7001  # other sites than those that are judged
COLD = 1.12  # energy drawn from a battery whose resistance is three times as large, at a load of 6 % of its voltage
MORE = 0.3


@dataclass(frozen=True)
class Driven:
    """Metres of a drive, with its prediction."""

    name: str
    measured: FloatArray
    columns: FloatArray
    std: FloatArray
    length: FloatArray


def simulated(count: int, seed: int) -> Iterator[dict[str, Driven]]:
    """Drives of one robot each, by hidden change, and the same metres of all."""
    network = load_predictor("default")
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        site = random_site(rng, max_slope_deg=MAX_SLOPE_DEG)
        declared, truth, here = _robot(site, level_ground(site.ground, rng), rng)
        points = random_waypoints(site.drivable, int(rng.integers(8, 26)), rng)
        drive = drive_along(points, speed_mps=declared.speed_mps, rng=rng)
        noise = int(rng.integers(2**31))
        plain, heavy = (
            simulate_segments(here, robot, drive, rng=np.random.default_rng(noise), max_driven_m=3.0)
            for robot in (truth, replace(truth, mass_kg=(1.0 + MORE) * truth.mass_kg))
        )
        places = site.survey.without_noise, declared, plain.x, plain.y, plain.heading_rad
        traction, std = network.segment_traction_and_std(*places)
        assert std is not None
        said = declared.price_per_m(traction) * plain.driven_m
        said = said + declared.turn_j_per_rad * np.abs(plain.heading_change_rad)
        rows = planned_features(*places, traction, {})
        known = np.isfinite(said) & np.isfinite(rows.grade)
        level = declared.weight_n * plain.driven_m * np.where(traction > 0.0, 1.0, declared.regeneration)
        columns = cause_columns(
            said,
            declared.rolling_resistance * level,
            level * rows.grade,
            declared.idle_power_w * plain.duration_s,
        )[known]
        measured, half = plain.energy_j[known], known.sum() // 2
        later = np.append(measured[:half], heavy.energy_j[known][half:])
        energies = {
            "none": measured,
            "30 % more rolling": measured + MORE * columns[:, 1],
            "30 % more mass half way": later,
            "cold battery": COLD * measured,
        }
        rest = std[known] * plain.driven_m[known], plain.driven_m[known]
        yield {name: Driven(name, energy, columns, *rest) for name, energy in energies.items()}


@dataclass
class Scores:
    """Of drives of one kind."""

    errors: list[tuple[float, ...]]
    after_50_m: list[tuple[float, float]]
    inside: list[list[float]]
    alarms: list[float]
    found_after: list[float]


def followed(drives: Sequence[tuple[Driven, DrivePrior]], *, change: str = "") -> Scores:
    """Follow drives, with alarms as `Tracking` raises them."""
    scores = Scores([], [], [], [], [])
    for one, prior in drives:
        known, ahead, sums = DriveFilter(prior), Ahead.of(prior, one.columns, one.std), Cusum()
        n, driven = len(one.measured), np.append(0.0, np.cumsum(one.length))
        threshold, alarms, tenths = threshold_of(float(n)), [], []
        tenth = {round(k * n / 10) for k in range(1, 10)}
        asked = {round(share * n) for share in (0.25, 0.5, 0.75)}
        for k in range(n):
            now = np.s_[k : k + 1]
            step = known.learn(one.columns[now], one.measured[now], one.std[now])
            if sums.add(float(limited(step)[0]) / prior.change_std, driven[k], threshold) is not None:
                known.widen()
                alarms.append(driven[k + 1])
            done = k + 1
            if done == n:
                break
            said, scale = ahead.energy(float(done), known)
            true, plan = one.measured[done:].sum(), one.columns[done:, 0].sum()
            if done in tenth:
                half = scale * float(stdtrit(prior.freedom or 1e9, 0.95))
                tenths.append(float(abs(true - said) <= half))
            if done in asked:
                used, planned = one.measured[:done].sum(), one.columns[:done, 0].sum()
                rivals = plan, used / driven[done] * (driven[-1] - driven[done]), used / planned * plan
                scores.errors.append(tuple(abs(energy / true - 1.0) for energy in (said, *rivals)))
            if driven[k] < 50.0 <= driven[done]:
                scores.after_50_m.append((abs(said / true - 1.0), abs(plan / true - 1.0)))
        begins = {"30 % more mass half way": driven[n // 2]}.get(change, 0.0)
        scores.alarms.append(float(bool(alarms)))
        after = [at - begins for at in alarms if at > begins]
        scores.found_after.append(after[0] if after else np.inf)
        scores.inside.append(tenths)
    return scores


def line(name: str, scores: Scores) -> str:
    """A row of the table."""
    errors = np.array(scores.errors).mean(axis=0)
    at_50 = np.median(np.array(scores.after_50_m), axis=0) if scores.after_50_m else (np.nan, np.nan)
    inside = np.array([row for row in scores.inside if len(row) == 9]).mean(axis=0)
    best = errors[0] / errors[1:].min()
    cells = [
        f"{at_50[0]:.1%} (plan {at_50[1]:.1%})",
        " ".join(f"{share:.0%}" for share in errors),
        f"{best:.2f}",
        f"{inside.min():.0%}-{inside.max():.0%}, {inside.mean():.0%}",
        f"{np.mean(scores.alarms):.0%}, median {np.median(scores.found_after):.0f} m",
    ]
    return f"| {name} | {' | '.join(cells)} |"


HEAD = (
    "| drives | error of the rest after 50 m | mean error of the rest at 25, 50, 75 %: ours, plan, range so far, scale "
    "times plan | over the best | 90 % intervals hold, by tenth | alarm in, after |\n|---|---|---|---|---|---|"
)


def show_simulated(count: int) -> None:
    """Drives of robots of which no run is known, and of robots whose other runs fitted the prior."""
    drives, spread = list(simulated(count, SEED)), load_predictor("default").spread
    print(f"{count} robots, {np.mean([len(d['none'].std) for d in drives]):.0f} m in the mean\n{HEAD}")
    for name in drives[0]:
        mine = [(d[name], unfitted(prior_of_spread(spread, d[name].columns, d[name].std))) for d in drives]
        print(line(name, followed(mine, change=name)), flush=True)


def fit(count: int) -> None:
    """Print the factors of `UNFITTED`."""
    drives = [d["none"] for d in simulated(count, FIT_SEED)]
    spread = load_predictor("default").spread
    start, found = fitted_to(drives, spread)
    sizes = [(found.causes[0], start.causes[0]), (found.passing, start.passing), (found.passing_m, start.passing_m)]
    causes, passing, length, noise = (new / old for new, old in [*sizes, (found.noise, start.noise)])
    print(f"causes {causes:.2f}, passing {passing:.2f}, passing_m {length:.2f}, noise {noise:.2f}")
    steps = (
        DriveFilter(unfitted(prior_of_spread(spread, d.columns, d.std))).learn(d.columns, d.measured, d.std)
        for d in drives
    )
    print(f"width {found.width:.2f}, change_std of drives as they are followed {change_std(steps):.2f}")


def fitted_to(drives: Sequence[Driven], spread: Spread) -> tuple[DrivePrior, DrivePrior]:
    """The prior of a spread, and what drives make of it."""
    columns, std, measured = (
        np.concatenate([getattr(d, key) for d in drives]) for key in ("columns", "std", "measured")
    )
    start = prior_of_spread(spread, columns, std)
    run = np.repeat(np.arange(len(drives)), [len(d.std) for d in drives])
    return start, fit_drive_prior(measured, columns, std, run, start)


def real(name: str, parts: int) -> list[tuple[Driven, DrivePrior]]:
    """Drives of a data set, each with the prediction of a calibration without its campaign, and with the prior that
    the other campaigns show; campaigns are left out in so many parts.
    """
    folder = real_folder()
    if folder is None:
        raise SystemExit("there are no real runs here (set JOULEMAP_REAL_DATA to their folder)")
    runs, campaigns = REAL[name](folder)
    known = sorted(set(campaigns))
    campaigns = [f"part {known.index(one) % parts}" for one in campaigns]
    measured = measure("physics", PhysicsPredictor(), runs)
    groups = campaigns if len(set(campaigns)) < len(campaigns) else None
    found, rows = calibrate(measured.residuals, electric=measured.electric, groups=groups), measured.residuals
    group = np.unique(np.asarray(campaigns), return_inverse=True)[1][rows.run]
    unit, moving = rows.features.unit_j, rows.moving
    said, energy = unit * found.held_out["proposed"], unit * rows.measured
    columns = columns_of_rows(rows.features, said)
    out = []
    for one in np.unique(group):
        others, mine = moving & (group != one), moving & (group == one)
        spread = fit_spread(energy[others], said[others], measured.std[others], rows.run[others], group=group[others])
        std = spread.factor * measured.std
        start = prior_of_spread(spread, columns[others], std[others])
        prior = fit_drive_prior(energy[others], columns[others], std[others], rows.run[others], start)
        for run in np.unique(rows.run[mine]):
            its = mine & (rows.run == run)
            driven = energy[its], columns[its], std[its], rows.features.length_m[its]
            out.append((Driven(rows.runs[run], *driven), prior))
    return out


def show_real(names: Sequence[str], parts: int) -> None:
    """Drives of real robots."""
    print(HEAD)
    for name in names:
        drives = real(name, parts)
        print(line(f"{name}, {len(drives)} drives", followed(drives)), flush=True)


def speed() -> None:
    """Updates with forecast a second on one core, and the times of 100 robots in turn."""
    import joulemap as jm

    x, y = np.meshgrid(np.arange(1000.0), np.arange(1000.0))
    ground = jm.heightmap(4.0 * np.sin(x / 60.0) * np.cos(y / 90.0), resolution_m=1.0)
    costs = jm.costmap(ground, model="physics")
    path = [(10.0, 500.0), (990.0, 520.0)]
    robots: list[Any] = [costs.drive(path) for _ in range(100)]
    route = robots[0].route

    def one(drive: Any, k: int) -> float:
        begin = time.process_time()  # of one core, whatever else runs
        drive.update(float(k), (10.0 + 0.5 * k, 500.0 + 20.0 / 980.0 * 0.5 * k), power_w=60.0)
        drive.forecast()
        return time.process_time() - begin

    first = [one(robots[0], k) for k in range(1000)]
    print(f"{route.length_m:.0f} m: {len(first) / sum(first):.0f} updates with forecast a second")
    every = [one(drive, k) for k in range(30) for drive in robots[1:]]
    print(f"99 robots in turn: {1e3 * np.quantile(every, 0.99):.2f} ms at the 99th percentile")


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.driving", description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("simulated", "real", "fit", "speed"))
    parser.add_argument("names", nargs="*", default=["drive", "cuadriga"], help=f"of {', '.join(REAL)}")
    parser.add_argument("--count", type=int, default=60, help="simulated robots")
    parser.add_argument("--parts", type=int, default=40, help="in which real campaigns are left out")
    options = parser.parse_args(arguments)
    if options.what == "real":
        show_real(options.names, options.parts)
    elif options.what == "speed":
        speed()
    else:
        {"simulated": show_simulated, "fit": fit}[options.what](options.count)


if __name__ == "__main__":
    main()
