"""What a run is driven in: weather, load, charge and hour, and which of it the log records."""

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
    """A wind with gusts, one entry per second (k,), repeated when a run lasts longer.

    speed_mps >= 0; from_rad : where it comes from, clockwise from north.
    """

    speed_mps: FloatArray
    from_rad: FloatArray

    def __post_init__(self) -> None:
        if self.speed_mps.size == 0 or self.speed_mps.shape != self.from_rad.shape or (self.speed_mps < 0).any():
            raise InputError("a wind needs as many speeds, none below 0, as directions, and at least one")

    @classmethod
    def steady(cls, speed_mps: float, from_rad: float) -> Wind:
        return cls(np.array([float(speed_mps)]), np.array([float(from_rad)]))

    @classmethod
    def gusty(cls, mean_mps: float, from_rad: float, rng: np.random.Generator, *, seconds: int = 1800) -> Wind:
        """Gusts of a quarter of the mean over about 8 s, lulls and swells over a minute, a direction that veers."""
        gusts = 0.22 * smooth_noise(rng, seconds, 4.0) + 0.15 * smooth_noise(rng, seconds, 40.0)
        veer = math.radians(12.0) * smooth_noise(rng, seconds, 15.0)
        return cls(mean_mps * np.maximum(1.0 + gusts, 0.0), from_rad + veer)

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Speed [m/s] and direction it comes from [rad] at seconds t (n,) of the run, straight between the entries."""
        seconds = np.arange(self.speed_mps.size, dtype=np.float64)
        t = np.mod(t, self.speed_mps.size)
        return np.interp(t, seconds, self.speed_mps), np.interp(t, seconds, self.from_rad)


@dataclass(frozen=True)
class Halts:
    """Where a run stands still: for so many `seconds` after each of these `stations` of its path, (k,) both."""

    stations: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    seconds: FloatArray = field(default_factory=lambda: np.zeros(0))

    def waited_s(self, n: int) -> FloatArray:
        """How long the run has stood before it leaves for each of n stations, (n,): a halt delays what comes after."""
        halts = np.zeros(n + 1)
        np.add.at(halts, self.stations + 1, self.seconds)
        return np.cumsum(halts)[:n]


@dataclass(frozen=True)
class Conditions:
    """Of one run. start_s : stamp of its first row, seconds of the log's clock (its days begin at multiples of 86,400).

    driven_m : already driven that day. mean_c, swing_c : the day's temperature; it is coldest at 4 h and warmest at
    16 h. payload_kg : what the log says is carried (`payload_logged`), and what truly is where an effect says so.
    charge : of the battery at the start, 0..1. seed : of what a driver does at random under an effect. halts : while
    the robot stands, wind and day go on.
    """

    start_s: float = 10.0 * 3600.0
    driven_m: float = 0.0
    mean_c: float = 18.0
    swing_c: float = 3.0
    wind: Wind = field(default_factory=lambda: Wind.steady(0.0, 0.0))
    wind_logged: bool = False
    payload_kg: float = 0.0
    payload_logged: bool = True
    charge: float = 0.95
    seed: int = 0
    halts: Halts = field(default_factory=Halts)

    def temperature_c(self, t: FloatArray) -> FloatArray:
        """Of the air [degC] at seconds t (n,) of the run."""
        return self.mean_c - self.swing_c * np.cos((self.start_s + t - 4.0 * 3600.0) * TAU / _DAY_S)

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, start_s: float, driven_m: float, charge: float, day: Day) -> Conditions:
        """Conditions of a run on that day; whatever varies here matters only where an effect makes it matter."""
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
    """Weather of a day in the field: mean temperature and half its range, typical wind, and whether it is logged."""

    mean_c: float
    swing_c: float
    wind_mps: float
    wind_from_rad: float
    wind_logged: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Day:
        return cls(
            mean_c=float(rng.uniform(-2.0, 24.0)),
            swing_c=float(rng.uniform(2.0, 7.0)),
            wind_mps=float(rng.uniform(1.5, 6.0)),
            wind_from_rad=float(rng.uniform(0.0, TAU)),
            wind_logged=bool(rng.random() < 0.5),
        )
