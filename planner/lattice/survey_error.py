"""What it does to all energies of a map that bumps of it are noise or ground: nobody knows which."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from joulemap.model.frames import heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.noise_estimate import sample_windows
from joulemap.model.terrain.windows import Ground
from joulemap.model.traction import TractionSource

_WORTH_SAYING = 0.05
"""The usual error of a whole run (`Spread.run_share`)."""
_SPACING_M = 1.0
_PART_CELLS, _PARTS, _HEADINGS = 64, 2, 4
"""Of a map 2 x 2 parts of 64 x 64 cells are priced at four headings."""


def with_survey_error(
    model: dict[str, Any], ground: Ground, robot: Robot, source: TractionSource
) -> tuple[dict[str, Any], list[str]]:
    """Return the provenance of a model, with the error of a map in what a whole run has in common, and a warning of it.

    `model`: as `TractionSource.provenance` gives it; unchanged from a model that gives no odds, and from one of runs on
    this very map, whose energies and odds are already those of its bumps.
    """
    spread, bumps = model.get("spread"), ground.noise.bumps
    learned_here = bumps is not None and ground.data_hash in model.get("heightmaps", ())
    error = survey_error(ground, robot, source) if spread is not None and not learned_here else 0.0
    if spread is None or bumps is None or error == 0.0:
        return model, []
    said = (
        f"bumps of {1000.0 * bumps.std_m:.0f} mm that are alike over {bumps.length_m:.2g} m are noise with a "
        f"probability of {bumps.probability:.0%}, else ground: all energies of the map are uncertain by {error:.0%}. "
        f"`noise_m` {bumps.std_m:.2g} and `noise_length_m` {bumps.length_m:.2g} call them noise, and `noise_m` 0 ground"
    )
    return {**model, "spread": {**spread, "run_share": math.hypot(spread["run_share"], error)}}, (
        [said] if error > _WORTH_SAYING else []
    )


def survey_error(ground: Ground, robot: Robot, source: TractionSource) -> float:
    """Return the standard deviation of a map's energies, as a share of them, over what its bumps may be.

    0 where the noise is known. Parts of the map are priced as if its bumps were ground, and as if they were noise.
    """
    bumps = ground.noise.bumps
    if bumps is None or bumps.probability == 0.0:
        return 0.0
    energies = np.zeros(3)
    noises = (0.0, 0.0), (bumps.std_m, bumps.length_m), (ground.noise.noise_m, ground.noise.length_m)
    for window in sample_windows(ground.frame, _PART_CELLS, _PARTS):
        heights = ground.window(*window)
        if min(heights.frame.shape) * heights.resolution_m < _SPACING_M:
            continue
        frame = heights.frame.respaced(max(_SPACING_M, heights.resolution_m))
        prices = []
        for noise_m, length_m in noises:
            known = replace(heights, given_noise_m=noise_m, given_noise_length_m=length_m).without_noise
            prices.append(robot.price_per_m(source.traction_and_std(known, robot, frame, heading_bins(_HEADINGS))[0]))
        energies += np.nansum(prices, axis=(1, 2, 3))
    if not energies[2] > 0.0:
        return 0.0
    if_ground, if_noise = (energies[:2] / energies[2] - 1.0).tolist()
    return math.sqrt((1.0 - bumps.probability) * if_ground**2 + bumps.probability * if_noise**2)
