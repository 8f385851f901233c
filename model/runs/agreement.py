"""Units that a log does not say, from what its columns say of each other: stamps, speeds, distances and positions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from joulemap.model.frames import wrap_angle
from joulemap.model.runs.table import FloatArray, known_values
from joulemap.model.runs.units import UNITS

_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Stamps since 1970 in these units are larger than these numbers between 1973 and the year 5000."""
_CENTURY_S = (946_684_800.0, 4_102_444_800.0)  # 2000 to 2100
_SERIAL_DAYS = (20_000.0, 80_000.0)  # dates of spreadsheets from 1954 to 2119
_SHORTEST_STEP_S = 1e-3  # no log of a vehicle is written more often
_STEPS = 100_000  # between rows, evenly spread, of which the median is taken
_EARTH_M = 6_371_000.0
_DEGREES = 0.1  # a drive of 10 km spans less of both
_CONFUSED = (3.6, 1.0 / 0.44704, 1.609344, 1000.0)  # m/s with km/h or mph, km with miles, m with km
_RATIO = 0.05
_LEAST_DRAG_M2 = 0.1

DRIVEN_MPS = (0.02, 70.0)
"""Of the path of a vehicle that drives."""

MOST_V = 2000.0
"""No pack of a vehicle has more."""

MOST_A = 1_000.0
"""More than the packs of electric lorries give for long."""

LEAST_LOAD_OHM = 0.05
"""A smaller load is as small as the inner resistance of a battery pack and its cables: no pack drives it for long."""


def epoch_of(values: FloatArray) -> str:
    """Return the unit of stamps that are milliseconds or less since 1970, all of this century; empty for any other."""
    known = known_values(values)
    if known.size < 2:
        return ""
    low, high = float(known.min()), float(known.max())
    first, last = _CENTURY_S
    units = (unit for _, unit in _EPOCHS)
    return next((u for u in units if first <= low * UNITS["time"][u][0] and high * UNITS["time"][u][0] <= last), "")


def units_of_stamps(values: FloatArray) -> list[str]:
    """Return the units that stamps without one may be in, the usual one first; `values` is (n,)."""
    known = known_values(values)
    if known.size < 2:
        return ["s"]
    largest = float(np.abs(known).max())
    if epoch := next((word for least, word in _EPOCHS if largest > least), ""):
        return [epoch]
    row = np.arange(0, known.size - 1, max(known.size // _STEPS, 1))
    steps = np.abs(known[row + 1] - known[row])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    of_day = largest < 240_000.0 and step <= 30.0 and np.ptp(known) > 100.0
    if of_day and (known % 100.0 < 60.0).all() and (known // 100.0 % 100.0 < 60.0).all():
        return ["hhmmss"]  # no two digits of it reach 60
    low, high = _SERIAL_DAYS
    if low < known.min() and largest < high and 0 < step < _SHORTEST_STEP_S:
        return ["d"]
    if step < 10.0 or (known != np.round(known)).any():
        return ["s"]
    return [unit for unit in ("s", "ms", "us") if step * UNITS["time"][unit][0] >= _SHORTEST_STEP_S]


def most_amps(volts: float) -> float:
    """Return the largest current that a battery of so many volts gives for long [A]."""
    return min(MOST_A, volts / LEAST_LOAD_OHM)


def of_clock(values: FloatArray) -> FloatArray:
    """Return seconds since midnight of numbers such as 142005.25, which are 14 h, 20 min and 5.25 s.

    `values` and the result are (n,).
    """
    return values - 40.0 * (values // 100.0) - 2400.0 * (values // 10_000.0)


def degrees_unit(target: str, values: FloatArray, column: str) -> str:
    """Return the unit of latitudes or longitudes that are no degrees.

    `values` is (n,). Result: `degE7` for whole numbers of 1e-7 degrees, `semicircles` for
    those of FIT, `ddmm` for degrees and minutes as NMEA writes
    them; else empty.
    """
    known = np.abs(values[np.isfinite(values) & (values != 0)])
    most = 90.0 if target == "lat" else 180.0
    if not known.size or np.median(known) <= most:
        return ""
    if np.median(known) > 1e6 and (known == np.round(known)).all():
        of_fit = column.lower() in ("position_lat", "position_long")  # as the profile of FIT calls its semicircles
        return "semicircles" if of_fit or known.max() > most * 1e7 else "degE7"
    if known.max() <= 100.0 * most + 60.0 and (known % 100.0 < 60.0).all() and (known != np.round(known)).any():
        return "ddmm"
    return ""


def in_degrees(x: FloatArray, y: FloatArray) -> bool:
    """Return whether positions are a longitude and a latitude rather than metres.

    `x`, `y` (n,): NaN where unknown.
    """
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return False
    x, y = x[known], y[known]
    small = np.ptp(x) < _DEGREES and np.ptp(y) < _DEGREES and (np.ptp(x) > 0 or np.ptp(y) > 0)
    return bool(small and np.abs(x).max() <= 180 and np.abs(y).max() <= 90 and np.abs(y).min() > 0.5)


def of_minutes(values: FloatArray) -> FloatArray:
    """Return degrees of numbers such as 3608.09412, which are 36 degrees and 8.09412 minutes.

    `values` (n,): as NMEA writes them. The result is (n,).
    """
    whole = np.floor(np.abs(values) / 100.0)
    return np.sign(values) * (whole + (np.abs(values) - 100.0 * whole) / 60.0)


def path_of(numbers: Mapping[str, FloatArray]) -> float | None:
    """Return how long the way between positions is, roughly.

    `numbers` (n,): columns, of which `x` and `y` [m], or `lat` and `lon` [deg] are used. Result: in metres, between
    about a hundred of them, at distances of at least the noise of a receiver; None without any.
    """
    x, y, _ = plane(numbers)
    if x.size < 2:
        return None
    step = max(1, x.size // 200)
    return float(np.hypot(np.diff(x[::step]), np.diff(y[::step])).sum())


def speed_of(t: FloatArray, numbers: Mapping[str, FloatArray]) -> FloatArray | None:
    """Return the speed [m/s] by a distance or by positions, (n,); None without both. `t` (n,): rising stamps [s]."""
    if "distance" in numbers:
        return np.abs(np.gradient(numbers["distance"], t))
    x, y, at = plane(numbers, t)
    if at.size < 2:
        return None
    return np.interp(t, at, np.hypot(np.gradient(x, at), np.gradient(y, at)))


def plane(numbers: Mapping[str, FloatArray], t: FloatArray | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the known positions in metres, and their stamps; empty without any."""
    if {"x", "y"} <= numbers.keys():
        x, y = numbers["x"], numbers["y"]
    elif {"lat", "lon"} <= numbers.keys():
        lat, lon = np.radians(numbers["lat"]), np.radians(numbers["lon"])
        middle = float(np.nanmedian(lat)) if np.isfinite(lat).any() else 0.0
        x, y = _EARTH_M * np.cos(middle) * lon, _EARTH_M * lat
    else:
        return (np.empty(0),) * 3
    t = np.zeros(x.size) if t is None else t
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(t)
    return x[known], y[known], t[known]


def contradiction(one: float, other: float) -> str:
    """Return how many times a way or a speed is another one, where that is the ratio of two units.

    Result: such as `3.6`; empty where they agree, or differ otherwise.
    """
    if one <= 0 or other <= 0:
        return ""
    near = [each for each in _CONFUSED if abs(abs(np.log(one / other)) - np.log(each)) < _RATIO]
    return f"{one / other:.3g}" if near else ""


def air_w(speed: FloatArray) -> float:
    """Return what the air takes at least [W]: rho c_w A v^3 / 2. `speed` (n,): [m/s].

    rho is 1.2 kg/m3, and c_w A at least 0.1 m2, less than that of the best enclosed bicycles and solar cars.
    """
    return 0.5 * 1.2 * _LEAST_DRAG_M2 * float(np.mean(np.abs(speed) ** 3))


def drives_nothing(power: FloatArray, speed: FloatArray) -> bool:
    """Return whether a power at rest is as large as while driving, but for less than the air takes: it is another
    number, such as the voltage of a tracker's supply.

    `power` (n,): [W]; `speed` (n,): at the same rows [m/s].
    """
    known = np.isfinite(power) & np.isfinite(speed)
    rest, drive = (known & side for side in (np.abs(speed) < DRIVEN_MPS[0], np.abs(speed) >= DRIVEN_MPS[0]))
    if not rest.any() or not drive.any():
        return False
    return abs(float(np.mean(power[drive]) - np.mean(power[rest]))) < air_w(speed[drive])


def compass(t: FloatArray, angle: FloatArray, numbers: Mapping[str, FloatArray]) -> tuple[FloatArray, str] | None:
    """Return a heading of which neither unit nor direction is known, where it agrees with the way.

    `t` (n,): stamps [s]; `angle` (n,); `numbers` (n,): columns with positions. Result: degrees clockwise from north,
    and the reading in words; None where no reading agrees within a quarter radian.
    """
    x, y, _ = plane(numbers, np.where(np.isfinite(angle), t, np.nan))
    if x.size < 20:
        return None
    lag = max(1, x.size // 100)
    dx, dy = x[lag:] - x[:-lag], y[lag:] - y[:-lag]
    far = np.hypot(dx, dy) > 0.5 * float(np.median(np.hypot(dx, dy)))
    at = plane(numbers, np.where(np.isfinite(t), angle, np.nan))[2]
    middle = at[lag // 2 : lag // 2 + dx.size]
    way = np.arctan2(dx, dy)
    best = None
    for unit, factor in (("deg", np.pi / 180.0), ("rad", 1.0)):
        for words, turn, zero in (("clockwise from north", 1.0, 0.0), ("anticlockwise from east", -1.0, np.pi / 2)):
            off = wrap_angle(zero + turn * factor * middle - way)
            size = float(np.median(np.abs(off[far]))) if far.any() else np.inf
            if best is None or size < best[0]:
                best = (size, np.degrees(zero + turn * factor * angle) % 360.0, f"{unit}, {words}")
    return (best[1], best[2]) if best is not None and best[0] < 0.25 else None


def disagreement(a: FloatArray, b: FloatArray) -> float:
    """Return by which share two quantities differ in the median, whatever their signs; infinite where neither flows.

    `a`, `b` (n,): NaN where unknown.
    """
    a, b = np.abs(a), np.abs(b)
    both = np.isfinite(a) & np.isfinite(b)
    both &= np.maximum(a, b) > 0.1 * max(float(np.quantile(b[both], 0.9)), 1e-12) if both.any() else both
    return float(np.median(np.abs(a[both] - b[both]) / np.maximum(a[both], b[both]))) if both.any() else np.inf
