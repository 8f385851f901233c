"""What a drive costs beyond going straight ahead at the declared speed: turning, time and speeding up."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments

FloatArray = NDArray[np.float64]

_NO_LONGER = (
    "eased_turn_j_per_rad",
    "speed_mps",
)  # turning that cost less at speed, which hung on one metre of one log


@dataclass(frozen=True)
class DriveCosts:
    """Costs that were fitted to measured runs together with a network.

    A network answers for driving straight ahead at the robot's declared speed. All costs are zero there.
    """

    turn_j_per_rad: float = 0.0  # Energy of turning [J/rad]
    # Power while the robot moves, beyond its declared idle power [W], for the time that it took more, or less, than
    # at its declared speed. None where the time of a segment does not count.
    driving_w: float | None = None
    speed_up_kg: float = 0.0  # Energy of speeding up over the gain of half the squared speed [J per m^2/s^2]
    # Of the robot that drove [kg]. Costs of another robot are in proportion to its mass, but for `driving_w`. 0 where
    # it is not known: costs are then those of every robot.
    mass_kg: float = 0.0

    def __post_init__(self) -> None:
        numbers = [0.0 if value is None else value for value in asdict(self).values()]
        if not all(isinstance(value, int | float) and math.isfinite(value) for value in numbers):
            raise ModelError(f"the costs of a drive are finite numbers, got {asdict(self)}")

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> DriveCosts:
        """Make costs of what `as_dict` wrote."""
        if values.get(_NO_LONGER[0]):
            raise ModelError(
                "turning costs less at speed in this model, which this version of joulemap does not know: train it "
                "again on the same runs"
            )
        try:
            return cls(**{key: value for key, value in values.items() if key not in _NO_LONGER})
        except TypeError as error:
            raise ModelError(f"the model has no valid costs of driving: {error}") from error

    def scaled(self, factor: float) -> DriveCosts:
        """Return a multiple of the costs."""
        return replace(
            self,
            turn_j_per_rad=round(factor * self.turn_j_per_rad, 3),
            driving_w=None if self.driving_w is None else round(factor * self.driving_w, 3),
            speed_up_kg=round(factor * self.speed_up_kg, 3),
        )

    def planned_turn_j_per_rad(self, robot: Robot) -> float:
        """Return the energy of turning that a plan counts. Result: energy [J/rad]."""
        return self._scale(robot) * self.turn_j_per_rad

    def energy_j(self, robot: Robot, segments: Segments) -> FloatArray:
        """Return what measured segments cost beyond going straight ahead at the declared speed.

        Result (n,): energy [J].
        """
        scale = self._scale(robot)
        energy = scale * self.turn_j_per_rad * segments.turned_abs_rad
        if self.speed_up_kg:
            energy = energy + scale * self.speed_up_kg * segments.gained_m2ps2
        if self.driving_w is not None:
            energy = energy + robot.idle_power_w * (segments.duration_s - segments.driven_m / robot.speed_mps)
            energy = energy + self.driving_w * slower_s(robot, segments)
        return np.asarray(energy, dtype=np.float64)

    def _scale(self, robot: Robot) -> float:
        return robot.mass_kg / self.mass_kg if self.mass_kg else 1.0


def slower_s(robot: Robot, segments: Segments) -> FloatArray:
    """Return how much longer segments took than at the declared speed, short halts left out.

    Result (n,): time [s]; negative where the robot was faster.
    """
    return np.asarray(segments.duration_s - segments.standing_s - segments.driven_m / robot.speed_mps)
