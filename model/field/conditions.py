"""The conditions of a run: weather, load, charge and hour, and which of them the log records."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.field.drives import smooth_noise
from joulemap.model.frames import TAU

FloatArray = NDArray[np.float64]

_DAY_S = 86400.0


@dataclass(frozen=True)
class Wind:
    """A wind with gusts, one entry per second, repeated when a run lasts longer."""

    speed_mps: FloatArray  # (k,): Speed, not negative [m/s]
    from_rad: FloatArray  # (k,): Where the wind comes from, clockwise from north [rad]

    def __post_init__(self) -> None:
        if self.speed_mps.size == 0 or self.speed_mps.shape != self.from_rad.shape or (self.speed_mps < 0).any():
            raise InputError("a wind needs as many speeds, none below 0, as directions, and at least one")

    @classmethod
    def steady(cls, speed_mps: float, from_rad: float) -> Wind:
        """Return a wind without gusts. `from_rad`: where it comes from, clockwise from north [rad]."""
        return cls(np.array([float(speed_mps)]), np.array([float(from_rad)]))

    @classmethod
    def gusty(cls, mean_mps: float, from_rad: float, rng: np.random.Generator, *, seconds: int = 1800) -> Wind:
        """Draw a wind with gusts, slower changes and a veering direction.

        Gusts of about a quarter of the mean last about 8 s, slower changes about a minute.
        """
        gusts = 0.22 * smooth_noise(rng, seconds, 4.0) + 0.15 * smooth_noise(rng, seconds, 40.0)
        veer = math.radians(12.0) * smooth_noise(rng, seconds, 15.0)
        return cls(mean_mps * np.maximum(1.0 + gusts, 0.0), from_rad + veer)

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the wind at times of the run, linear between the entries.

        `t` (n,): time since the start of the run [s]. Result (n,): speed [m/s], and the direction from which it comes
        [rad].
        """
        seconds = np.arange(self.speed_mps.size, dtype=np.float64)
        t = np.mod(t, self.speed_mps.size)
        return np.interp(t, seconds, self.speed_mps), np.interp(t, seconds, self.from_rad)


@dataclass(frozen=True)
class Halts:
    """Where a run halts, and for how long."""

    # (k,): Stations of the path after which the robot halts
    stations: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    seconds: FloatArray = field(default_factory=lambda: np.zeros(0))  # (k,): How long it halts there [s]

    def waited_s(self, n: int) -> FloatArray:
        """Return how long the robot has halted before each station; a halt delays everything after it.

        Result (n,): time spent in halts so far [s].
        """
        halts = np.zeros(n + 1)
        np.add.at(halts, self.stations + 1, self.seconds)
        return np.cumsum(halts)[:n]


@dataclass(frozen=True)
class Conditions:
    """The conditions of one run."""

    # Time stamp of the first row on the log's clock, whose days begin at multiples of 86,400 [s]
    start_s: float = 10.0 * 3600.0
    driven_m: float = 0.0  # Distance already driven that day [m]
    # Mean temperature of the day and half its range [degC]; it is coldest at 4 h and warmest at 16 h
    mean_c: float = 18.0
    swing_c: float = 3.0
    wind: Wind = field(default_factory=lambda: Wind.steady(0.0, 0.0))  # The wind
    wind_logged: bool = False  # Whether the log records it
    payload_kg: float = 0.0  # Payload that the log states [kg]; it has mass only under the effect `Payload`
    payload_logged: bool = True  # Whether the log records it
    charge: float = 0.95  # State of charge at the start, 0 to 1
    seed: int = 0  # Seed of what a driver does at random under an effect
    halts: Halts = field(default_factory=Halts)  # Where the robot halts. Wind and day continue meanwhile.

    def temperature_c(self, t: FloatArray) -> FloatArray:
        """Return the temperature of the air.

        `t` (n,): time since the start of the run [s]. Result (n,): temperature [degC].
        """
        return self.mean_c - self.swing_c * np.cos((self.start_s + t - 4.0 * 3600.0) * TAU / _DAY_S)

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, start_s: float, driven_m: float, charge: float, day: Day) -> Conditions:
        """Draw the conditions of a run on a day; what varies here matters only where an effect depends on it."""
        mean_mps = day.wind_mps * math.exp(0.25 * rng.standard_normal())
        wind = Wind.gusty(mean_mps, day.wind_from_rad + 0.35 * rng.standard_normal(), rng)
        return cls(
            start_s=start_s,
            driven_m=driven_m,
            mean_c=day.mean_c,
            swing_c=day.swing_c,
            wind=wind,
            wind_logged=day.wind_logged,
            payload_kg=float(rng.integers(0, 4)),
            charge=charge,
            seed=int(rng.integers(2**31)),
        )


@dataclass(frozen=True)
class Day:
    """Weather of a day in the field."""

    mean_c: float  # Mean temperature and half its range [degC]
    swing_c: float
    wind_mps: float  # Typical speed of the wind [m/s]
    wind_from_rad: float  # Typical direction from which it comes [rad]
    wind_logged: bool  # Whether the logs of this day record it

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Day:
        """Draw the weather of a day."""
        return cls(
            mean_c=float(rng.uniform(-2.0, 24.0)),
            swing_c=float(rng.uniform(2.0, 7.0)),
            wind_mps=float(rng.uniform(1.5, 6.0)),
            wind_from_rad=float(rng.uniform(0.0, TAU)),
            wind_logged=bool(rng.random() < 0.5),
        )
