"""The simulated robot and its ground: what the owner declares, and the hidden numbers that nobody measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import RobotError
from joulemap.model.robot import GRAVITY_MPS2, Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class FieldRobot:
    """The robot as it truly is: what the owner declares, and what nobody measured."""

    declared: Robot  # What the owner's file says
    mass_kg: float  # True mass [kg]
    wheelbase_m: float  # Distance between wheel centres, along and across [m]
    track_m: float
    wheel_width_m: float  # Width of the contact of a wheel [m]
    com_height_m: float  # Height of the centre of mass above the ground [m]
    twist_n_per_m: float  # Load moved to a wheel per metre of twist [N/m]
    friction_factor: float = 1.0  # True rolling loss of this robot's tyres over the ground's own
    gear_efficiency: float = 0.8  # Efficiency of the gears, 0 to 1
    drag_n: float = 4.0  # Constant friction of the drivetrain, both sides together, at the ground [N]
    copper_w_per_n2: float = 0.0008  # Copper loss per squared force of a side [W/N2]
    idle_w: float = 12.0  # Power of the electronics [W]
    lateral_grip: float = 5.0  # Side force of the tyres per radian of slip and newton of load
    lag_m: float = 0.12  # Distance over which wheels, chassis and speed controller smooth the force [m]
    regeneration: float = 0.0  # Share of the power pushed back that returns to the battery, 0 to 1

    def __post_init__(self) -> None:
        for key in ("mass_kg", "wheelbase_m", "track_m", "lateral_grip", "gear_efficiency"):
            value = getattr(self, key)
            if not (math.isfinite(value) and value > 0):
                raise RobotError(f"simulated robot: {key} must be a positive number, got {value}", key=key)
        if self.gear_efficiency > 1.0:
            raise RobotError(
                f"simulated robot: gear_efficiency {self.gear_efficiency} is above 1", key="gear_efficiency"
            )

    @classmethod
    def nominal(cls, declared: Robot) -> FieldRobot:
        """Return the robot whose hidden parameters are the usual ones."""
        weight = declared.weight_n
        return cls(
            declared=declared,
            mass_kg=declared.mass_kg,
            wheelbase_m=0.64 * declared.length_m,
            track_m=0.80 * declared.width_m,
            wheel_width_m=0.15 * declared.width_m,
            com_height_m=declared.wheel_radius_m + 0.10 * declared.length_m,
            twist_n_per_m=5.0 * weight,
            drag_n=0.010 * weight,
            copper_w_per_n2=1.4 * declared.speed_mps / weight,
            idle_w=declared.idle_power_w,
            regeneration=declared.regeneration,
        )

    @classmethod
    def drawn(cls, declared: Robot, rng: np.random.Generator) -> FieldRobot:
        """Draw a robot whose hidden parameters lie around those of `nominal`."""
        base = cls.nominal(declared)

        def _spread(value: float, share: float) -> float:
            return float(value * math.exp(share * rng.standard_normal()))

        return replace(
            base,
            mass_kg=_spread(base.mass_kg, 0.02),
            wheelbase_m=_spread(base.wheelbase_m, 0.06),
            track_m=_spread(base.track_m, 0.04),
            wheel_width_m=_spread(base.wheel_width_m, 0.2),
            com_height_m=_spread(base.com_height_m, 0.15),
            twist_n_per_m=_spread(base.twist_n_per_m, 0.4),
            friction_factor=_spread(1.0, 0.10),
            gear_efficiency=float(np.clip(base.gear_efficiency + 0.05 * rng.standard_normal(), 0.6, 0.95)),
            drag_n=_spread(base.drag_n, 0.3),
            copper_w_per_n2=_spread(base.copper_w_per_n2, 0.3),
            idle_w=_spread(base.idle_w, 0.04),
            lateral_grip=_spread(base.lateral_grip, 0.25),
            lag_m=_spread(base.lag_m, 0.2),
        )

    @classmethod
    def random(cls, rng: np.random.Generator) -> FieldRobot:
        """Draw any robot of 12 to 130 kg, hidden parameters included, for pre-training."""
        mass = float(np.clip(35.0 * math.exp(0.6 * rng.standard_normal()), 12.0, 130.0))
        size = (mass / 35.0) ** (1.0 / 3.0)
        length = 0.60 * size * math.exp(0.15 * rng.standard_normal())
        width = length * float(rng.uniform(0.7, 1.0))
        declared = Robot(
            name="simulated",
            mass_kg=mass,
            length_m=length,
            width_m=width,
            wheel_radius_m=length * float(rng.uniform(0.15, 0.27)),
            speed_mps=float(rng.uniform(0.3, 1.0)),
            battery_wh=8.0 * mass,
            idle_power_w=float(rng.uniform(0.15, 0.5)) * mass,
        )
        return cls.drawn(declared, rng)

    def kernel_parameters(self) -> FloatArray:
        """Return the numbers that the compiled kernels read, in their order, (15,)."""
        return np.array(
            [
                self.mass_kg * GRAVITY_MPS2,
                self.mass_kg,
                self.wheelbase_m,
                self.track_m,
                self.wheel_width_m,
                self.declared.wheel_radius_m,
                self.com_height_m,
                self.twist_n_per_m,
                self.friction_factor,
                self.lateral_grip,
                self.lag_m,
                self.gear_efficiency,
                self.drag_n,
                self.copper_w_per_n2,
                self.regeneration,
            ]
        )


@dataclass(frozen=True)
class Ground:
    """What the ground is made of."""

    name: str = "grass"  # What the operator calls it
    mu: float = 0.065  # Rolling loss over load, at a quarter of the robot's weight per wheel
    load_exponent: float = 0.25  # How much faster than the load the loss grows
    # Share of the lifted energy that a wheel loses when it climbs relative to the chassis and drops again
    bump_loss: float = 0.9
    bump_speed_mps: float = 1.0  # Speed at which that loss has doubled [m/s]
    scrub: float = 0.12  # Side friction of the tyres in turns
    # Rolling loss added where the ground is lower than around it (softer and wetter), per 0.1 m of negative
    # topographic position index
    tpi_share: float = 0.30
    patchiness: float = 0.02  # Spread of mu from place to place, over about 6 m, that does not follow from any height
    spread: float = 0.12  # Multiplicative spread of the power at the wheels that does not follow from anything known
    spread_length_m: float = 1.0  # Correlation length of that spread [m]
    tussock_m: float = 0.006  # Root mean square of the relief that is finer than a survey measures [m]

    def kernel_parameters(self) -> FloatArray:
        """Return the numbers that the compiled kernels read, in their order, (6,)."""
        return np.array([self.mu, self.load_exponent, self.bump_loss, self.bump_speed_mps, self.scrub, 0.4])
