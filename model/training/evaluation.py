"""How well a model predicts measured segments and whole runs: the errors that `evaluate` and `train` print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.metrics import LEAST_J, relative_errors
from joulemap.model.energy.prediction import Prediction, joined, predict_segments
from joulemap.model.energy.predictor import Predictor
from joulemap.model.energy.uncertainty import FEWEST, LEVELS, Spread, fit_spread
from joulemap.model.errors import InputError
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.sites import Site, read_sites
from joulemap.model.training.run_record import seen_runs

FloatArray = NDArray[np.float64]


def errors(predicted_j: ArrayLike, energy_j: ArrayLike, run: ArrayLike) -> dict[str, Any]:
    """Compare predicted with measured energies of segments.

    `predicted_j`, `energy_j` (n,); `run` (n,). Result: JSON-able: segments; mean_relative_error and
    median_relative_error, as `metrics.relative_errors`; rmse_j and mean_absolute_error_j; error_share, the sum of
    |errors| over that of |energies|, which stays finite where a segment takes no energy; bias_j, the mean of measured -
    predicted; rmse_j_by_run and mean_absolute_error_j_by_run; route_relative_errors, |sum e_hat - sum e| / sum e of
    every whole run; and route_relative_error, their mean.
    """
    predicted, energy = np.asarray(predicted_j, dtype=np.float64), np.asarray(energy_j, dtype=np.float64)
    if energy.size == 0:
        raise InputError("there is no segment to judge by")
    relative = relative_errors(predicted, energy)
    residual = energy - predicted
    by_run, rmse_by_run, absolute_by_run = {}, {}, {}
    for one in np.unique(run):
        mine = np.asarray(run) == one
        rmse_by_run[str(one)] = float(np.sqrt(np.mean(residual[mine] ** 2)))
        absolute_by_run[str(one)] = float(np.abs(residual[mine]).mean())
        by_run[str(one)] = float(abs(residual[mine].sum()) / max(abs(energy[mine].sum()), 1e-9))
    return {
        "segments": int(energy.size),
        "mean_relative_error": float(relative.mean()),
        "median_relative_error": float(np.median(relative)),
        "rmse_j": float(np.sqrt(np.mean(residual**2))),
        "mean_absolute_error_j": float(np.abs(residual).mean()),
        "error_share": float(np.abs(residual).sum() / max(np.abs(energy).sum(), LEAST_J)),
        "bias_j": float(residual.mean()),
        "rmse_j_by_run": rmse_by_run,
        "mean_absolute_error_j_by_run": absolute_by_run,
        "route_relative_error": float(np.mean(list(by_run.values()))),
        "route_relative_errors": by_run,
    }


def named(found: Mapping[str, Any], runs: Sequence[str]) -> dict[str, Any]:
    """Return errors in which runs have their names."""
    return {
        key: {runs[int(number)]: one for number, one in value.items()} if isinstance(value, dict) else value
        for key, value in found.items()
    }


def segment_errors(said_j: FloatArray, segments: Segments) -> dict[str, Any]:
    """Return the errors on the segments that a prediction knows, (n,) [J], with runs named."""
    known = np.isfinite(said_j)
    return named(errors(said_j[known], segments.energy_j[known], segments.run[known]), segments.runs)


def segment_spread(said: Prediction, segments: Segments) -> Spread:
    """Return the spread of predictions around segments that they had not seen; the usual one where these are few."""
    known = np.isfinite(said.energy_j)
    if said.std_j is None or known.sum() < FEWEST:
        return Spread()
    return fit_spread(segments.energy_j[known], said.energy_j[known], said.std_j[known], segments.run[known])


def coverage(energy_j: ArrayLike, predicted_j: ArrayLike, std_j: ArrayLike, spread: Spread) -> dict[str, float]:
    """Count how many measured segments are inside the predicted intervals.

    `energy_j`, `predicted_j`, `std_j` (n,): measured energy, predicted energy and its standard deviation [J].
    """
    energy = np.asarray(energy_j, dtype=np.float64)
    inside = {}
    for level in LEVELS:
        low, high = spread.interval(predicted_j, std_j, level)
        inside[f"{100 * level:.0f}"] = float(np.mean((low <= energy) & (energy <= high)))
    return inside


def evaluate_on_sites(predictor: Predictor, sites: Sequence[Site], *, charge: bool = False) -> dict[str, Any]:
    """Judge a predictor by measured runs over their heightmaps.

    Result: the numbers of `errors`, with runs named; `coverage`, the share of segments inside the predicted 50, 80 and
    90 % intervals (None where the model has none); `unknown`, the number of segments on unknown ground; `repairs` and
    `left_out`, what was repaired in the logs and what was not made a segment, by rule; `used`, metres of track as
    `Segments.coverage` returns them; `seen_in_training`, those of the runs that the model was trained with; `warnings`,
    which say so in words.
    """
    measured = read_sites(sites, charge=charge)
    runs, segments = measured.runs, measured.segments
    said = joined(
        [
            predict_segments(predictor, site.ground, site.robot, segments.take(measured.on(k)))
            for k, site in enumerate(sites)
        ]
    )
    known = np.isfinite(said.energy_j)
    found = segment_errors(said.energy_j, segments)
    covered = None
    if said.std_j is not None:
        covered = coverage(segments.energy_j[known], said.energy_j[known], said.std_j[known], predictor.spread)
    beyond = [warning for site in sites for warning in predictor.warnings(site.ground, site.robot)]
    seen, warnings = seen_runs(predictor.provenance(), runs)
    if charge or not all(run.has_energy for run in runs):
        volts = ", ".join(sorted({f"{site.robot.nominal_voltage_v:g}" for site in sites}))
        warnings.append(f"energy is the logged charge times the robot's nominal voltage, {volts} V, and not measured")
    outside = sorted(set(segments.runs) - {segments.runs[k] for k in np.unique(segments.run[known])})
    if outside:
        warnings.append(f"no metre of these runs lies on known ground of the map: {', '.join(outside)}")
    return {
        "model": predictor.name,
        **found,
        "coverage": covered,
        "unknown": int((~known).sum()),
        "repairs": {run.name: run.repairs for run in runs if run.repairs},
        "left_out": segments.left_out,
        "used": segments.coverage(),
        "seen_in_training": seen,
        "warnings": list(dict.fromkeys([*warnings, *beyond])),
    }
