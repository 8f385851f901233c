"""Units that nothing in a log says: of all combinations the one that contradicts itself least.

A column without a unit may be in several. Ways by positions, by a counted distance and by the speed are one way, power
is voltage times current, and a vehicle drives, starts and draws as vehicles do. A combination of units costs what it
breaks of that. Where a combination with another unit of a column costs hardly more, that unit stays open.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from joulemap.model.ranges import ROBOT
from joulemap.model.runs.agreement import DRIVEN_MPS, MOST_V, air_w, disagreement, most_amps, path_of, plane
from joulemap.model.runs.counters import summed
from joulemap.model.runs.table import FloatArray, spread
from joulemap.model.runs.units import conversion

Units = Mapping[str, str]

ALIKE = 0.2
"""Share by which ways differ by slips and corners, and a power from voltage times current: the unit of costs."""
_WRONG = 5.0  # for what no vehicle does; no disagreement costs more
_UNUSUAL, _CLEAR = 0.5, 0.9
_WINDOW_S = 5.0  # over which a speed is compared with positions that scatter
_STARTED_MPS2 = (0.05, 30.0)  # it starts or brakes faster; rounded speeds seem to jump

FAST_KMPH = 70.0
"""A speed that is above this number is no m/s of a vehicle on the ground."""

UNSAID = {
    "speed": ("m/s", "km/h", "mph"),
    "distance": ("m", "km", "mi", "ft"),
    "voltage": ("V", "mV"),
    "current": ("A", "mA"),
    "power": ("W", "kW", "mW", "PS", "hp"),
}
"""By column, the units that it may be in where nothing says one, the usual one first."""


def fitting(choices: Mapping[str, Sequence[str]], cost: Callable[[Units], float]) -> dict[str, list[str]]:
    """Return of each column the units that cost least, the best first, of those that it may be in."""
    every = [dict(zip(choices, units, strict=True)) for units in product(*choices.values())]
    if len(every) == 1:
        return {key: [unit] for key, unit in every[0].items()}
    costs = [cost(units) for units in every]
    near = sorted((each, k) for k, each in enumerate(costs) if each < min(costs) + _CLEAR)
    return {key: list(dict.fromkeys(every[k][key] for _, k in near)) for key in choices}


def clear(units: Sequence[str], usual: str) -> str:
    """Return the only unit that fits; of several the usual one."""
    return units[0] if len(units) == 1 else usual


def off(a: float, b: float) -> float:
    """Return how far two sizes differ, in tolerances; 0 where one of them says nothing."""
    return min(abs(math.log(a / b)) / ALIKE, _WRONG) if a > 0 and b > 0 else 0.0


@dataclass(frozen=True)
class Movement:
    """What a log says of movement; columns are (n,)."""

    times: Mapping[str, FloatArray]  # stamps [s] by the unit that they may be in
    places: Mapping[str, Mapping[str, FloatArray]]  # columns of positions by their unit; empty without any
    speed: FloatArray | None = None  # in its own unit
    counted: FloatArray | None = None  # a distance from the first row, in its own unit
    _known: dict[tuple[str, str], float] = field(default_factory=dict)

    def cost(self, units: Units) -> float:
        """Return what a combination of units costs."""
        t, known = units["t"], dict[str, float]()
        if self.places:
            known["place"] = self._once("way", units["place"], lambda: path_of(self.places[units["place"]]) or 0.0)
        if self.counted is not None:
            known["distance"] = _factor("distance", units) * float(np.nanmax(self.counted, initial=0.0))
        span, cost = spread(self.times[t]), float(units.get("speed") == "mph")
        for key, way in known.items():
            slow, fast = DRIVEN_MPS
            cost += _WRONG * (not slow * span < way < fast * span)
            cost += _UNUSUAL * (key == "distance" and way > FAST_KMPH / 3.6 * span)
        cost += off(*known.values()) if len(known) > 1 else 0.0
        if self.speed is None:
            return cost
        factor = _factor("speed", units)
        cost += _WRONG * (factor * float(np.nanmax(np.abs(self.speed), initial=0.0)) > FAST_KMPH)
        if self.places:
            cost += off(self.pace(units), factor)
        if self.counted is not None:
            swept = self._once("swept", t, lambda: _last(summed(self.times[t], self._speed())))
            cost += off(known["distance"], factor * swept)
        if len(self.times) > 1:
            slow, fast = _STARTED_MPS2
            started = factor * self._once("started", t, lambda: _acceleration(self.times[t], self._speed()))
            cost += _WRONG * (not slow < started < fast)
        return cost

    def pace(self, units: Units) -> float:
        """Return how many m/s by positions one unit of the speed is; 0 where nothing says so."""
        t, place = units["t"], units["place"]
        return self._once(t, f"pace {place}", lambda: _pace(self.times[t], self._speed(), self.places[place]))

    def _speed(self) -> FloatArray:
        assert self.speed is not None
        return self.speed

    def _once(self, what: str, unit: str, made: Callable[[], float]) -> float:
        if (what, unit) not in self._known:
            self._known[what, unit] = made()
        return self._known[what, unit]


def _factor(key: str, units: Units) -> float:
    return conversion(key, units[key])[0] if units[key] else 1.0


def _last(total: FloatArray) -> float:
    return float(np.nanmax(total, initial=0.0))


def _acceleration(t: FloatArray, speed: FloatArray) -> float:
    """How fast a speed changes at most, but for one in a hundred rows that may be wrong; 0 where it is not known."""
    if (known := np.isfinite(t) & np.isfinite(speed)).sum() < 3:
        return 0.0
    steps = np.diff(t[known])
    return float(np.quantile(np.abs(np.diff(speed[known])[steps > 0] / steps[steps > 0]), 0.99, method="higher"))


def _pace(t: FloatArray, speed: FloatArray, place: Mapping[str, FloatArray]) -> float:
    """Speed by positions over a logged one, over some seconds while the robot moves, because fixes that scatter make a
    longer way; of a few rows that of the whole way.
    """
    x, y, at = plane(place, t)
    known = np.isfinite(t) & np.isfinite(speed)
    if at.size <= 20 or not known.any():
        whole = _last(summed(t, speed))
        return (path_of(place) or 0.0) / whole if whole > 0 else 0.0
    logged = np.interp(at, t[known], np.abs(speed[known]))
    lag = int(np.clip(np.ceil(_WINDOW_S / max(float(np.median(np.diff(at))), 1e-6)), 1, at.size // 4))
    passed = np.maximum(at[lag:] - at[:-lag], 1e-6)
    moving = np.hypot(x[lag:] - x[:-lag], y[lag:] - y[:-lag]) / passed
    total = np.concatenate([[0.0], np.cumsum(0.5 * (logged[1:] + logged[:-1]) * np.diff(at))])
    said = (total[lag:] - total[:-lag]) / passed
    both = (passed > 1e-6) & (said > 0) & (moving > 0.5 * np.quantile(moving, 0.9))
    return float(np.median(moving[both] / said[both])) if both.any() else 0.0


def drawn_cost(columns: Mapping[str, FloatArray], units: Units, speed: FloatArray | None) -> float:
    """Return what a combination of units of voltage, current and power costs. `speed` (n,): [m/s]."""
    at = {key: _factor(key, units) * columns[key] for key in units}
    volts, cost = math.inf, float(sum(unit not in ("", "V", "A", "W", "kW") for unit in units.values()))
    if "voltage" in at and np.isfinite(at["voltage"]).any():
        volts = abs(float(np.nanmedian(at["voltage"])))
        cost += _WRONG * (not ROBOT["nominal_voltage_v"].low <= volts <= MOST_V)
    if "current" in at and (flowing := np.abs(at["current"][np.isfinite(at["current"]) & (at["current"] != 0)])).size:
        cost += _WRONG * (float(np.median(flowing)) > most_amps(volts))
    if "power" in at:
        if {"voltage", "current"} <= at.keys():
            away = disagreement(at["power"], at["voltage"] * at["current"])
            cost += min(away / ALIKE, _WRONG) if math.isfinite(away) else 0.0
        elif speed is not None and (known := np.isfinite(at["power"]) & np.isfinite(speed)).any():
            cost += _WRONG * (abs(float(np.mean(at["power"][known]))) < air_w(speed[known]))
    return cost
