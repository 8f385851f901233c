"""How well an owner knows what a robot's file declares: the prior of everything that measured runs correct."""

from __future__ import annotations

from joulemap.model.robot import Robot

_SHARE = 0.3
"""Setting: of the energy of motion, by which the efficiency of drives and the weight are usually off."""
_LEAST_ROLLING = 0.05
"""Setting: the rolling resistance of firm ground, where a smaller one or none is declared."""


def declared_spread(robot: Robot) -> dict[str, float]:
    """Return the standard deviation by which the truth differs from what is declared.

    Parameters
    ----------
    robot : Robot
        As its file declares it.

    Returns
    -------
    dict of str to float
        Of the `rolling_resistance`; of the `energy_of_motion`, of what is lost of the energy of `descents` and of the
        weight of the `measured_slope`, as shares; of the `idle_power_w` and the `driving_power` [W]; and of the energy
        of `speeding_up` and `slowing_down`, over the kinetic energy.

    Notes
    -----
    They are as wide as what is declared is large, or wider: they decide only what the runs do not show.
    """
    rolling = max(robot.rolling_resistance, _LEAST_ROLLING)
    usual_w = robot.weight_n * robot.speed_mps * rolling + robot.idle_power_w
    return {
        "rolling_resistance": rolling,
        "energy_of_motion": _SHARE,
        "descents": 1.0,
        "measured_slope": 1.0,
        "idle_power_w": max(usual_w, 1.0),
        "driving_power": max(usual_w, 1.0),
        "speeding_up": 1.0,
        "slowing_down": 1.0,
    }
