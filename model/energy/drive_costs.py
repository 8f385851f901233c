"""What a drive costs beyond going straight ahead at the declared speed: turning, time and speeding up."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments

FloatArray = NDArray[np.float64]

_LEAST_S = 1e-3  # that a segment takes, less than between two readings

HALF_SPEEDS = 2.0
"""Setting: cruising speeds at which a radian costs half of what it costs on the spot, where turning eases with speed.

Chosen on DRIVE. There a calibration errs by 353 J a metre on runs that were left out, and by 521 J where turning does
not ease."""


def easing(speed_mps: ArrayLike, cruising_mps: float) -> FloatArray:
    """Return what a radian of turning costs at a speed over what it costs at cruising speed, where it eases with speed.

    Parameters
    ----------
    speed_mps : array_like
        Of the robot [m/s]; 0 on the spot.
    cruising_mps : float
        The declared speed [m/s].

    Returns
    -------
    ndarray of float64
        1.5 on the spot, 1 at cruising speed, and less beyond.

    Notes
    -----
    A wheel that rolls while it is pushed sideways slips at a smaller angle, where less than its full friction acts. The
    hyperbola is the simplest curve with that property, and no law.

    References
    ----------
    Dugoff, Fancher & Segel 1970, "An analysis of tire traction properties and their influence on vehicle dynamic
    performance" (the force sideways grows with the angle of slip).
    """
    return np.asarray((HALF_SPEEDS + 1.0) / (HALF_SPEEDS + np.asarray(speed_mps, dtype=np.float64) / cruising_mps))


@dataclass(frozen=True)
class DriveCosts:
    """Costs that were fitted to measured runs together with a network.

    A network answers for driving straight ahead at the robot's declared speed. All costs are zero there.

    Attributes
    ----------
    turn_j_per_rad : float
        Energy of turning that is the same at every speed [J/rad].
    driving_w : float, optional
        Power while the robot moves, beyond its declared idle power [W], for the time that it took more, or less, than
        at its declared speed. None where the time of a segment does not count.
    speed_up_kg : float
        Energy of speeding up over the gain of half the squared speed [J per m^2/s^2].
    mass_kg : float
        Of the robot that drove [kg]. Costs of another robot are in proportion to its mass, but for `driving_w`. 0 where
        it is not known: costs are then those of every robot.
    eased_turn_j_per_rad : float
        Further energy of turning that is less the faster the robot drives, by `easing`; stated at `speed_mps` [J/rad].
    speed_mps : float
        Declared speed of the robot that drove [m/s]; 0 where no turning eases.
    """

    turn_j_per_rad: float = 0.0
    driving_w: float | None = None
    speed_up_kg: float = 0.0
    mass_kg: float = 0.0
    eased_turn_j_per_rad: float = 0.0
    speed_mps: float = 0.0

    def __post_init__(self) -> None:
        numbers = [0.0 if value is None else value for value in asdict(self).values()]
        if not all(isinstance(value, int | float) and math.isfinite(value) for value in numbers):
            raise ModelError(f"the costs of a drive are finite numbers, got {asdict(self)}")
        if self.eased_turn_j_per_rad and self.speed_mps <= 0.0:
            raise ModelError(
                f"turning that costs less at speed needs the speed of the robot that drove, got {self.speed_mps:g} m/s"
            )

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
            return cls(**values)
        except TypeError as error:
            raise ModelError(f"the model has no valid costs of driving: {error}") from error

    def planned_turn_j_per_rad(self, robot: Robot) -> float:
        """Return the energy of turning that a plan counts.

        Parameters
        ----------
        robot : Robot
            Which turns.

        Returns
        -------
        float
            Energy at the robot's declared speed [J/rad].
        """
        return float(self._turn_j_per_rad(robot, robot.speed_mps))

    @property
    def spot_turn_j_per_rad(self) -> float:
        """Energy of turning on the spot of the robot that drove [J/rad]."""
        eased = self.eased_turn_j_per_rad * float(easing(0.0, self.speed_mps)) if self.eased_turn_j_per_rad else 0.0
        return self.turn_j_per_rad + eased

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
        energy = self._turn_j_per_rad(robot, moving_speed_mps(segments)) * segments.turned_abs_rad
        if self.speed_up_kg:
            energy = energy + scale * self.speed_up_kg * segments.gained_m2ps2
        if self.driving_w is not None:
            energy = energy + robot.idle_power_w * (segments.duration_s - segments.driven_m / robot.speed_mps)
            energy = energy + self.driving_w * slower_s(robot, segments)
        return np.asarray(energy, dtype=np.float64)

    def _turn_j_per_rad(self, robot: Robot, speed_mps: ArrayLike) -> FloatArray:
        """Energy at each speed [J/rad]."""
        eased = self.eased_turn_j_per_rad * easing(speed_mps, self.speed_mps) if self.eased_turn_j_per_rad else 0.0
        return np.asarray(self._scale(robot) * (self.turn_j_per_rad + eased))

    def _scale(self, robot: Robot) -> float:
        return robot.mass_kg / self.mass_kg if self.mass_kg else 1.0


def moving_speed_mps(segments: Segments) -> FloatArray:
    """Return the mean speed of segments, short halts left out.

    Parameters
    ----------
    segments : Segments
        Measured.

    Returns
    -------
    ndarray of float64, (n,)
        Speed [m/s]; near 0 where the robot turns on the spot.
    """
    return np.asarray(segments.driven_m / np.maximum(segments.duration_s - segments.standing_s, _LEAST_S))


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
