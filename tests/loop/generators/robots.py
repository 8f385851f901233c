"""A random robot: what it truly is, and what its owner declares."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from joulemap.model.robot import Robot
from tests.loop.generators.config import RobotConfig

G_MPS2 = 9.80665
"""Standard gravity [m/s^2]. Source: CGPM 1901."""

DECLARED_KEYS = (
    "name",
    "mass_kg",
    "width_m",
    "length_m",
    "wheel_radius_m",
    "nominal_voltage_v",
    "speed_mps",
    "battery_wh",
    "idle_power_w",
    "max_grade_deg",
    "rolling_resistance",
    "regeneration",
)


@dataclass(frozen=True)
class TrueRobot:
    """What the robot is.

    Attributes
    ----------
    mass_kg : float
        Mass [kg].
    rolling_resistance : float
        Of the ground contact.
    idle_power_w : float
        Power of everything but the motion [W].
    speed_mps : float
        Cruising speed [m/s].
    wheelbase_m : float
        Distance of the axles [m].
    voltage_v : float
        Of the full battery [V].
    efficiency : float
        From the battery to the ground.
    regeneration : float
        Share of the energy of braking that returns to the battery.
    """

    mass_kg: float
    rolling_resistance: float
    idle_power_w: float
    speed_mps: float
    wheelbase_m: float
    voltage_v: float
    efficiency: float
    regeneration: float

    @classmethod
    def drawn(cls, config: RobotConfig, rng: np.random.Generator) -> TrueRobot:
        """Draw a robot."""
        regenerates = rng.random() < 0.5
        share = rng.uniform(*config.regeneration)
        return cls(
            mass_kg=rng.uniform(*config.mass_kg),
            rolling_resistance=rng.uniform(*config.rolling_resistance),
            idle_power_w=rng.uniform(*config.idle_power_w),
            speed_mps=rng.uniform(*config.speed_mps),
            wheelbase_m=rng.uniform(*config.wheelbase_m),
            voltage_v=rng.uniform(*config.voltage_v),
            efficiency=rng.uniform(*config.efficiency),
            regeneration=share if regenerates else 0.0,
        )

    @property
    def rolling_n(self) -> float:
        """Rolling resistance on level ground [N]."""
        return self.rolling_resistance * self.mass_kg * G_MPS2

    def declared(self, config: RobotConfig, rng: np.random.Generator) -> Robot:
        """What the owner writes down: the true values, each wrong by `declared_off` with a random sign.

        The rolling resistance is declared as the battery sees it, so the true one is divided by the efficiency.
        """
        mass, rolling, idle = 1.0 + config.declared_off * rng.choice([-1.0, 1.0], 3)
        return Robot(
            name="unknown-rover",
            mass_kg=round(self.mass_kg * mass, 3),
            width_m=round(0.9 * self.wheelbase_m, 3),
            length_m=round(1.5 * self.wheelbase_m, 3),
            wheel_radius_m=round(0.25 * self.wheelbase_m, 3),
            nominal_voltage_v=round(0.95 * self.voltage_v, 2),
            speed_mps=round(self.speed_mps, 3),
            battery_wh=round(8.0 * self.mass_kg, 1),
            idle_power_w=round(self.idle_power_w * idle, 3),
            max_grade_deg=25.0,
            rolling_resistance=round(self.rolling_resistance / self.efficiency * rolling, 5),
            regeneration=round(self.regeneration, 4),
        )


def write_robot(path: Path, robot: Robot) -> None:
    """Write a declared robot as robot.toml."""
    values = robot.as_dict()
    lines = [f'{k} = "{values[k]}"' if k == "name" else f"{k} = {values[k]}" for k in DECLARED_KEYS]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
