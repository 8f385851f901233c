"""What a survey can show of the ground to a robot: slopes, bumps and steps, by its cells and its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from joulemap.model.robot import Robot
from joulemap.model.terrain.correlated_noise import PossibleNoise
from joulemap.model.terrain.denoising import LEAST_NOISE_M, correlation_of, hiding_noise_m
from joulemap.model.terrain.windows import Ground
from joulemap.planner.lattice.limits import SQUARE_M, STEP_IN_NOISE

BUMP_IN_NOISE = 2.0
"""A bump of so many standard deviations of the noise, a few cells wide, is half kept where noise is taken out: its
details have about the noise's own variance in `model.terrain.denoising`."""


@dataclass(frozen=True, slots=True)
class VisibleFeatures:
    """What a survey can show.

    Attributes
    ----------
    noise_m : float
        Standard deviation of its heights [m].
    noise_length_m : float
        Length over which it is alike [m]; 0 where it is independent from cell to cell.
    noise_given : bool
        Whether the user gave it; else it was estimated.
    bumps : PossibleNoise or None
        Bumps that are noise or ground.
    slope_std_deg : float
        Standard deviation of the slope of a square metre [deg].
    least_bump_m : float
        Height of the lowest bumps that are mostly kept [m].
    shortest_bump_m : float
        Length of the shortest [m]: two cells.
    least_step_m : float or None
        Height of the lowest steps that are mostly found [m]; None where the cells are wider than a wheel.
    """

    noise_m: float
    noise_length_m: float
    noise_given: bool
    bumps: PossibleNoise | None
    slope_std_deg: float
    least_bump_m: float
    shortest_bump_m: float
    least_step_m: float | None

    @property
    def noise_in_words(self) -> str:
        """What the noise is, and what may be noise."""
        alike = f", alike over {self.noise_length_m:.2g} m" if self.noise_length_m else ""
        noise = f"{1000.0 * self.noise_m:.1f} mm, " + ("given" if self.noise_given else "estimated") + alike
        if self.noise_given:
            return noise
        if self.bumps is None:
            return (
                f"{noise} from what differs from cell to cell. Noise that is alike over some cells, as of a drone, is "
                "only seen where it exceeds bumps of ground: otherwise give --noise and --noise-length"
            )
        return (
            f"{noise}. Bumps of {1000.0 * self.bumps.std_m:.0f} mm (standard deviation) that are alike over "
            f"{self.bumps.length_m:.2g} m are taken for noise with a probability of {self.bumps.probability:.0%}. If "
            f"they are noise, give --noise {self.bumps.std_m:.2g} --noise-length {self.bumps.length_m:.2g}; if they "
            "are ground, give --noise 0"
        )

    def in_words(self, robot: Robot) -> tuple[str, str, str]:
        """Return a sentence on slopes, on bumps and on steps, for this robot."""
        slopes = f"a standard error of {self.slope_std_deg:.1g} degrees over {SQUARE_M:g} m"
        wheel_m = 2.0 * robot.wheel_radius_m
        bumps = f"those longer than {self.shortest_bump_m:.2g} m and higher than {1000 * self.least_bump_m:.0f} mm"
        if self.shortest_bump_m > 4.0 * wheel_m:
            bumps += f"; shorter ones, which wheels of {wheel_m:g} m feel, are not in the energies"
        if self.least_step_m is None:
            steps = f"cannot be seen: cells are wider than a wheel of {wheel_m:g} m"
        elif self.least_step_m > robot.wheel_radius_m:
            steps = (
                f"those of {self.least_step_m:.2g} m and more; lower ones, which stop {robot.name} from "
                f"{robot.wheel_radius_m:g} m on, may be hidden"
            )
        else:
            steps = f"all that stop {robot.name}, from {robot.wheel_radius_m:g} m on"
        return slopes, bumps, steps


def visible_features(ground: Ground, robot: Robot) -> VisibleFeatures:
    """Return what a map of any size can show to a robot."""
    cells_m, noise, noise_m = ground.frame.resolution_m, ground.noise, ground.noise.noise_m
    length_cells = noise.length_m / cells_m
    x = np.arange(max(round(SQUARE_M / cells_m), 1) + 1.0)
    x -= x.mean()
    alike = correlation_of(np.subtract.outer(x, x), length_cells)
    # least-squares plane through n x n heights: slope sum x_i h_ij / (n sum x_i^2); the correlation is separable
    slope = noise_m / cells_m * math.sqrt((x @ alike @ x) * alike.sum()) / (x.size * (x @ x))
    shown = max(hiding_noise_m(noise_m, length_cells), LEAST_NOISE_M)
    return VisibleFeatures(
        noise_m,
        noise.length_m,
        ground.given_noise_m is not None,
        noise.bumps,
        math.degrees(math.atan(slope)),
        BUMP_IN_NOISE * shown,
        2.0 * cells_m,
        STEP_IN_NOISE * shown if cells_m <= 2.0 * robot.wheel_radius_m else None,
    )
