"""The shipped network: trained on simulated runs, judged on simulated runs that it has not seen, with a model card."""

from __future__ import annotations

import datetime as dt
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.energy.artifact import Artifact, save_artifact
from joulemap.model.energy.examples import Examples
from joulemap.model.energy.physics import eq5_traction_per_m, fit_rolling_resistance
from joulemap.model.energy.tensors import predicted
from joulemap.model.energy.uncertainty import fit_spread
from joulemap.model.training.evaluation import coverage, errors
from joulemap.model.training.model_card import model_card
from joulemap.model.training.optimisation import TrainingOptions, train_network
from joulemap.model.training.simulated_set import MAX_SLOPE_DEG, ROBOTS_PER_SITE, make_pretraining_set

PRETRAINING = TrainingOptions(
    epochs=14, patience=14, batch=512, learning_rate=2e-3, weight_decay=0.05, feature_jitter=0.1
)
DEFAULT_SITES = 4000
DEFAULT_SEED = 20261121
"""The shipped network's seed and number of sites."""
CARD_FILE = "MODEL_CARD.md"
_HELD_OUT = 0.08  # share of the sites that decides when to stop, and again as many to report errors on


def train_default(
    out: str | Path,
    *,
    seed: int = DEFAULT_SEED,
    sites: int = DEFAULT_SITES,
    workers: int = 2,
    options: TrainingOptions = PRETRAINING,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Simulate sites, train the shipped network on them and write its folder.

    Result: what config.json says of the training, JSON-able, with `version`. `held_out` holds the errors on sites and
    robots that neither training nor stopping used, on segments without regeneration.
    """
    report = progress or (lambda _: None)
    examples = make_pretraining_set(sites=sites, seed=seed, workers=workers, progress=lambda p: report(0.4 * p))
    site = examples.run // ROBOTS_PER_SITE
    order = np.random.default_rng([seed, sites]).permutation(np.unique(site))
    count = max(1, round(_HELD_OUT * order.size))
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
        "data": "simulated sites and robots (model.training.pretraining)",
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
    """Judge eq. 5 with the declared rolling resistance, and with the one that fits each run best.

    Result: errors by method, JSON-able.
    """
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
    """`errors` without what it says of every run."""
    found = errors(energy_j, examples.energy_j, examples.run)
    numbers = {key: value for key, value in found.items() if isinstance(value, (int, float))}
    return {key: value if isinstance(value, int) else round(value, 5) for key, value in numbers.items()}
