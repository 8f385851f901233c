"""Routes of simulated robots on simulated sites that the shipped network never saw."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.robot_dynamics import FieldRobot
from joulemap.model.field.simulation import simulate_segments, simulate_trace
from joulemap.model.field.sites import Site, random_site
from joulemap.model.robot import Robot
from joulemap.model.terrain.survey import SurveyQuality
from joulemap.model.training.simulated_set import (
    MAX_SLOPE_DEG,
    MU_RANGE,
    level_ground,
    random_robot,
    rolling_resistance_on,
    smooth_site,
)
from tests.coverage.scores import Held

SEED = 20261123
SMOOTH_SHARE, DECLARED_SPREAD = 0.2, 0.08  # as the shipped network was trained


def simulated(
    sites: int, *, seed: int = SEED, survey: Callable[[np.random.Generator], SurveyQuality] | None = None
) -> tuple[Held, np.ndarray, Spread]:
    """Held-out segments of the shipped network, with its own deviations before any factor; those of `physics`; and the
    network's own spread.

    survey : draws that of a site; as by scanners where None.
    """
    network, physics = load_predictor("default"), load_predictor("physics")
    parts: list[tuple[np.ndarray, ...]] = []
    for number in range(sites):
        rng = np.random.default_rng([seed, number])
        quality = None if survey is None else survey(np.random.default_rng([seed, number, 1]))
        if rng.random() < SMOOTH_SHARE:
            site = smooth_site(rng, quality)
        else:
            site = random_site(rng, max_slope_deg=MAX_SLOPE_DEG, survey=quality)
        level = level_ground(site.ground, rng)
        declared, truth, here = _robot(site, level, rng)
        points = random_waypoints(site.drivable, int(rng.integers(4, 26)), rng)
        drive = drive_along(points, speed_mps=declared.speed_mps, rng=rng)
        driven = simulate_segments(here, truth, drive, rng=rng, max_driven_m=3.0)
        places = site.survey.without_noise, declared, driven.x, driven.y, driven.heading_rad
        traction, std = network.segment_traction_and_std(*places)
        plain = physics.segment_traction(*places)
        assert std is not None
        beyond = declared.turn_j_per_rad * np.abs(driven.heading_change_rad)
        said, eq5 = (declared.price_per_m(t) * driven.driven_m + beyond for t in (traction, plain))
        own = std / network.spread.factor * driven.driven_m
        known = np.isfinite(said) & np.isfinite(eq5)
        run = np.full(known.sum(), number)
        parts.append((driven.energy_j[known], said[known], own[known], eq5[known], run))
    measured, predicted, std_j, eq5_j, runs = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Held(measured, predicted, std_j, runs, runs), eq5_j, network.spread


def _robot(site: Site, level: Site, rng: np.random.Generator) -> tuple[Robot, FieldRobot, Site]:
    """A robot as its owner declares it, as it truly is, and the site with the soil that it drives on. The owner has
    measured rolling and turning on smooth level ground, to about 8 %.
    """
    declared = replace(random_robot(rng), regeneration=0.0)
    truth = FieldRobot.drawn(declared, rng)
    wanted = math.exp(rng.uniform(*np.log(MU_RANGE)))
    bare, usual = (rolling_resistance_on(level, replace(site.ground, mu=mu), truth) for mu in (0.0, 0.06))
    ground = replace(site.ground, mu=float(np.clip(0.06 * (wanted - bare) / (usual - bare), 0.01, 0.2)))
    rolling = rolling_resistance_on(level, ground, truth)
    turning = _turning(level, truth, ground, rolling)
    known_rolling, known_turning = (
        value * math.exp(DECLARED_SPREAD * rng.standard_normal()) for value in (rolling, turning)
    )
    declared = replace(
        declared,
        rolling_resistance=float(np.clip(known_rolling, *MU_RANGE)),
        turn_j_per_rad=max(known_turning, 0.0),
    )
    return declared, replace(truth, declared=declared), replace(site, ground=ground)


def _turning(level: Site, truth: FieldRobot, ground: object, rolling: float) -> float:
    """Energy per radian of two right angles on level ground [J/rad]."""
    site = replace(level, ground=replace(ground, spread=0.0))  # type: ignore[type-var]
    drive = drive_along([(1.5, 1.0), (7.5, 1.0), (7.5, 3.0), (14.5, 3.0)], speed_mps=truth.declared.speed_mps)
    trace = simulate_trace(site, truth, drive, rng=np.random.default_rng(0))
    driven = float(np.hypot(np.diff(trace.x), np.diff(trace.y)).sum())
    beyond = float(trace.energy_j(trace.wheels_w)[-1]) - rolling * truth.declared.weight_n * driven
    return beyond / math.pi
