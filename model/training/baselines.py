"""Simple models that a training is compared with: a constant, equation 5 with fitted friction, a ridge regression."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.training.cost_regression import CostRows

FloatArray = NDArray[np.float64]

_PENALTIES = tuple(float(p) for p in 10.0 ** np.arange(-3.0, 4.01, 1.0))


def baseline_predictions(rows: CostRows, shapes: FloatArray, fitted: NDArray[np.bool_]) -> dict[str, FloatArray]:
    """Fit simple models to some segments, and predict the others.

    `shapes` (n, 11): their `shape_features`, NaN on unknown ground; `fitted` (n,): which of them to fit to. Result:
    energy of the others [J] by model: "a constant energy per metre"; "equation 5 with fitted friction"; "a ridge
    regression on shape, turning, time and speeding up".

    All are least squares of the energy. Friction is fitted with the declared idle power and cost of turning. The ridge
    penalty, on the shape of the ground alone, is the one that predicts runs best that are left out in turn.
    """
    s = rows.segments
    metres = s.driven_m
    energy = s.energy_j
    weight = rows.of_robot("weight_n")
    usable = fitted & np.isfinite(rows.tan_grade) & np.isfinite(shapes).all(axis=1)
    constant = float(metres[fitted] @ energy[fitted] / (metres[fitted] @ metres[fitted]))
    idle_j = rows.of_robot("idle_power_w") * s.duration_s + rows.of_robot("turn_j_per_rad") * s.turned_abs_rad
    rolling = (weight * metres)[usable]
    rest = (energy - idle_j - weight * rows.tan_grade * metres)[usable]
    mu = float(rolling @ rest / (rolling @ rolling)) if usable.any() else float("nan")
    physics = idle_j + np.maximum(weight * (mu + rows.tan_grade), 0.0) * metres
    found = {
        "a constant energy per metre": (constant * metres)[~fitted],
        "equation 5 with fitted friction": physics[~fitted],
    }
    enough = usable.sum() > 2 * (shapes.shape[1] + 4)
    ridge = _ridge(rows, shapes, usable) if enough else np.full(usable.size, np.nan)
    return {**found, "a ridge regression on shape, turning, time and speeding up": ridge[~fitted]}


def _ridge(rows: CostRows, shapes: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    s = rows.segments
    mean, scale = shapes[usable].mean(axis=0), shapes[usable].std(axis=0)
    shape = (shapes - mean) / np.where(scale > 1e-9, scale, 1.0) * s.driven_m[:, None]
    free = np.stack([s.driven_m, s.turned_abs_rad, s.duration_s - s.standing_s, s.gained_m2ps2], axis=1)
    design = np.concatenate([free, shape], axis=1)
    run = s.run[usable]
    if np.unique(run).size < 2:
        run = np.arange(run.size) * 5 // run.size
    known, energy = design[usable], s.energy_j[usable]

    def _left_out(penalty: float) -> float:
        total = 0.0
        for one in np.unique(run):
            out = run == one
            found = _solved(known[~out], energy[~out], penalty, free.shape[1])
            total += float(np.sum((energy[out] - known[out] @ found) ** 2))
        return total

    penalty = min(_PENALTIES, key=_left_out)
    return np.asarray(design @ _solved(known, energy, penalty, free.shape[1]))


def _solved(design: FloatArray, energy: FloatArray, penalty: float, free: int) -> FloatArray:
    ridge = np.diag(np.where(np.arange(design.shape[1]) < free, 1e-9, penalty))
    return np.linalg.lstsq(design.T @ design + ridge, design.T @ energy, rcond=None)[0]
