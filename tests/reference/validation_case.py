"""Validation cases: folders of simulated runs with hidden effects, whose truth is returned and not written.

The folder of a case holds dem.tif, robot.toml, base/ (baseline runs, without effects), new/ (another day at the same
site, with the effects) and other_site/ (another heightmap, the same effects). `site_seed` alone decides sites, robot
and base/, so that many cases can share one baseline model. `seed` decides the strength of the effects and the runs of
the other two folders.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.field.conditions import Conditions, Day, Halts
from joulemap.model.field.drives import Drive
from joulemap.model.field.effects import Effect
from joulemap.model.field.hidden_draws import WORDS, conditions_for, day_for, draw_effect
from joulemap.model.field.logger import Logger, log_trace
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import Trace, segment_gains, simulate_trace, take_ride, with_halts
from joulemap.model.field.sites import SURVEYS, TRUE_RESOLUTION_M, Relief, Site, make_site, random_ground
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.synthesis import TerrainRecipe
from joulemap.model.terrain.writers import write_geotiff
from tests.reference.drive_patterns import PATTERNS, drive_of

FloatArray = NDArray[np.float64]

BASELINE_RUNS, NEW_RUNS, OTHER_RUNS = 6, 6, 2
_BASELINE_M = 4400.0
_DAY_S = 86400.0


@dataclass(frozen=True)
class RunTruth:
    """What truly happened in a run, one entry per station.

    Attributes
    ----------
    t : ndarray of float64, (n,)
        Time on the log's clock [s].
    drawn_j : ndarray of float64, (n,)
        Energy since the start, as a perfect meter of this robot would read it [J].
    known_j : ndarray of float64, (n,)
        The prediction that knows the terrain and the effects [J].
    without_j : ndarray of float64, (n,)
        The prediction that knows the terrain alone [J].
    """

    t: FloatArray
    drawn_j: FloatArray
    known_j: FloatArray
    without_j: FloatArray


@dataclass(frozen=True)
class Coefficient:
    """The true coefficient of an effect at the battery.

    Attributes
    ----------
    effect : str
        Name of the effect.
    value : float
        Least squares of the energy that the effect took in the segments of new/, on its amount.
    unit : str
        Its unit.
    """

    effect: str
    value: float
    unit: str


@dataclass(frozen=True)
class CaseTruth:
    """What a case hides.

    Attributes
    ----------
    seed, site_seed : int
        The seeds of the case.
    effects : tuple of Effect
        The hidden effects.
    coefficients : tuple of Coefficient
        Their true coefficients.
    runs : dict of str to RunTruth
        The truth by the run's path in the folder.
    floor_known, floor_without : dict of str to float
        By folder: mean relative error per segment of a perfect model that knows the effects, and of one that does not.
    """

    seed: int
    site_seed: int
    effects: tuple[Effect, ...]
    coefficients: tuple[Coefficient, ...]
    runs: dict[str, RunTruth]
    floor_known: dict[str, float]
    floor_without: dict[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the hidden effects."""
        return tuple(effect.name for effect in self.effects)


@dataclass(frozen=True)
class _Driven:
    """One run: what was driven in which conditions, what came of it, and what would have come of it without effects."""

    site: Site
    drive: Drive
    conditions: Conditions
    trace: Trace
    plain: Trace


def make_validation_case(
    seed: int,
    effects: Sequence[str | Effect],
    out: str | Path,
    *,
    site_seed: int = 0,
    without_effects: str | Path | None = None,
) -> CaseTruth:
    """Write the folder of a case and return its truth; the same arguments give the same files.

    Raises NotFoundError if an effect is unknown.
    """
    out = Path(out)
    if any(out.glob("*/*.csv")):
        raise InputError(f"{out} holds runs already", path=str(out))
    home, other, robot = place(site_seed)
    rng = np.random.default_rng([seed, site_seed, 2])
    hidden = tuple(e if isinstance(e, Effect) else draw_effect(e, rng, robot) for e in effects)
    write_baseline(site_seed, out)
    (out / "other_site").mkdir()
    write_geotiff(out / "other_site" / "dem.tif", other.survey)
    runs: dict[str, RunTruth] = {}
    known: dict[str, float] = {}
    without: dict[str, float] = {}
    first: list[_Driven] = []
    for folder, site, count, day in (("new", home, NEW_RUNS, 11), ("other_site", other, OTHER_RUNS, 12)):
        lengths = rng.uniform(300.0, 400.0, count)
        driven = _drive_day(site, robot, lengths, hidden, rng, day=day, before=first)
        first = first or driven
        errors = []
        for number, run in enumerate(driven, start=1):
            name = f"{folder}/run_{number:02d}.csv"
            noise = int(rng.integers(2**31))
            _log(run.trace, run, robot, hidden, noise, out / name)
            if without_effects is not None:
                _log(run.plain, run, robot, (), noise, Path(without_effects) / name)
            runs[name] = _truth(run, hidden)
            errors.append(_errors(run, hidden))
        total = np.concatenate(errors, axis=1)
        known[folder], without[folder] = (float(total[k].mean()) for k in range(2))
    return CaseTruth(seed, site_seed, hidden, _coefficients(first, robot, hidden), runs, known, without)


def write_baseline(site_seed: int, out: str | Path) -> Path:
    """Write dem.tif, robot.toml and base/ of a site: a day without effects, about 4,400 m."""
    home, _, robot = place(site_seed)
    rng = np.random.default_rng([site_seed, 3])
    out = Path(out)
    (out / "base").mkdir(parents=True, exist_ok=True)
    write_geotiff(out / "dem.tif", home.survey)
    declared = robot.declared.as_dict()
    keys = (
        "name",
        "mass_kg",
        "width_m",
        "length_m",
        "wheel_radius_m",
        "nominal_voltage_v",
        "speed_mps",
        "battery_wh",
        "idle_power_w",
    )
    text = "".join(f"{key} = {json.dumps(declared[key])}\n" for key in keys)  # JSON's texts and numbers are TOML's too
    (out / "robot.toml").write_text(text, encoding="utf-8")
    lengths = np.full(BASELINE_RUNS, _BASELINE_M / BASELINE_RUNS)
    for number, run in enumerate(_drive_day(home, robot, lengths, (), rng, day=1), start=1):
        _log(run.trace, run, robot, (), int(rng.integers(2**31)), out / "base" / f"run_{number:02d}.csv")
    return out


@lru_cache(maxsize=2)
def place(site_seed: int) -> tuple[Site, Site, FieldRobot]:
    """Return two sites of one ground, 60 x 40 m with slopes up to 5 to 12 degrees, and the robot that drives there."""
    rng = np.random.default_rng([site_seed, 1])
    robot = FieldRobot.random(rng)
    declared = replace(
        robot.declared,
        name=f"simulated-{site_seed}",
        mass_kg=round(robot.declared.mass_kg, 1),
        width_m=round(robot.declared.width_m, 2),
        length_m=round(robot.declared.length_m, 2),
        wheel_radius_m=round(robot.declared.wheel_radius_m, 3),
        speed_mps=round(float(rng.uniform(0.4, 0.8)), 2),
        battery_wh=round(12.0 * robot.declared.mass_kg),
        idle_power_w=round(robot.declared.idle_power_w, 1),
    )
    robot = replace(robot, declared=declared, copper_w_per_n2=1.4 * declared.speed_mps / declared.weight_n)
    ground = random_ground(rng)
    sites = []
    for name in ("home", "other"):
        relief = Relief(
            TerrainRecipe(
                max_slope_deg=float(rng.uniform(5.0, 12.0)),
                relief_shortest_m=float(rng.uniform(5.0, 10.0)),
                roughness_rms_m=float(rng.uniform(0.008, 0.02)),
                roughness_longest_m=5.0,
                roughness_exponent=4.0,
            ),
            rough_m=float(rng.uniform(0.006, 0.014)),
            tussocks_per_m2=float(rng.uniform(0.3, 2.0)),
            tussock_m=float(rng.uniform(0.04, 0.07)),
            unevenness=float(rng.uniform(0.7, 1.2)),
        )
        cells = round(40.0 / TRUE_RESOLUTION_M), round(60.0 / TRUE_RESOLUTION_M)
        east = 500000.0 + float(rng.integers(0, 2000))
        frame = GridFrame(east, 4980000.0 + float(rng.integers(0, 2000)), TRUE_RESOLUTION_M, *cells, "EPSG:32615")
        sites.append(make_site(name, relief, ground, frame, rng, SURVEYS["scanner"]).with_words(WORDS, rng))
    return sites[0], sites[1], robot


def _drive_day(
    site: Site,
    robot: FieldRobot,
    lengths_m: FloatArray,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    day: int,
    before: Sequence[_Driven] = (),
) -> list[_Driven]:
    """The runs of a day one after another, on one battery. before : runs whose logger is used again."""
    weather: Day = day_for(effects, rng)
    payload_logged = bool(rng.random() < 0.7)
    for run in before[:1]:
        weather = replace(weather, wind_logged=run.conditions.wind_logged)
        payload_logged = run.conditions.payload_logged
    pattern = int(rng.integers(len(PATTERNS)))
    clock = day * _DAY_S + float(rng.uniform(7.5, 9.0)) * 3600.0
    metres, charge = 0.0, 0.97
    driven = []
    for number, length in enumerate(lengths_m):
        drive = drive_of(PATTERNS[(pattern + number) % len(PATTERNS)], site, robot, float(length), rng)
        drawn = Conditions.drawn(rng, start_s=clock, driven_m=metres, charge=charge, day=weather)
        conditions = conditions_for(effects, drawn, robot, rng, payload_logged=payload_logged)
        noise_seed = int(rng.integers(2**31))
        halts_at = np.sort(rng.choice(drive.x.size - 1, int(rng.integers(2, 5)), replace=False))
        conditions = replace(conditions, halts=Halts(halts_at, rng.uniform(3.0, 12.0, halts_at.size)))
        trace = simulate_trace(
            site, robot, drive, rng=np.random.default_rng(noise_seed), effects=effects, conditions=conditions
        )
        plain = trace
        if effects:
            plain = simulate_trace(site, robot, drive, rng=np.random.default_rng(noise_seed), conditions=conditions)
        driven.append(_Driven(site, drive, conditions, trace, plain))
        metres += drive.length_m
        charge -= float(trace.energy_j()[-1]) / 3600.0 / robot.declared.battery_wh
        clock += float(trace.t[-1]) + float(rng.uniform(0.3, 1.6)) * 3600.0
    return driven


def _log(trace: Trace, run: _Driven, robot: FieldRobot, effects: Sequence[Effect], seed: int, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    trace = with_halts(trace, run.conditions.halts)
    words = run.site.words_at(trace.x, trace.y)
    log = log_trace(
        trace,
        robot,
        rng=np.random.default_rng(seed),
        terrain=words,
        conditions=run.conditions,
        current_gain=_gain(effects),
    )
    log.write_csv(path)


def _gain(effects: Sequence[Effect]) -> float:
    return math.prod(effect.reading() for effect in effects)


def _truth(run: _Driven, effects: Sequence[Effect]) -> RunTruth:
    gain = _gain(effects)
    trace, plain = (with_halts(each, run.conditions.halts) for each in (run.trace, run.plain))
    return RunTruth(
        t=trace.t + Logger().standing_s + run.conditions.start_s,
        drawn_j=gain * trace.energy_j(),
        known_j=gain * trace.energy_j(trace.explained_w),
        without_j=plain.energy_j(plain.explained_w),
    )


def _errors(run: _Driven, effects: Sequence[Effect]) -> FloatArray:
    """Relative errors per segment (2, n): knowing the effects, and not."""
    gain, trace, plain = _gain(effects), run.trace, run.plain
    drawn, known, without = segment_gains(
        trace, gain * trace.energy_j(), gain * trace.energy_j(trace.explained_w), plain.energy_j(plain.explained_w)
    )
    return np.abs(np.stack([known, without]) - drawn) / drawn


def _coefficients(runs: Sequence[_Driven], robot: FieldRobot, effects: Sequence[Effect]) -> tuple[Coefficient, ...]:
    found = []
    for effect in effects:
        value = effect.stated()
        if value is None:
            value = _fitted(runs, robot, effect, alone=len(effects) == 1)
        if value is not None:
            found.append(Coefficient(effect.name, value, effect.unit))
    return tuple(found)


def _fitted(runs: Sequence[_Driven], robot: FieldRobot, effect: Effect, *, alone: bool) -> float | None:
    """What the effect costs alone, per unit of its amount: least squares through the origin over all segments."""
    cost, amount = [], []
    for run in runs:
        ride, _ = take_ride(run.site, robot, run.drive, effects=[effect], conditions=run.conditions)
        counted = effect.amount(ride)
        if counted is None:
            return None
        trace = run.trace
        if not alone:
            trace = simulate_trace(
                run.site, robot, run.drive, rng=np.random.default_rng(0), effects=[effect], conditions=run.conditions
            )
        extra = trace.energy_j(trace.explained_w) - run.plain.energy_j(run.plain.explained_w)
        gained, units = segment_gains(trace, extra, counted)
        cost.append(gained)
        amount.append(units)
    units, gained = np.concatenate(amount), np.concatenate(cost)
    return float(units @ gained / (units @ units))
