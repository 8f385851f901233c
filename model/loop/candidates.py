"""The candidate effects that these runs can be tested for: each with its formulas, and what was refused and why."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.bend import spread_of
from joulemap.model.loop.columns import usable_columns
from joulemap.model.loop.effects import Term
from joulemap.model.loop.places import field_settings, grid_over
from joulemap.model.loop.quantities import quantity
from joulemap.model.loop.residual import Residuals
from joulemap.model.loop.words import quantity_name
from joulemap.model.runs.track import TURN_LIMITS_RADPS

FloatArray = NDArray[np.float64]

PLANNER_COLUMNS = frozenset({"temperature", "wind_speed", "wind_from", "payload", "humidity", "rain"})
"""Logged columns that are known before a drive."""

_RESPONSE = re.compile(
    r"ref$|cmd|command|steer|throttle|drive|stick|roll|pitch|yaw|gyro|acc|imu|wheel|odom|duty|pwm|rpm|torque|slip"
)
_GRADES = (-0.03, 0.0, 0.03)
_USUAL = {"temperature": 20.0}
_SMOOTH_KNOTS = 5
_MOST_CENTRES = 60
_MOST_RIPPLE = 4.0  # more is a broken reading
_LEAST_GENTLE = 0.01
_MOST_RUNS = 12  # that may have coefficients of their own


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect to be tested.

    Attributes
    ----------
    name : str
        Its key in reports.
    variants : tuple of Term
        Ways in which it may act.
    reveals : str
        Runs that would measure it.
    planner : bool
        Whether what it depends on is known before a drive.
    response : bool
        Whether its column responds to the drive (a command, a measured attitude): such ones are tested last.
    sign : int
        Sign that its last coefficient must have; 0 where both are possible. No robot has a negative drag.
    most : float
        Largest possible size.
    parts : tuple of str
        Of an interaction: the effect that it modifies, and the one by which.
    """

    name: str
    variants: tuple[Term, ...]
    reveals: str
    planner: bool = True
    response: bool = False
    sign: int = 0
    most: float = math.inf
    parts: tuple[str, ...] = ()

    @property
    def learned(self) -> bool:
        """Whether it is a fitted curve or field without a physical form."""
        return self.name.startswith("learned:")

    def in_plans(self, term: Term) -> bool:
        """Return whether what a variant depends on is known before a drive.

        Parameters
        ----------
        term : Term
            One of the variants, perhaps limited to some runs.

        Returns
        -------
        bool
            False for the wind of runs that are over.
        """
        return self.planner and "runs" not in term.where and term.settings.get("of") != "wind_constant"


def find_candidates(
    residuals: Residuals, columns: Mapping[str, FloatArray], *, usual: Mapping[str, float] | None = None
) -> tuple[list[Candidate], dict[str, str]]:
    """Return the candidate effects that these runs can be tested for.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    columns : mapping
        Mean voltage [V], current [A] and power [W] of each row, (n,), which no candidate may copy; and the current's
        `ripple`.
    usual : mapping, optional
        Values of logged columns at which the base model holds.

    Returns
    -------
    tuple of (list of Candidate, dict)
        The candidates; and why others were refused, by name.
    """
    drive, moving = residuals.drive, residuals.moving
    unit, amount = ("A s", "A") if residuals.charge else ("J", "W")
    refused: dict[str, str] = {}
    found = [_turning(residuals, unit), *_of_path(unit, _ripple(residuals, columns.get("ripple")))]
    found.append(
        Candidate(
            "hotel_load",
            (Term("hotel_load", "hotel_load", (amount,)),),
            "the same line at two speeds, and a minute without motion",
        )
    )
    if not residuals.charge:
        found += _of_level()
    usable = usable_columns(residuals, columns, refused)
    found += _of_weather(residuals, usable, _USUAL | dict(usual or {}), unit)
    for key, values in sorted(drive.words.items()):
        kinds = [w for w in np.unique(values[moving]) if w and (values[moving] == w).sum() >= 10]
        if len(kinds) < 2:
            refused[f"terrain_class:{key}"] = (
                "only one class is recorded" if kinds else "no class is recorded often enough"
            )
            continue
        found += _of_words(key, values[moving], kinds, unit)
    found += _of_each_run(residuals, usable, unit)
    found += _of_place(residuals)
    bumps = Term("learned:roughness", "roughness", ("1/m",))
    found.append(Candidate(bumps.name, (bumps,), "the same line while only roughness changes"))
    for key in ("grade", "cross_slope", "roughness", "elevation", "hollow", "speed"):
        found += _smooth(residuals, key, f"learned:{key}", unit, planner=True)
    for key in usable:
        name = f"learned:{key}"
        response = bool(_RESPONSE.search(key))
        found += _smooth(
            residuals, f"column:{key}", name, unit, planner=key in PLANNER_COLUMNS and not response, response=response
        )
    found = _merged(found)
    return found if residuals.charge else _bent(residuals, found), refused


def _bent(residuals: Residuals, found: list[Candidate]) -> list[Candidate]:
    """The same with the load-dependent response of forces; of a charge it is not known."""
    spread = spread_of(residuals.drive)
    return [replace(c, variants=tuple(v.bent(residuals, spread) for v in c.variants)) for c in found]


def _merged(found: list[Candidate]) -> list[Candidate]:
    """One candidate per name, with the variants of all."""
    by_name: dict[str, Candidate] = {}
    for one in found:
        first = by_name.get(one.name)
        by_name[one.name] = one if first is None else replace(first, variants=first.variants + one.variants)
    return list(by_name.values())


def _turning(residuals: Residuals, unit: str) -> Candidate:
    rad = f"{unit}/rad"
    turned = residuals.drive.turned_abs_rad
    shares = turned @ residuals.drive.gentle_turn_rad / max(float(turned @ turned), 1e-12)
    saturating = [
        Term("turning", "turning", (rad,), {"limit_radps": limit, "share": round(float(share), 4)})
        for limit, share in zip(TURN_LIMITS_RADPS, shares, strict=True)
        if share > _LEAST_GENTLE
    ]
    both = tuple(Term("turning", "turning_both", (rad, rad), {"limit_radps": limit}) for limit in TURN_LIMITS_RADPS[:5])
    plain = Term("turning", "turning", (rad,), {"limit_radps": None})
    sides = Term("turning", "turning_sides", (rad, rad))
    slopes = tuple(replace(plain, where={"over": "grade", side: g}) for side in ("above", "below") for g in _GRADES)
    forms = (plain, *saturating, *both, sides, *slopes)
    return Candidate("turning", forms, "curves of several radii on level ground, both ways", sign=1)


def _of_path(unit: str, ripple: float) -> Iterator[Candidate]:
    speeds = tuple(
        Term(
            "speed",
            "speed",
            (f"{unit}/m per m/s",) if p == 1 else (f"{unit}/m per (m/s)^{p}",),
            {"power": p, "absolute": absolute},
        )
        for p in (1, 2)
        for absolute in (False, True)
    )
    yield Candidate("speed", speeds, "the same line at several speeds")
    spin = Term("acceleration", "acceleration", ("kg",))
    yield Candidate("acceleration", (spin,), "starts and stops on level ground", planner=False, sign=1)
    across = tuple(Term("cross_slope", "cross_slope", ("",), {"power": p}) for p in (1, 2))
    yield Candidate("cross_slope", across, "along the side of a slope, and on level ground near it", sign=1)
    down = tuple(Term("braking", "braking", ("",), {"from_grade": g}) for g in (None, 0.0, 0.03, 0.06, 0.1))
    yield Candidate("braking", down, "straight up and straight down the same slope")
    back = tuple(
        Term("reversing", "reversing", ("" if of else f"{unit}/m",), {"of_motion": of}) for of in (True, False)
    )
    yield Candidate("reversing", back, "the same line forwards and backwards", planner=False, sign=1)
    yield Candidate("climbing", (Term("climbing", "climbing", ("",)),), "straight up slopes of several grades")
    more = tuple(
        Term(
            "learned:heading",
            "heading",
            ("" if share else f"{unit}/m",) * (2 * n + level),
            {"harmonics": n, "level": level, "of_motion": share},
        )
        for share in (False, True)
        for n in (1, 2, 3)
        for level in (False, True)
    )
    yield Candidate("learned:heading", more, "straight lines in eight headings from one place")
    yield Candidate("drift", tuple(_drifts(unit)), "the same loop at the start and at the end of a long day")
    losses = Term("battery", "battery", ("ohm",), {"ripple": ripple})
    yield Candidate("battery", (losses,), "steep climbs and level ground at the same state of charge", sign=1, most=5.0)


def _ripple(residuals: Residuals, measured: FloatArray | None) -> float:
    """Mean square of the current over the square of its mean within a segment, on average."""
    if measured is None:
        return 1.0
    weight = np.where(residuals.moving & np.isfinite(measured), residuals.predicted**2, 0.0)
    return round(float(np.sum(weight * np.clip(np.nan_to_num(measured), 1.0, _MOST_RIPPLE)) / weight.sum()), 3)


def _drifts(unit: str) -> Iterator[Term]:
    """Over a run, and over a day that may have begun before the first run."""
    hour, km = (3600.0, "h"), (1000.0, "km")
    of_run = [("since_start", hour, False), ("driven", km, False)]
    of_day = [(over, per, begun) for over, per in (("clock", hour), ("odometer", km)) for begun in (False, True)]
    for over, (per, name), begun in of_run + of_day:
        for of_all, amount in ((True, ""), (False, f"{unit}/m")):
            units = (amount,) * begun + (f"{amount or 1}/{name}",)
            yield Term("drift", "drift", units, {"over": over, "unit": per, "of_all": of_all, "begun": begun})


def _of_level() -> Iterator[Candidate]:
    yield Candidate(
        "sensor_gain",
        (Term("sensor_gain", "sensor_gain", ("",)),),
        "a minute without motion, then level ground and climbs",
    )
    yield Candidate(
        "payload", (Term("payload", "payload", ("kg",)),), "the same slope up and down (weighing the robot is better)"
    )
    yield Candidate(
        "rolling_resistance",
        (Term("rolling_resistance", "friction", ("",)),),
        "a level line at two speeds, and a climb",
    )


def _of_weather(residuals: Residuals, usable: list[str], usual: Mapping[str, float], unit: str) -> Iterator[Candidate]:
    drive = residuals.drive
    if "temperature" in usable:
        warm = {"reference": usual["temperature"]}
        warmth = [
            Term(
                "temperature",
                "temperature",
                ("" if of else f"{unit}/m",) * begun + ("1/K" if of else f"{unit}/m/K",),
                warm | {"of_motion": of, "begun": begun},
            )
            for of in (True, False)
            for begun in (False, True)
        ]
        if not residuals.charge:
            heats = warm | {"of_motion": False, "of_time": True}
            warmth += [
                Term("temperature", "temperature", ("W",) * begun + ("W/K",), heats | {"begun": begun})
                for begun in (False, True)
            ]
        yield Candidate("temperature", tuple(warmth), "the same loop on a cold and on a warm day", sign=-1)
    if not _wind_logged(residuals, usable):
        calm = Term("wind", "wind_constant", (f"{unit}/m",) * 2, {}, {"runs": list(drive.runs)})
        yield Candidate("wind", (calm,), "one line there and back, and one across it")
    else:
        air = (
            Term("wind", "wind_measured", (f"{unit}/m per (m/s)^2",), {"quadratic": True}),
            Term("wind", "wind_measured", (f"{unit}/m per m/s",), {"quadratic": False}),
        )
        yield Candidate("wind", air, "one line there and back in wind")
    if "payload" in usable:
        logged = Term("payload", "payload", ("",), {"column": "payload", "reference": 0.0})
        yield Candidate("payload", (logged,), "the same loop with and without a load")


def _wind_logged(residuals: Residuals, usable: Sequence[str]) -> bool:
    return "wind_speed" in usable and "wind_from" in residuals.drive.columns


def _of_each_run(residuals: Residuals, usable: list[str], unit: str) -> Iterator[Candidate]:
    """Conditions that nobody recorded and that may differ from run to run."""
    drive = residuals.drive
    runs = np.unique(drive.run[residuals.moving])
    names = list(drive.runs)
    if runs.size < 2 or runs.size < len(names) or runs.size > _MOST_RUNS:
        return
    if not _wind_logged(residuals, usable):
        wind = Term("wind", "by_run", (f"{unit}/m",) * 2 * len(names), {"of": "wind_constant", "runs": names})
        yield Candidate("wind", (wind,), "one line there and back, and one across it, in every run")
    if "payload" not in usable and not residuals.charge:
        load = Term("payload", "by_run", ("kg",) * len(names), {"of": "payload", "runs": names})
        yield Candidate("payload", (load,), "the same slope up and down with every load (weighing the robot is better)")


def _of_words(key: str, values: NDArray[np.str_], kinds: list[str], unit: str) -> Iterator[Candidate]:
    """All classes against the most common one, each class against all others, and turning that differs by class."""
    usual = max(kinds, key=lambda w: int((values == w).sum()))
    others = [str(w) for w in kinds if w != usual]
    name = "terrain_class" if key in ("terrain", "ground", "surface") else f"terrain_class:{key}"
    variants = tuple(
        Term(
            name, "words", (("" if of else f"{unit}/m"),) * len(some), {"column": key, "values": some, "of_motion": of}
        )
        for of in (False, True)
        for some in (others, *([str(w)] for w in kinds))
    )
    yield Candidate(name, variants, "the same manoeuvres on each kind of ground", planner=False)
    turns = [
        Term(f"turning x {name}", "turning_words", (f"{unit}/rad",) * len(some), {"column": key, "values": some})
        for some in (others, [str(w) for w in kinds])
    ]
    yield Candidate(
        turns[0].name,
        tuple(turns),
        "curves of several radii on each kind of ground",
        planner=False,
        parts=("turning", name),
    )


def _smooth(
    residuals: Residuals, over: str, name: str, unit: str, *, planner: bool, response: bool = False
) -> Iterator[Candidate]:
    values = quantity(residuals.drive, over)[residuals.moving]
    knots = np.unique(np.quantile(values[np.isfinite(values)], np.linspace(0.02, 0.98, _SMOOTH_KNOTS)).round(9))
    if knots.size < 2:
        return
    straight = sorted({knots[0], knots[-1]})
    sets = [[float(k) for k in some] for some in (straight, knots)]
    variants = tuple(
        Term(
            name,
            "smooth",
            ((f"{unit}/m" if of == "length" else ""),) * (len(some) - 1 + level),
            {"over": over, "knots": some, "of": of, "level": level},
        )
        for some in (sets if len(sets[1]) > 2 else sets[:1])
        for of in ("length", "all", "motion")
        for level in ((False, True) if over.startswith("column:") and not residuals.charge else (False,))
    )
    yield Candidate(
        name,
        variants,
        f"the same line while only {quantity_name(over)} changes",
        planner=planner,
        response=response,
    )


def _of_place(residuals: Residuals) -> Iterator[Candidate]:
    drive, fold = residuals.drive.take(residuals.moving), residuals.fold[residuals.moving]
    x, y = drive.x, drive.y
    extent = max(float(np.ptp(x)), float(np.ptp(y)))
    if extent < 8.0:
        return
    reveals = "cross the place and its surroundings in several headings"
    unit = max(1.0, extent / 60.0)
    disks = []
    for radius in (3.0 * unit, 5.0 * unit, 8.0 * unit, 12.0 * unit):
        for cx, cy in grid_over(x, y, 0.8 * radius):
            near = np.hypot(x - cx, y - cy) <= radius
            if near.sum() >= 12 and near.mean() <= 0.5 and np.unique(fold[near]).size >= 2:
                circle = {"x": round(cx, 2), "y": round(cy, 2), "radius_m": round(radius, 2)}
                disks.append(Term("local_friction", "disk", ("",), circle))
    settings = field_settings(drive, max(5.0, extent / 10.0))
    some = len(settings["centres"])
    if 3 <= some <= _MOST_CENTRES:
        disks.append(Term("local_friction", "place", ("",) * some, settings | {"of_all": False}))
        share = Term("learned:place", "place", ("",) * some, settings | {"of_all": True})
        yield Candidate("learned:place", (share,), reveals)
    if disks:
        yield Candidate("local_friction", tuple(disks), reveals)
