"""A robot: read from TOML, checked once in the constructor, trusted afterwards."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model import ranges
from joulemap.model.battery import Battery as Battery
from joulemap.model.errors import RobotError, nearest_name

GRAVITY_MPS2 = 9.80665
"""Standard gravity of the Earth [m/s2], the default of a robot. Source: CGPM 1901."""


@dataclass(frozen=True)
class Robot:
    """A ground robot. The defaults describe the 4WD robot of Wei & Isler 2022.

    Attributes
    ----------
    name : str
        What the robot is called.
    mass_kg : float
        Mass with everything that is always carried [kg].
    width_m, length_m : float
        Outer size [m].
    wheel_radius_m : float
        Radius of a wheel [m].
    nominal_voltage_v : float
        Nominal voltage of the battery [V].
    speed_mps : float
        Cruising speed [m/s].
    battery_wh : float
        Energy of the full battery [Wh].
    idle_power_w : float
        Power drawn while the robot does not move [W].
    max_grade_deg : float
        Steepest slope along the motion, up and down [deg].
    max_cross_slope_deg : float
        Steepest slope across the motion [deg].
    rolling_resistance : float
        mu of the paper's eq. 5 (dimensionless) as the battery sees it, drivetrain losses included.
    drivetrain_efficiency : float
        Share of the battery's energy that lifts the robot on a climb, 0.1 to 1, gears and motors together; 0 where it
        is not known: `physics` then takes 1, and a network what its robots had.
    regeneration : float
        Share of the energy released on a descent that returns to the battery, 0 to 0.99.
    turn_j_per_rad : float
        Energy of turning by one radian [J/rad].
    tracking_std_m : float
        Standard deviation of how far beside its path the robot drives [m]. Paths keep three times that, at least
        half a cell and at most three, between them and ground that may not be driven; with 0 they keep nothing.
    clearance_m : float
        Least distance between its outline and every obstacle [m].
    centre_ahead_m : float
        How far the middle of its outline lies ahead of the point that follows the route [m], negative behind it.
    min_turning_radius_m : float
        Radius of the tightest curve of that point [m]; 0 for a robot that turns on the spot.
    gravity_mps2 : float
        Gravity where it drives [m/s2]: 1.62 on the Moon, 3.71 on Mars.

    Raises
    ------
    RobotError
        If a value is no number or outside its range.

    References
    ----------
    Wei & Isler 2022, section IV-A: 28.8 V, 0.5 m/s.
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
    drivetrain_efficiency: float = 0.0
    regeneration: float = 0.0
    turn_j_per_rad: float = 0.0
    tracking_std_m: float = 0.1
    clearance_m: float = 0.0
    centre_ahead_m: float = 0.0
    min_turning_radius_m: float = 0.0
    gravity_mps2: float = GRAVITY_MPS2

    def __post_init__(self) -> None:
        for key, allowed in ranges.ROBOT.items():
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, Real):
                raise RobotError(f"robot.{key} is {ranges.short(value)!r}; it must be a number", key=key)
            if value not in allowed:
                raise RobotError(
                    f"robot.{key} is {ranges.short(value)}; it must be {allowed}",
                    key=key,
                    value=ranges.short(value),
                    limit=[allowed.low, allowed.high],
                )
            object.__setattr__(self, key, float(value))
        if 0.0 < self.drivetrain_efficiency < ranges.LEAST_EFFICIENCY:
            raise RobotError(
                f"robot.drivetrain_efficiency is {self.drivetrain_efficiency:g}; it must be from "
                f"{ranges.LEAST_EFFICIENCY:g} to 1, or 0 where it is not known",
                key="drivetrain_efficiency",
                value=self.drivetrain_efficiency,
                limit=ranges.LEAST_EFFICIENCY,
            )
        if not self.name or not isinstance(self.name, str):
            raise RobotError(
                f"robot.name is {ranges.short(self.name)!r}; it must be a text that is not empty", key="name"
            )
        if len(self.name) > ranges.LONGEST_NAME or not re.fullmatch(ranges.NAME_PATTERN, self.name):
            raise RobotError(
                f"robot.name is {self.name[:40]!r} ({len(self.name)} characters); it must be at most "
                f"{ranges.LONGEST_NAME} characters, none of them a control character",
                key="name",
                value=self.name[:80],
                limit=ranges.LONGEST_NAME,
            )

    def __repr__(self) -> str:
        elsewhere = "" if self.gravity_mps2 == GRAVITY_MPS2 else f", under a gravity of {self.gravity_mps2:g} m/s2"
        place = f", its middle {self.centre_ahead_m:g} m ahead" if self.centre_ahead_m else ""
        place += f", {self.clearance_m:g} m clear of obstacles" if self.clearance_m else ""
        place += f", curves of at least {self.min_turning_radius_m:g} m" if self.min_turning_radius_m else ""
        geared = f", drivetrain {self.drivetrain_efficiency:g}" if self.drivetrain_efficiency else ""
        return (
            f"Robot {self.name}: {self.mass_kg:g} kg, {self.width_m:g} m wide, {self.length_m:g} m long{place}, "
            f"wheels of {self.wheel_radius_m:g} m radius, {self.speed_mps:g} m/s, battery {self.battery_wh:g} Wh at "
            f"{self.nominal_voltage_v:g} V, {self.idle_power_w:g} W idle, limits {self.max_grade_deg:g} deg along and "
            f"{self.max_cross_slope_deg:g} deg across the slope, rolling resistance {self.rolling_resistance:g}"
            f"{geared}, regeneration {self.regeneration:g}, turning {self.turn_j_per_rad:g} J/rad, "
            f"{self.tracking_std_m:g} m beside its path{elsewhere}"
        )

    def __new__(cls, *_: Any, **values: Any) -> Robot:
        """Say what an unknown name may have been meant to be, as robot files do."""
        cls._check_names(values)
        return super().__new__(cls)

    @classmethod
    def _check_names(cls, values: Mapping[str, Any]) -> None:
        known = [field.name for field in fields(cls)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            found = [f"robot.{name}: unknown{_hint(name, values[name], known)}" for name in unknown]
            if not all(nearest_name(name, known) or isinstance(values[name], Mapping) for name in unknown):
                found[-1] += f"; known are {', '.join(known)}"
            raise RobotError("; ".join(found), key=unknown[0], keys=unknown)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Robot:
        """Return the robot with these values; what is missing keeps its default.

        Parameters
        ----------
        values : mapping
            Attributes by name.

        Returns
        -------
        Robot
            The robot.

        Raises
        ------
        RobotError
            On an unknown name, and on an impossible value.
        """
        return cls(**values)

    @classmethod
    def from_toml(cls, path: str | Path) -> Robot:
        """Read a robot from a TOML file with its attributes at the top level.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Robot
            The robot; what the file does not say keeps its default.

        Raises
        ------
        RobotError
            If the file cannot be read, or holds an unknown name or an impossible value. The message names file and
            line.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except FileNotFoundError as error:
            raise RobotError(f"there is no robot file {path}", path=str(path)) from error
        except OSError as error:
            raise RobotError(f"robot file {path} cannot be read: {error.strerror}", path=str(path)) from error
        except UnicodeDecodeError as error:
            raise RobotError(f"robot file {path} is no text in UTF-8: {error}", path=str(path)) from error
        try:
            values = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            problem, _, where = str(error).partition(" (at ")
            last = f"line {len(text.splitlines())}, at its end"
            place = f", {last if 'end of document' in where else where.rstrip(')')}" if where else ""
            raise RobotError(f"robot file {path}{place}: {problem}", path=str(path)) from error
        except (ValueError, RecursionError) as error:  # an integer of thousands of digits, thousands of brackets
            raise RobotError(f"robot file {path}: {str(error)[:100]}", path=str(path)) from error
        try:
            return cls.from_mapping(values)
        except RobotError as error:
            place = _lines_of(error.context.get("keys") or [error.context.get("key", "")], text)
            raise RobotError(f"robot file {path}{place}: {error.message}", path=str(path), **error.context) from error

    def as_dict(self) -> dict[str, Any]:
        """Return all attributes by name, as `from_mapping` takes them."""
        return asdict(self)

    @property
    def weight_n(self) -> float:
        """Weight, mass times gravity [N]."""
        return self.mass_kg * self.gravity_mps2

    @property
    def hotel_per_m(self) -> float:
        """Energy per metre of everything but the motion, at cruising speed [J/m]."""
        return self.idle_power_w / self.speed_mps

    def price_per_m(self, traction_per_m: ArrayLike) -> NDArray[np.float64]:
        """Return the energy drawn from the battery per horizontal metre.

        Parameters
        ----------
        traction_per_m : array_like
            Traction demand t: what the motion alone needs [J/m], of any shape.

        Returns
        -------
        ndarray of float64
            Energy [J/m] in the shape of `traction_per_m`.

        Notes
        -----
        hotel + max(t, 0) + regeneration * min(t, 0), with hotel = `hotel_per_m`. Where t is negative the slope pushes
        the robot; the brakes take that energy, except the regenerated share.

        References
        ----------
        Wei & Isler 2022, eq. 5: t = m g (mu + tan theta).
        """
        traction = np.asarray(traction_per_m, dtype=np.float64)
        return self.hotel_per_m + np.maximum(traction, 0.0) + self.regeneration * np.minimum(traction, 0.0)

    @property
    def battery(self) -> Battery:
        """The robot's own battery, full and without a reserve."""
        return Battery(capacity_wh=self.battery_wh)


def _hint(name: str, value: Any, known: Sequence[str]) -> str:
    """What an unknown key may have been meant to be."""
    if isinstance(value, Mapping):
        return f"; the values belong at the top level of the file, so leave out the line [{name}]"
    near = nearest_name(name, known)
    return f"; did you mean {near}?" if near else ""


def _lines_of(keys: Sequence[str], text: str) -> str:
    """Return ", line 3" or ", lines 2 and 3" of a TOML text that gives these keys, in its order; "" for none."""
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        for key in keys:
            if key and re.match(rf"""\s*\[?\s*["']?{re.escape(key)}["']?\s*[=.\]]""", line):
                found.append(str(number))
                break
    if len(keys) == 1 or len(found) == 1:
        return f", line {found[0]}" if found else ""
    return f", lines {', '.join(found[:-1])} and {found[-1]}" if found else ""
