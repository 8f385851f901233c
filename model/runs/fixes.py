"""Positions of a log: from its columns to world x and y, and which of the fixes are used."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, RunsError
from joulemap.model.runs.table import LEAST_ROWS, add_count, columns_there

if TYPE_CHECKING:
    from pyproj import CRS

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LONGEST_JUMP_S = 5.0
_LEAST_GPS_LIMIT_M = 0.05
_LONGEST_HOLD_S = 1.5
_LEAST_E7 = 1e6  # a tenth of a degree in 1e-7 degrees
_PAIRS = (("x", "y"), ("lat", "lon"))
_GREATEST_DEG = {"lat": 90.0, "lon": 360.0}  # a longitude may count from 0 to 360 or from -180 to 180


def positions(numbers: dict[str, FloatArray], *, name: str, crs: str | None) -> tuple[FloatArray, FloatArray]:
    """Return the positions as recorded, and take the columns `x` and `y` out of `numbers`.

    `numbers` (n,): columns of a log. Result (n,): x, y [m], NaN where a row has none, or one that does not exist on
    Earth.
    """
    if "x" in numbers and "y" in numbers:
        return numbers.pop("x"), numbers.pop("y")
    if "lat" not in numbers or "lon" not in numbers:
        wheels = {"speed_left", "speed_right"} <= numbers.keys()
        hint = (
            "say the unit of its wheel speeds, and which counts backward, with a mapping, like speed_left=velL:m/s,"
            "speed_right=-velR:m/s; `odometry` with the track in metres integrates them to a way"
            if wheels
            else "a mapping says which they are, like speed=v:km/h or lat=latitude,lon=longitude"
        )
        half = next(((one, other) for one, other in _PAIRS if (one in numbers) != (other in numbers)), None)
        lack = "neither 'x' and 'y' nor 'lat' and 'lon', nor a speed or a distance"
        if half is not None:
            there, missing = half if half[0] in numbers else half[::-1]
            lack = f"a position {there!r} and no {missing!r}"
        raise RunsError.of_run(name, f"there is {lack}{columns_there(numbers)}; {hint}", column="x")
    lat, lon = numbers["lat"], numbers["lon"]
    if crs is None:
        zone = _zone_of(lat, lon)
        advice = f": give `crs`, such as {zone}, the UTM zone of these positions" if zone else ""
        raise RunsError.of_run(name, f"'lat' and 'lon' need the heightmap's CRS{advice}", column="lat")
    written = np.isfinite(lat) & np.isfinite(lon)
    known = written & _on_earth(lat, lon)
    if known.sum() < 0.5 * written.sum():
        raise _not_on_earth(lat[written], lon[written], name)
    x, y = np.full((2, lat.size), np.nan)
    x[known], y[known] = projected(lat[known], lon[known], crs)
    swapped = _belongs_to(lon[known], lat[known], crs) and not _belongs_to(lat[known], lon[known], crs)
    if written.any() and (swapped or not np.isfinite(x).any()):
        hint = "; with 'lat' and 'lon' exchanged they would lie in it" if swapped else ""
        raise RunsError.of_run(
            name,
            f"its positions, 'lat' {_range(lat[known])} and 'lon' {_range(lon[known])}, lie outside the "
            f"area of the heightmap's CRS {crs[:80]}{hint}",
            column="lat",
            crs=crs,
        )
    return x, y


def projected(lat: FloatArray, lon: FloatArray, crs: str) -> tuple[FloatArray, FloatArray]:
    """Return world coordinates of positions in degrees.

    `lat`, `lon` (n,): WGS 84 [deg]. Result (n,): x, y [m], NaN for a position that the CRS cannot express.
    """
    from pyproj.exceptions import ProjError

    from joulemap.model.terrain.crs_text import transformer

    try:
        x, y = transformer("EPSG:4326", _crs(crs)).transform(lon, lat)
    except ProjError as error:
        raise RunsError(
            f"latitudes and longitudes cannot be projected to the CRS {crs[:80]!r}: {str(error)[:200]}", crs=crs[:80]
        ) from error
    placed = np.isfinite(x) & np.isfinite(y)
    return np.where(placed, x, np.nan), np.where(placed, y, np.nan)


def _crs(crs: str) -> CRS:
    from joulemap.model.terrain.crs_text import proj_crs

    try:
        return proj_crs(crs)
    except HeightmapError as error:
        raise RunsError(str(error), crs=crs[:80]) from error


def _belongs_to(lat: FloatArray, lon: FloatArray, crs: str) -> bool:
    """Whether any of these positions [deg] lies in the area that the CRS is made for; True where that is not known."""
    area = _crs(crs).area_of_use
    if area is None:
        return True
    west, south, east, north = area.bounds  # may cross the 180th meridian
    width = (east - west) % 360.0 or 360.0
    return bool(((lat >= south) & (lat <= north) & ((lon - west) % 360.0 <= width)).any())


def _zone_of(lat: FloatArray, lon: FloatArray) -> str | None:
    """The UTM zone of positions, None where there is none."""
    from joulemap.model.terrain.coordinate_systems import utm_zone

    known = np.isfinite(lat) & np.isfinite(lon) & _on_earth(lat, lon)
    if not known.any():
        return None
    return utm_zone((float(np.median(lon[known])) + 180.0) % 360.0 - 180.0, float(np.median(lat[known])))


def _on_earth(lat: FloatArray, lon: FloatArray) -> BoolArray:
    return np.asarray((np.abs(lat) <= _GREATEST_DEG["lat"]) & (np.abs(lon) <= _GREATEST_DEG["lon"]))


def _not_on_earth(lat: FloatArray, lon: FloatArray, name: str) -> RunsError:
    column, values = ("lat", lat) if (np.abs(lat) > _GREATEST_DEG["lat"]).any() else ("lon", lon)
    most = _GREATEST_DEG[column]
    hint = "; with 'lat' and 'lon' exchanged all positions would lie on Earth" if _on_earth(lon, lat).all() else ""
    if not hint and np.abs(values).max() > _LEAST_E7 and _on_earth(1e-7 * lat, 1e-7 * lon).all():
        hint = "; in 1e-7 degrees they would lie on Earth: a mapping says so, lat=lat:degE7,lon=lon:degE7"
    return RunsError.of_run(
        name,
        f", column {column!r}: its values are {_range(values)}, but degrees of {column} lie within "
        f"{-most:g}..{most:g}{hint}",
        column=column,
        lowest=float(values.min()),
        highest=float(values.max()),
    )


def _range(values: FloatArray) -> str:
    low, high = f"{values.min():g}", f"{values.max():g}"
    return low if low == high else f"{low}..{high}"


def usable_fixes(
    t: FloatArray, x: FloatArray, y: FloatArray, gps_error: FloatArray | None, repairs: dict[str, int]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Apply the fourth rule of `joulemap.model.runs.reader`: which fixes are used.

    `t`, `x`, `y` (n,): stamps [s] and positions [m], NaN where there is none; `gps_error` (n,): as the receiver reports
    it [m]. Result: x, y [m], NaN where a fix is not used; and of bool, True where the track breaks.
    """
    good = np.isfinite(x) & np.isfinite(y)
    add_count(repairs, "blank_fixes", int((~good).sum()))
    if gps_error is not None and (gps_error > 0).any():
        limit = max(_LEAST_GPS_LIMIT_M, 4.0 * float(np.median(gps_error[gps_error > 0])))
        bad = good & (gps_error > limit)
        add_count(repairs, "bad_fixes", int(bad.sum()))
        good &= ~bad
    index = np.flatnonzero(good)
    held = _held(t[index], x[index], y[index], _LONGEST_HOLD_S)
    add_count(repairs, "held_fixes", int(held.sum()))
    good[index[held]] = False
    index = index[~held]
    breaks = np.zeros(t.size, dtype=bool)
    if index.size > LEAST_ROWS:
        reach = _reach(t[index], x[index], y[index])
        verdict = _follow(t[index], x[index], y[index], *reach, _LONGEST_JUMP_S)
        add_count(repairs, "position_jumps", int((verdict == 1).sum()))
        add_count(repairs, "position_breaks", int((verdict == 2).sum()))
        good[index[verdict == 1]] = False
        breaks[index[verdict == 2]] = True
    return np.where(good, x, np.nan), np.where(good, y, np.nan), breaks


def _reach(t: FloatArray, x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """(speed [m/s], slack [m]): between two fixes of this run the robot moves no further than speed * dt + slack."""
    step = np.hypot(np.diff(x), np.diff(y))
    fresh = step > 0
    if not fresh.any():
        return 1.0, 0.15
    step, interval = step[fresh], float(np.median(np.diff(t)[fresh]))
    lag = max(round(1.0 / max(interval, 1e-3)), 1)
    far = np.hypot(x[lag:] - x[:-lag], y[lag:] - y[:-lag]) / np.maximum(t[lag:] - t[:-lag], 1e-3)
    speed = 2.0 * float(np.quantile(far, 0.9)) if far.size else 1.0
    slack = 0.15 + 8.0 * 1.4826 * float(np.median(np.abs(step - np.median(step))))
    return speed, slack


@njit(cache=True)
def _held(t: FloatArray, x: FloatArray, y: FloatArray, longest_s: float) -> BoolArray:
    """True for a fix that repeats the one before exactly, in stretches of up to `longest_s`; longer ones are kept."""
    n = t.size
    held = np.zeros(n, dtype=np.bool_)
    k = 0
    while k < n:
        j = k + 1
        while j < n and x[j] == x[k] and y[j] == y[k]:
            j += 1
        if t[j - 1] - t[k] <= longest_s:
            held[k + 1 : j] = True
        k = j
    return held


@njit(cache=True)
def _follow(
    t: FloatArray, x: FloatArray, y: FloatArray, speed: float, slack: float, longest_s: float
) -> NDArray[np.int64]:
    """Per fix: 0 kept, 1 part of a stretch reached by a jump, 2 first after a break. All (n,).

    The track is divided wherever a step is impossible. Of all chains of stretches the one that keeps the most seconds
    wins, where going on from one stretch to another that it cannot reach costs half of `longest_s`.
    """
    n = t.size
    verdict = np.zeros(n, dtype=np.int64)
    starts = np.empty(n + 1, dtype=np.int64)
    starts[0] = 0
    pieces = 1
    for k in range(1, n):
        if math.hypot(x[k] - x[k - 1], y[k] - y[k - 1]) > speed * (t[k] - t[k - 1]) + slack:
            starts[pieces] = k
            pieces += 1
    starts[pieces] = n
    usual = (t[n - 1] - t[0]) / max(n - 1, 1)
    value = np.zeros(pieces)
    before = np.full(pieces, -1, dtype=np.int64)
    jumped = np.zeros(pieces, dtype=np.bool_)
    for p in range(pieces):
        here = starts[p]
        best = 0.0
        for q in range(max(p - 300, 0), p):
            end = starts[q + 1] - 1
            jumps = math.hypot(x[here] - x[end], y[here] - y[end]) > speed * (t[here] - t[end]) + slack
            worth = value[q] - (0.5 * longest_s if jumps else 0.0)
            if worth > best:
                best = worth
                before[p] = q
                jumped[p] = jumps
        value[p] = best + t[starts[p + 1] - 1] - t[here] + usual
    verdict[:] = 1
    p = int(np.argmax(value))
    while p >= 0:
        verdict[starts[p] : starts[p + 1]] = 0
        if jumped[p]:
            verdict[starts[p]] = 2
        p = before[p]
    return verdict
