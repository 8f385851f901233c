"""A day of measured runs at a simulated site, one after another on one battery, with effects that nobody declares."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from joulemap.model.field.conditions import Conditions, Halts
from joulemap.model.field.drives import Drive
from joulemap.model.field.hidden_draws import WORDS, conditions_for, day_for, draw_effect
from joulemap.model.field.logger import RunLog, log_trace
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import simulate_trace, with_halts
from joulemap.model.field.sites import Site

_DAY_S = 86400.0
_FULL = 0.97


def simulate_day(
    site: Site,
    robot: FieldRobot,
    drives: Iterable[Drive],
    *,
    day: int,
    hidden: Sequence[str] = (),
    rng: np.random.Generator,
) -> Iterator[RunLog]:
    """Drive and log the runs of one day, with its weather, its halts and a battery that is used up.

    Raises NotFoundError if an effect is unknown.
    """
    effects = [draw_effect(name, rng, robot) for name in hidden]
    if "terrain_class" in hidden:
        site = site.with_words(WORDS, rng)
    weather = day_for(effects, rng)
    payload_logged = bool(rng.random() < 0.7)
    clock, charge, driven = day * _DAY_S + float(rng.uniform(7.5, 9.0)) * 3600.0, _FULL, 0.0
    gain = float(np.prod([effect.reading() for effect in effects]))
    for drive in drives:
        drawn = Conditions.drawn(rng, start_s=clock, driven_m=driven, charge=charge, day=weather)
        conditions = conditions_for(effects, drawn, robot, rng, payload_logged=payload_logged)
        stations = np.sort(rng.choice(drive.x.size - 1, int(rng.integers(2, 5)), replace=False))
        conditions = replace(conditions, halts=Halts(stations, rng.uniform(3.0, 12.0, stations.size)))
        trace = simulate_trace(site, robot, drive, rng=rng, effects=effects, conditions=conditions)
        trace = with_halts(trace, conditions.halts)
        words = site.words_at(trace.x, trace.y)
        yield log_trace(trace, robot, rng=rng, terrain=words, conditions=conditions, current_gain=gain)
        driven += drive.length_m
        charge -= float(trace.energy_j()[-1]) / 3600.0 / robot.declared.battery_wh
        clock += float(trace.t[-1]) + float(rng.uniform(0.3, 1.6)) * 3600.0
