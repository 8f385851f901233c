"""What a drive costs beyond going straight ahead at the declared speed: turning, time and speeding up."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.track import TURN_LIMITS_RADPS

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class DriveCosts:
    """Costs that were fitted to measured runs together with a network.

    A network answers for driving straight ahead at the robot's declared speed. All costs are zero there.

    Attributes
    ----------
    turn_j_per_rad : float
        Energy of turning [J/rad].
    slow_turn_j_per_rad : tuple of float
        Further energy of turning [J/rad], for each of `TURN_LIMITS_RADPS`, as long as the robot turns no faster. Of a
        faster turn only the part counts that this rate would have turned: the cost saturates. Empty where it does not.
    slow_share : tuple of float
        Share of the turning in the runs that counts for each of them, 0..1.
    driving_w : float, optional
        Power while the robot moves, beyond its declared idle power [W], for the time that it took more, or less, than
        at its declared speed. None where the time of a segment does not count.
    speed_up_kg : float
        Energy of speeding up over the gain of half the squared speed [J per m^2/s^2].
    mass_kg : float
        Of the robot that drove [kg]. Costs of another robot are in proportion to its mass, but for `driving_w`. 0 where
        it is not known: costs are then those of every robot.
    """

    turn_j_per_rad: float = 0.0
    slow_turn_j_per_rad: tuple[float, ...] = ()
    slow_share: tuple[float, ...] = ()
    driving_w: float | None = None
    speed_up_kg: float = 0.0
    mass_kg: float = 0.0

    def __post_init__(self) -> None:
        slow = (*self.slow_turn_j_per_rad, *self.slow_share)
        numbers = [self.turn_j_per_rad, self.driving_w or 0.0, self.speed_up_kg, self.mass_kg, *slow]
        if not all(isinstance(value, int | float) and math.isfinite(value) for value in numbers):
            raise ModelError(f"the costs of a drive are finite numbers, got {asdict(self)}")
        lengths = {len(self.slow_turn_j_per_rad), len(self.slow_share)}
        if lengths not in ({0}, {len(TURN_LIMITS_RADPS)}):
            raise ModelError(f"slow turns have {len(TURN_LIMITS_RADPS)} costs and shares, got {slow}")

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> DriveCosts:
        """Make costs of what `as_dict` wrote.

        Parameters
        ----------
        values : mapping
            The numbers by name.

        Returns
        -------
        DriveCosts
            The costs.

        Raises
        ------
        ModelError
            If the values are no costs.
        """
        try:
            slow = {key: tuple(values[key]) for key in ("slow_turn_j_per_rad", "slow_share") if key in values}
            return cls(**{**values, **slow})
        except TypeError as error:
            raise ModelError(f"the model has no valid costs of driving: {error}") from error

    def planned_turn_j_per_rad(self, robot: Robot) -> float:
        """Return the energy of turning that a plan counts: that of the runs in the mean.

        Parameters
        ----------
        robot : Robot
            Which turns.

        Returns
        -------
        float
            Energy [J/rad].
        """
        slow = sum(share * cost for share, cost in zip(self.slow_share, self.slow_turn_j_per_rad, strict=True))
        return self._scale(robot) * (self.turn_j_per_rad + slow)

    def energy_j(self, robot: Robot, segments: Segments) -> FloatArray:
        """Return what measured segments cost beyond going straight ahead at the declared speed.

        Parameters
        ----------
        robot : Robot
            That drove.
        segments : Segments
            Measured.

        Returns
        -------
        ndarray of float64, (n,)
            Energy [J].
        """
        scale = self._scale(robot)
        energy = scale * self.turn_j_per_rad * segments.turned_abs_rad
        if self.slow_turn_j_per_rad:
            energy = energy + scale * segments.gentle_turn_rad @ np.array(self.slow_turn_j_per_rad)
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

    Parameters
    ----------
    robot : Robot
        That drove.
    segments : Segments
        Measured.

    Returns
    -------
    ndarray of float64, (n,)
        Time [s]; negative where the robot was faster.
    """
    return np.asarray(segments.duration_s - segments.standing_s - segments.driven_m / robot.speed_mps)
