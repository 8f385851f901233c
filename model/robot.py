"""Robot and Battery: read from TOML, checked once, trusted after."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, RobotError

GRAVITY_MPS2 = 9.80665
"""Standard gravity [m/s2]. Source: CGPM 1901."""


@dataclass(frozen=True)
class Robot:
    """A ground robot. The defaults describe the 4WD robot of Wei & Isler 2022 (28.8 V, 0.5 m/s).

    rolling_resistance : mu of the paper's eq. 5 (dimensionless) as the battery sees it, drivetrain losses included.
    regeneration : share of the energy released on a descent that returns to the battery, 0..1 (1 excluded).
    turn_j_per_rad : energy of turning by one radian [J/rad].
    max_grade_deg holds up and down along the motion, max_cross_slope_deg across it.
    """

    name: str = "rover-4wd"
    mass_kg: float = 35.0
    width_m: float = 0.55
    length_m: float = 0.60
    wheel_radius_m: float = 0.127
    nominal_voltage_v: float = 28.8
    speed_mps: float = 0.5
    battery_wh: float = 280.0
    idle_power_w: float = 12.0
    max_grade_deg: float = 25.0
    max_cross_slope_deg: float = 20.0
    rolling_resistance: float = 0.08
    regeneration: float = 0.0
    turn_j_per_rad: float = 0.0

    def __post_init__(self) -> None:
        for key, (low, high, low_ok) in _RANGES.items():
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise RobotError(f"robot: {key} must be a number, got {value!r}", key=key)
            inside = (low <= value if low_ok else low < value) and value <= high
            if not (math.isfinite(value) and inside):
                raise RobotError(
                    f"robot: {key} = {value} is outside {'[' if low_ok else '('}{low:g}, {high:g}]",
                    key=key,
                    value=str(value),
                    limit=[low, high],
                )
            object.__setattr__(self, key, float(value))
        if not self.name or not isinstance(self.name, str):
            raise RobotError(f"robot: name must be a non-empty text, got {self.name!r}", key="name")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Robot:
        """A robot from a mapping of its fields; missing ones keep their defaults. Raises RobotError on unknown keys."""
        known = {f.name for f in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise RobotError(f"robot: unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}", keys=unknown)
        return cls(**values)

    @classmethod
    def from_toml(cls, path: str | Path) -> Robot:
        """A robot from a TOML file with the fields above at its top level."""
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise RobotError(f"robot file {path}: {error}", path=str(path)) from error
        return cls.from_mapping(values)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @property
    def weight_n(self) -> float:
        """m g [N]."""
        return self.mass_kg * GRAVITY_MPS2

    @property
    def hotel_per_m(self) -> float:
        """Energy per metre of everything but the motion, at cruising speed [J/m]."""
        return self.idle_power_w / self.speed_mps

    def price_per_m(self, traction_per_m: ArrayLike) -> NDArray[np.float64]:
        """Energy drawn from the battery per horizontal metre [J/m], from the traction demand [J/m] (any shape).

        Traction is what motion alone asks for: m g (mu + tan theta) in the paper's eq. 5. Where it is negative the
        ground pushes the robot: the brakes take it, but for the regenerated share. The hotel load comes on top:
        hotel + max(t, 0) + regeneration * min(t, 0).
        """
        traction = np.asarray(traction_per_m, dtype=np.float64)
        return self.hotel_per_m + np.maximum(traction, 0.0) + self.regeneration * np.minimum(traction, 0.0)

    @property
    def battery(self) -> Battery:
        """The robot's own battery, full and without a reserve."""
        return Battery(capacity_wh=self.battery_wh)


_RANGES = {  # key: (low, high, is low allowed)
    "mass_kg": (0.0, 1e5, False),
    "width_m": (0.0, 10.0, False),
    "length_m": (0.0, 20.0, False),
    "wheel_radius_m": (0.0, 3.0, False),
    "nominal_voltage_v": (0.0, 2000.0, False),
    "speed_mps": (0.0, 20.0, False),
    "battery_wh": (0.0, 1e6, False),
    "idle_power_w": (0.0, 1e5, True),
    "max_grade_deg": (0.0, 60.0, False),
    "max_cross_slope_deg": (0.0, 60.0, False),
    "rolling_resistance": (0.0, 2.0, True),
    "regeneration": (0.0, 0.99, True),
    "turn_j_per_rad": (0.0, 1e5, True),
}


@dataclass(frozen=True)
class Battery:
    """A battery in the words of a verdict.

    capacity_wh : energy when full [Wh]; charge : state of charge now, 0..1; reserve : share of the capacity that must
    remain at the end, 0..1.
    """

    capacity_wh: float
    charge: float = 1.0
    reserve: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.capacity_wh) and self.capacity_wh > 0):
            raise InputError(f"battery: capacity_wh must be positive, got {self.capacity_wh}", key="capacity_wh")
        for key in ("charge", "reserve"):
            value = getattr(self, key)
            if not (math.isfinite(value) and 0.0 <= value <= 1.0):
                raise InputError(f"battery: {key} must lie in 0..1, got {value}", key=key, value=str(value))

    @property
    def available_j(self) -> float:
        """Energy above the reserve [J]; negative when the charge is already below it."""
        return (self.charge - self.reserve) * self.capacity_wh * 3600.0
