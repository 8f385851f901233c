"""The ranges that a model has learned, and warnings for maps and robots outside of them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from joulemap.model.errors import ModelError
from joulemap.model.robot import GRAVITY_MPS2, Robot
from joulemap.model.terrain.heightmap import Heightmap

ROBOT_KEYS = ("mass_kg", "width_m", "length_m", "wheel_radius_m", "speed_mps", "rolling_resistance")
"""Fields of the robot file that a network knows; the hotel load over the weight is added to them."""

TOLERANCE = 0.005
"""Share of a limit: a value on the edge is inside."""
_SHARE_WARNED = 0.001  # of the map that must be too steep before a warning is given
_SAMPLE_CELLS = 4_000_000  # a larger map's slopes are judged on every n-th row and column


@dataclass(frozen=True)
class Domain:
    """Ranges (low, high) of what a model was trained on."""

    # By the keys of `ROBOT_KEYS` and "hotel_over_weight" (idle energy per metre over m g)
    robot: dict[str, tuple[float, float]]
    resolution_m: tuple[float, float]  # Metres per pixel of the heightmaps
    max_slope_deg: float  # Steepest ground [degrees]
    # Logged load on top of the robot's mass [kg]. A model accounts for a logged load inside this range, and beyond it
    # only when a calibration has found an effect of it.
    payload_kg: tuple[float, float] = (0.0, 0.0)
    # Mean turn per segment that is in the model's prices [rad]: of models of version 0.1, which learned from straight
    # segments alone, and nobody drives perfectly straight
    turned_rad: float = 0.0
    # What the runs of a training on measured runs showed, without the lowest and the highest hundredth: "speed_mps",
    # "turn_rad_per_m", "turn_radps", "grade_deg" (uphill positive). Empty where the model learned from no such runs.
    driven: dict[str, tuple[float, float]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the ranges, JSON-able."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Domain:
        """Make a domain of what `as_dict` wrote."""
        try:
            robot = {str(k): (float(v[0]), float(v[1])) for k, v in values["robot"].items()}
            low, high = values["resolution_m"]
            least, most = values.get("payload_kg", (0.0, 0.0))
            return cls(
                robot,
                (float(low), float(high)),
                float(values["max_slope_deg"]),
                (float(least), float(most)),
                float(values.get("turned_rad", 0.0)),
                {str(k): (float(v[0]), float(v[1])) for k, v in (values.get("driven") or {}).items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise ModelError(f"the model does not say what it learned from: {error!r}") from error

    def joined(self, other: Domain) -> Domain:
        """Return the ranges that cover both: what a fine-tuned model knows.

        Result: with the `turned_rad` and `driven` of the other one: costs of driving are fitted to its runs alone.
        """
        robot = dict(self.robot)
        for key, (low, high) in other.robot.items():
            mine = robot.get(key, (low, high))
            robot[key] = min(mine[0], low), max(mine[1], high)
        resolution = (
            min(self.resolution_m[0], other.resolution_m[0]),
            max(self.resolution_m[1], other.resolution_m[1]),
        )
        payload = min(self.payload_kg[0], other.payload_kg[0]), max(self.payload_kg[1], other.payload_kg[1])
        steepest = max(self.max_slope_deg, other.max_slope_deg)
        return Domain(robot, resolution, steepest, payload, other.turned_rad, dict(other.driven))

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Return one sentence for every value outside the ranges, with the value and the limits."""
        found = []
        values = {key: getattr(robot, key) for key in ROBOT_KEYS}
        values["hotel_over_weight"] = robot.hotel_per_m / robot.weight_n
        for key, (low, high) in self.robot.items():
            value = values[key]
            if not low * (1.0 - TOLERANCE) <= value <= high * (1.0 + TOLERANCE):
                label = "idle power / (speed x weight)" if key == "hotel_over_weight" else key
                found.append(f"{label} = {value:.3g} is outside the {low:.3g}..{high:.3g} the network learned")
        if abs(robot.gravity_mps2 - GRAVITY_MPS2) > 0.01 * GRAVITY_MPS2:
            found.append(f"gravity_mps2 = {robot.gravity_mps2:.3g} is not that of the Earth, where the network learned")
        if "speed_mps" in self.driven:
            low, high = self.driven["speed_mps"]
            if not low * (1.0 - TOLERANCE) <= robot.speed_mps <= high * (1.0 + TOLERANCE):
                found.append(
                    f"speed_mps = {robot.speed_mps:.3g} is outside the {low:.3g}..{high:.3g} m/s of the runs that the "
                    "model was trained with"
                )
        low, high = self.resolution_m
        if not low * (1.0 - TOLERANCE) <= heightmap.resolution_m <= high * (1.0 + TOLERANCE):
            found.append(
                f"the heightmap's resolution of {heightmap.resolution_m:g} m/pixel is outside the {low:g}..{high:g} "
                "the network learned"
            )
        share = steep_share(heightmap, self.max_slope_deg)
        if share > _SHARE_WARNED:
            digits = 0 if share > 0.1 else 1
            found.append(
                f"{100.0 * share:.{digits}f} % of the map is steeper than the {self.max_slope_deg:.3g} degrees "
                "the network learned"
            )
        return found


def steep_share(heightmap: Heightmap, limit_deg: float) -> float:
    """Return the share of the known ground that is steeper than a limit.

    Slopes are central differences over a metre (or over the cell, where that is longer).
    """
    heights = heightmap.heights
    half = max(1, round(0.5 / heightmap.resolution_m))
    if min(heights.shape) < 2 * half + 1:
        return 0.0
    thin = max(1, math.isqrt(heights.size // _SAMPLE_CELLS))
    run = 2 * half * heightmap.resolution_m
    middle = slice(half, -half)
    east = (heights[middle, 2 * half :][::thin, ::thin] - heights[middle, : -2 * half][::thin, ::thin]) / run
    north = (heights[: -2 * half, middle][::thin, ::thin] - heights[2 * half :, middle][::thin, ::thin]) / run
    slope = np.hypot(east, north)
    known = np.isfinite(slope)
    if not known.any():
        return 0.0
    return float((slope[known] > math.tan(math.radians(limit_deg)) * (1.0 + TOLERANCE)).mean())
