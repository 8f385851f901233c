"""Simulated runs to train the shipped network on: random robots on random sites, driven and cut into examples.

This is the only module that joins the simulated field (which imports no model) to the models (which import no field).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from multiprocessing import get_context

import numba
import numpy as np

from joulemap.model.energy.examples import MAX_TURN_RAD, Examples, concatenate, cut_examples
from joulemap.model.errors import InputError
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.robot_dynamics import FieldRobot, Ground
from joulemap.model.field.simulation import simulate_segments, simulate_trace
from joulemap.model.field.sites import (
    SURVEYS,
    TRUE_RESOLUTION_M,
    Relief,
    Site,
    make_site,
    random_ground,
    random_site,
    random_survey,
)
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.survey import SurveyQuality, degrade
from joulemap.model.terrain.synthesis import TerrainRecipe

ROBOTS_PER_SITE = 3
WAYPOINTS = 12
MU_RANGE = (0.03, 0.25)
"""Declared rolling resistances that are learned."""
MAX_SLOPE_DEG = 30.0
"""Slopes of the sites reach up to this."""
_SITE_M = 30.0
_SMOOTH_SHARE = 0.2
_ALL_SEEN = 0.5  # share of the surveys that show the finest relief too, which vegetation hides in the others
_DECLARED_SPREAD = 0.08  # how well an owner knows the rolling resistance (standard deviation of its logarithm)


def make_pretraining_set(
    *, sites: int, seed: int, workers: int = 1, progress: Callable[[float], None] | None = None
) -> Examples:
    """Simulate segments of `ROBOTS_PER_SITE` robots on each of many random sites.

    Inputs are cut from the surveyed heightmap. A declared rolling resistance is what the robot draws on smooth level
    ground over its weight (eq. 5 at the battery, as the paper fits it), known to about 8 %.
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
    survey = random_survey(rng)
    if rng.random() < _SMOOTH_SHARE:
        site = smooth_site(rng, survey)
    else:
        site = random_site(rng, max_slope_deg=MAX_SLOPE_DEG, survey=survey)
    if rng.random() < _ALL_SEEN:
        site = replace(site, survey=degrade(site.terrain, survey, rng=rng))
    level = level_ground(site.ground, rng)
    return concatenate(
        [_drive_once(site, level, rng, run=number * ROBOTS_PER_SITE + k) for k in range(ROBOTS_PER_SITE)]
    )


def random_robot(rng: np.random.Generator) -> Robot:
    """Draw a robot as its owner declares it, without a rolling resistance.

    Result: of 15 to 120 kg, with dimensions that fit the mass.
    """
    mass = math.exp(rng.uniform(math.log(15.0), math.log(120.0)))
    size = (mass / 35.0) ** 0.25

    def _around(value: float, low: float, high: float) -> float:
        return float(np.clip(value * size * math.exp(0.2 * rng.standard_normal()), low, high))

    width = _around(0.55, 0.35, 0.9)
    return Robot(
        name="simulated",
        mass_kg=mass,
        width_m=width,
        length_m=float(np.clip(width * rng.uniform(0.9, 1.5), 0.35, 1.2)),
        wheel_radius_m=_around(0.125, 0.08, 0.2),
        speed_mps=math.exp(rng.uniform(math.log(0.3), math.log(1.2))),
        idle_power_w=12.0 * size**2 * math.exp(0.6 * rng.standard_normal()),
        regeneration=float(rng.uniform(0.2, 0.8)) if rng.random() < 0.25 else 0.0,
    )


def level_ground(ground: Ground, rng: np.random.Generator) -> Site:
    """Make level ground of 4 x 16 m whose only relief is too fine for a survey."""
    frame = GridFrame(0.0, 4.0, TRUE_RESOLUTION_M, 80, 320)
    even = Relief(TerrainRecipe(max_slope_deg=0.0, roughness_rms_m=0.0), rough_m=0.0, tussocks_per_m2=0.0)
    return make_site("level", even, ground, frame, rng, SURVEYS["scanner"])


def rolling_resistance_on(level: Site, ground: Ground, robot: FieldRobot) -> float:
    """Measure the mu of eq. 5 as an owner would: the energy of motion on level ground.

    Result: battery energy of motion per metre and per newton of the declared weight.
    """
    site = replace(level, ground=replace(ground, spread=0.0))
    drive = drive_along([(2.0, 2.0), (14.0, 2.0)], speed_mps=robot.declared.speed_mps)
    trace = simulate_trace(site, robot, drive, rng=np.random.default_rng(0))
    energy = float(trace.energy_j(trace.wheels_w)[-1])
    return energy / drive.length_m / robot.declared.weight_n


def smooth_site(rng: np.random.Generator, survey: SurveyQuality | None = None) -> Site:
    """Draw a road, a lawn or a slab: usual slopes, hardly any roughness. `random_site` draws no ground as smooth."""
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
    if survey is None:
        survey = SurveyQuality(
            float(rng.choice([0.05, 0.1, 0.2, 0.25, 0.5, 1.0])),
            noise_m=float(rng.uniform(0.0, 0.008)),
            smoothing_m=float(rng.uniform(0.02, 0.15)),
        )
    return make_site("smooth", relief, ground, frame, rng, survey)


def _drive_once(site: Site, level: Site, rng: np.random.Generator, *, run: int) -> Examples:
    """The segments of one robot on one site, on a softer or harder version of its ground."""
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
        site.survey.without_noise,
        declared,
        segments.x[straight],
        segments.y[straight],
        segments.heading_rad[straight],
        segments.energy_j[straight],
        run=run,
    )
