"""The shipped network: many simulated robots on many simulated grounds, and the network trained on them.

The only module that joins the simulated field (which knows no model) to the models (which know no field).
"""

from __future__ import annotations

import datetime as dt
import math
import os
import platform
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.energy.artifact import Artifact, save_artifact
from joulemap.model.energy.examples import Examples, concatenate, cut_examples
from joulemap.model.energy.physics import eq5_traction_per_m, fit_rolling_resistance
from joulemap.model.energy.tensors import predicted
from joulemap.model.energy.uncertainty import fit_spread
from joulemap.model.errors import InputError
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.robot_dynamics import FieldRobot, Ground
from joulemap.model.field.simulation import simulate_segments, simulate_trace
from joulemap.model.field.sites import TRUE_RESOLUTION_M, Relief, Site, make_site, random_ground, random_site
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.synthesis import TerrainRecipe
from joulemap.model.training.evaluation import coverage, errors
from joulemap.model.training.model_card import model_card
from joulemap.model.training.optimisation import TrainingOptions, train_network

ROBOTS_PER_SITE = 3
WAYPOINTS = 12
MAX_TURN_RAD = 0.25
"""Segments that turn by more are left out: turning is priced apart (`turn_j_per_rad`)."""
MU_RANGE = (0.03, 0.25)
"""Declared rolling resistances that are learned."""
MAX_SLOPE_DEG = 30.0
"""Slopes of the sites reach up to this."""
_SITE_M = 30.0
_SMOOTH_SHARE = 0.2
_DECLARED_SPREAD = 0.08  # how well an owner knows the rolling resistance (standard deviation of its logarithm)


PRETRAINING = TrainingOptions(
    epochs=14, patience=14, batch=512, learning_rate=2e-3, weight_decay=0.05, feature_jitter=0.1
)
DEFAULT_SITES = 2000
DEFAULT_SEED = 20261121
"""The shipped network's seed and number of sites."""
CARD_FILE = "MODEL_CARD.md"
_ASIDE = 0.08  # of the sites to stop by, and as many again to report errors on


def train_default(
    out: str | Path,
    *,
    seed: int = DEFAULT_SEED,
    sites: int = DEFAULT_SITES,
    workers: int = 2,
    options: TrainingOptions = PRETRAINING,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Simulate `sites` sites, train the compact network on them and write its folder `out`.

    Returns what its config.json says of the training, JSON-able, with `version`. `held_out` are the errors on sites and
    robots that neither training nor stopping saw, on segments without regeneration; `baselines` those of eq. 5 on the
    same segments, with the declared rolling resistance and with the one fitted to each very run (which no one could
    have known before driving it). The same seed gives the same weights.
    """
    report = progress or (lambda _: None)
    examples = make_pretraining_set(sites=sites, seed=seed, workers=workers, progress=lambda p: report(0.4 * p))
    site = examples.run // ROBOTS_PER_SITE
    order = np.random.default_rng([seed, sites]).permutation(np.unique(site))
    count = max(1, round(_ASIDE * order.size))
    test = np.isin(site, order[:count])
    stop = np.unique(examples.run[np.isin(site, order[count : 2 * count])])
    result = train_network(
        examples.select(~test),
        seed=seed,
        held_out_runs=stop.tolist(),
        options=options,
        progress=lambda p: report(0.4 + 0.6 * p),
    )
    judged = examples.select(test & (examples.regeneration == 0.0))
    energy, std = predicted(result.net, judged)
    spread = fit_spread(judged.energy_j, energy, std, judged.run)
    training: dict[str, Any] = {
        "data": "simulated sites and robots (service.pretraining)",
        "command": f"joulemap train --seed {seed} --out DIR",
        "seed": seed,
        "sites": sites,
        "robots": sites * ROBOTS_PER_SITE,
        "segments": len(examples),
        "data_hash": examples.data_hash,
        "options": asdict(options),
        "epochs": result.epochs,
        "held_out_sites": count,
        "held_out": _summary(energy, judged),
        "coverage": coverage(judged.energy_j, energy, spread.factor * std, spread),
        "made": f"{dt.datetime.now(dt.UTC):%Y-%m-%d} on {os.cpu_count()} cores ({platform.machine()})",
        "baselines": baselines(judged),
    }
    domain = replace(examples.domain(), max_slope_deg=MAX_SLOPE_DEG)
    version = save_artifact(out, Artifact(result.net, domain, spread=spread, training=training))
    parameters = sum(p.numel() for p in result.net.parameters())
    (Path(out) / CARD_FILE).write_text(model_card(version, parameters, training, domain, spread), encoding="utf-8")
    return {**training, "version": version}


def baselines(examples: Examples) -> dict[str, dict[str, Any]]:
    """Errors of eq. 5 with the declared rolling resistance, and with the one that fits each run best."""
    fitted = examples.rolling_resistance.astype(np.float64)
    for run in np.unique(examples.run):
        mine = examples.run == run
        traction = (examples.energy_j - examples.hotel_per_m)[mine]
        driven = traction > 0.0  # braking says nothing of the resistance
        weight = float(examples.weight_n[mine][0])
        fitted[mine] = fit_rolling_resistance(traction[driven], examples.tan_grade[mine][driven], weight_n=weight)
    found = {}
    for name, mu in (("physics_declared", examples.rolling_resistance), ("physics_fitted_to_each_run", fitted)):
        traction = eq5_traction_per_m(examples.weight_n, mu, examples.tan_grade)
        found[name] = _summary(examples.hotel_per_m + np.maximum(traction, 0.0), examples)
    return found


def _summary(energy_j: ArrayLike, examples: Examples) -> dict[str, Any]:
    """`errors` without the list of every run."""
    found = errors(energy_j, examples.energy_j, examples.run)
    del found["route_relative_errors"]
    return {key: value if isinstance(value, int) else round(value, 5) for key, value in found.items()}


def make_pretraining_set(
    *, sites: int, seed: int, workers: int = 1, progress: Callable[[float], None] | None = None
) -> Examples:
    """Segments of `ROBOTS_PER_SITE` robots on each of `sites` random sites, squares cut from the surveyed heightmap.

    `run` is site * ROBOTS_PER_SITE + robot. Every site has its own generator (seed, site number), so that a set is the
    same with any number of `workers` (processes). A declared rolling resistance is what the robot draws on smooth level
    ground over its weight (eq. 5 at the battery, as the paper fits it), known to about 8 %. Raises InputError for less
    than one site.
    """
    if sites < 1:
        raise InputError(f"at least one site is needed, got {sites}", sites=sites)
    make = partial(_one_site, seed)
    parts = []
    with ExitStack() as stack:
        if workers > 1:  # spawned, because threads of numba and torch do not survive a fork
            pool = ProcessPoolExecutor(
                workers, mp_context=get_context("spawn"), initializer=numba.set_num_threads, initargs=(1,)
            )
            made: Iterable[Examples] = stack.enter_context(pool).map(make, range(sites), chunksize=4)
        else:
            made = map(make, range(sites))
        for number, part in enumerate(made, start=1):
            parts.append(part)
            if progress is not None:
                progress(number / sites)
    return concatenate(parts)


def _one_site(seed: int, number: int) -> Examples:
    rng = np.random.default_rng([seed, number])
    site = smooth_site(rng) if rng.random() < _SMOOTH_SHARE else random_site(rng, max_slope_deg=MAX_SLOPE_DEG)
    level = level_ground(site.ground, rng)
    return concatenate(
        [_drive_once(site, level, rng, run=number * ROBOTS_PER_SITE + k) for k in range(ROBOTS_PER_SITE)]
    )


def random_robot(rng: np.random.Generator) -> Robot:
    """A robot as its owner declares it, but for the rolling resistance: 15-120 kg, and sizes that go with the mass."""
    mass = math.exp(rng.uniform(math.log(15.0), math.log(120.0)))
    size = (mass / 35.0) ** 0.25

    def around(value: float, low: float, high: float) -> float:
        return float(np.clip(value * size * math.exp(0.2 * rng.standard_normal()), low, high))

    width = around(0.55, 0.35, 0.9)
    return Robot(
        name="simulated",
        mass_kg=mass,
        width_m=width,
        length_m=float(np.clip(width * rng.uniform(0.9, 1.5), 0.35, 1.2)),
        wheel_radius_m=around(0.125, 0.08, 0.2),
        speed_mps=math.exp(rng.uniform(math.log(0.3), math.log(1.2))),
        idle_power_w=12.0 * size**2 * math.exp(0.6 * rng.standard_normal()),
        regeneration=float(rng.uniform(0.2, 0.8)) if rng.random() < 0.25 else 0.0,
    )


def level_ground(ground: Ground, rng: np.random.Generator) -> Site:
    """Level ground, 4 x 16 m, with no relief but what is too fine for a survey to see."""
    frame = GridFrame(0.0, 4.0, TRUE_RESOLUTION_M, 80, 320)
    even = Relief(TerrainRecipe(max_slope_deg=0.0, roughness_rms_m=0.0), rough_m=0.0, tussocks_per_m2=0.0)
    return make_site("level", even, ground, frame, rng, survey_m=0.1)


def rolling_resistance_on(level: Site, ground: Ground, robot: FieldRobot) -> float:
    """What the robot draws for motion over level ground, per metre and newton of its declared weight: eq. 5's mu."""
    site = replace(level, ground=replace(ground, spread=0.0))
    drive = drive_along([(2.0, 2.0), (14.0, 2.0)], speed_mps=robot.declared.speed_mps)
    trace = simulate_trace(site, robot, drive, rng=np.random.default_rng(0))
    energy = float(trace.energy_j(trace.wheels_w)[-1])
    return energy / drive.length_m / robot.declared.weight_n


def smooth_site(rng: np.random.Generator) -> Site:
    """A road, a lawn or a slab: slopes as anywhere, hardly any roughness. `random_site` draws none so smooth."""
    slope = MAX_SLOPE_DEG * float(rng.uniform(0.0, 1.0))
    hills = TerrainRecipe(
        max_slope_deg=slope,
        tilt_deg=slope * float(rng.uniform(0.3, 1.0)),
        tilt_heading_deg=float(rng.uniform(0.0, 360.0)),
        relief_shortest_m=float(rng.uniform(4.0, 15.0)),
        roughness_rms_m=0.003 * float(rng.random()),
    )
    relief = Relief(hills, rough_m=0.002 * float(rng.random()), tussocks_per_m2=0.0, unevenness=0.3)
    ground = replace(random_ground(rng), tussock_m=0.002 * float(rng.random()))
    cells = round(_SITE_M / TRUE_RESOLUTION_M)
    frame = GridFrame(0.0, _SITE_M, TRUE_RESOLUTION_M, cells, cells)
    return make_site(
        "smooth",
        relief,
        ground,
        frame,
        rng,
        survey_m=float(rng.choice([0.05, 0.1, 0.2, 0.25, 0.5, 1.0])),
        noise_m=float(rng.uniform(0.0, 0.008)),
        smoothing_m=float(rng.uniform(0.02, 0.15)),
    )


def _drive_once(site: Site, level: Site, rng: np.random.Generator, *, run: int) -> Examples:
    """One robot over one site on a softer or harder version of its ground."""
    declared = random_robot(rng)
    truth = FieldRobot.drawn(declared, rng)
    wanted = math.exp(rng.uniform(*np.log(MU_RANGE)))
    bare, usual = (rolling_resistance_on(level, replace(site.ground, mu=mu), truth) for mu in (0.0, 0.06))
    softness = float(np.clip(0.06 * (wanted - bare) / (usual - bare), 0.01, 0.2))  # the loss is nearly linear in it
    ground = replace(site.ground, mu=softness)
    known = rolling_resistance_on(level, ground, truth) * math.exp(_DECLARED_SPREAD * rng.standard_normal())
    declared = replace(declared, rolling_resistance=float(np.clip(known, *MU_RANGE)))
    truth = replace(truth, declared=declared)
    points = random_waypoints(site.drivable, WAYPOINTS, rng)
    drive = drive_along(points, speed_mps=declared.speed_mps, rng=rng)
    segments = simulate_segments(replace(site, ground=ground), truth, drive, rng=rng)
    straight = np.abs(segments.heading_change_rad) < MAX_TURN_RAD
    return cut_examples(
        site.survey,
        declared,
        segments.x[straight],
        segments.y[straight],
        segments.heading_rad[straight],
        segments.energy_j[straight],
        run=run,
    )
