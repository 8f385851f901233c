"""One case: site, robot, logs of both days and of another site, with the hidden effects and without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from joulemap.model.robot import Robot
from tests.loop.generators.config import CaseConfig, DriveConfig, LogConfig
from tests.loop.generators.drive import Motion, drive_over
from tests.loop.generators.effect import Conditions, HiddenEffect, Scene
from tests.loop.generators.logs import Log, Logger
from tests.loop.generators.noise import factor_along, region_of
from tests.loop.generators.robots import TrueRobot, write_robot
from tests.loop.generators.site import Site
from tests.loop.generators.truth import battery_power_w, resistance_n, true_power_w

FloatArray = NDArray[np.float64]

_DAY_S = 86_400.0
_WARMING_S, _WARMING_K = 400.0, 15.0  # of the motors: time constant, and rise at usual power


@dataclass(frozen=True, eq=False)
class Place:
    """Logs on one site.

    Attributes
    ----------
    site : Site
        The ground.
    logs : tuple of Log
        With the hidden effects.
    twins : tuple of Log
        The same drives with the same variation, without any effect.
    """

    site: Site
    logs: tuple[Log, ...]
    twins: tuple[Log, ...]

    @property
    def extra_share(self) -> float:
        """Energy that the effects take, as a share of the energy without them."""
        with_it, without = (
            sum(float(log.numbers["voltage"] @ log.numbers["current"]) for log in logs)
            for logs in (self.logs, self.twins)
        )
        return with_it / without - 1.0

    def part(self, count: int, *, test: bool) -> Place:
        """The `count` logs for the test, spread evenly over the day, or the others."""
        n = len(self.logs)
        chosen = {int((k + 0.5) * n / count) for k in range(count)}
        mine = [k for k in range(n) if (k in chosen) == test]
        return Place(self.site, tuple(self.logs[k] for k in mine), tuple(self.twins[k] for k in mine))


@dataclass(frozen=True, eq=False)
class Case:
    """What a calibrator gets, and the truth behind it.

    Attributes
    ----------
    seed : int
        Of the case.
    effects : tuple of HiddenEffect
        What is hidden.
    robot : TrueRobot
        That drove.
    declared : Robot
        What its owner says of it.
    base : tuple of Log
        Runs of an earlier day without any effect.
    new : Place
        Runs with the effects.
    test : Place
        Further runs of the same day, for the errors only; may be empty.
    other : Place, optional
        Runs on another site with the effects, but for those that stay on the first site or in its logs.
    """

    seed: int
    effects: tuple[HiddenEffect, ...]
    robot: TrueRobot
    declared: Robot
    base: tuple[Log, ...]
    new: Place
    test: Place
    other: Place | None

    def write(self, folder: Path) -> None:
        """Write the case as files: dem.tif, robot.toml, base/, new/, twins/ and other_site/."""
        folder.mkdir(parents=True, exist_ok=True)
        self.new.site.write(folder / "dem.tif")
        write_robot(folder / "robot.toml", self.declared)
        parts = {"base": self.base, "new": self.new.logs, "twins": self.new.twins, "test": self.test.logs}
        if self.other is not None:
            parts["other_site"] = self.other.logs
            (folder / "other_site").mkdir(exist_ok=True)
            self.other.site.write(folder / "other_site" / "dem.tif")
        for name, logs in parts.items():
            for log in logs:
                log.write(folder / name)


def make_case(config: CaseConfig, seed: int, effects: Sequence[HiddenEffect] = ()) -> Case:
    """Draw a case. Site, robot and variation depend on the seed alone, so that cases of a seed can be compared.

    Parameters
    ----------
    config : CaseConfig
        Settings; the effects change what they need, such as driving backwards.
    seed : int
        Of everything random.
    effects : sequence of HiddenEffect
        What is hidden in the new runs.

    Returns
    -------
    Case
        The same for the same arguments.
    """
    parts = np.random.SeedSequence(seed).spawn(7)
    of_site, of_other, of_robot, of_owner = (np.random.default_rng(s) for s in parts[:4])
    site = Site.drawn(config.site, of_site)
    robot = TrueRobot.drawn(config.robot, of_robot)
    plain = config.log
    for effect in effects:
        config = effect.arranged(config)
    base = _Day(replace(config, log=plain), site, robot, home=True, day=0, new=False)
    new = _Day(config, site, robot, home=True, day=3, new=True)
    other = None
    if config.other_runs:
        second = Site.drawn(config.site, of_other)
        away = _Day(replace(config, log=plain), second, robot, home=False, day=5, new=True)
        other = away.place(config.other_runs, parts[6], effects, plain)
    day = new.place(config.new_runs + config.test_runs, parts[5], effects, plain)
    return Case(
        seed=seed,
        effects=tuple(effects),
        robot=robot,
        declared=robot.declared(config.robot, of_owner),
        base=base.place(config.base_runs, parts[4], (), plain).logs,
        new=day.part(config.test_runs, test=False),
        test=day.part(config.test_runs, test=True),
        other=other,
    )


@dataclass(frozen=True, eq=False)
class _Day:
    """A day on a site."""

    config: CaseConfig
    site: Site
    robot: TrueRobot
    home: bool
    day: int
    new: bool

    def place(
        self, runs: int, seeds: np.random.SeedSequence, effects: Sequence[HiddenEffect], plain: LogConfig
    ) -> Place:
        of_day, *of_runs = seeds.spawn(runs + 1)
        rng = np.random.default_rng(of_day)
        weather = self.config.weather
        mean = rng.uniform(*weather.day_degc)
        wind_from = rng.uniform(0.0, 2 * np.pi)
        region = region_of(self.site, rng)
        spread = np.linspace(0.0, 1.0, max(runs, 2))
        order, cargo_order = rng.permutation(max(runs, 2)), rng.permutation(max(runs, 2))
        clock, logs, twins = 0.0, [], []
        for k, seed in enumerate(of_runs):
            drive_seed, run_seed, noise_seed, log_seed = seed.spawn(4)
            motion = self._motion(self.config.drive, np.random.default_rng(drive_seed))
            run_rng = np.random.default_rng(run_seed)
            begins = mean + weather.run_sd_degc * run_rng.standard_normal()
            if self.new and weather.new_degc is not None:
                low, high = weather.new_degc
                begins = low + (high - low) * spread[order[k]]
            load = weather.cargo_share * self.robot.mass_kg * spread[cargo_order[k]] if self.new else 0.0
            conditions = Conditions(
                temperature_degc=begins + weather.drift_degc_per_h * run_rng.choice([-1.0, 1.0]) * (motion.t / 3600.0),
                motor_degc=np.zeros(0),
                wind_mps=run_rng.uniform(*weather.wind_mps),
                wind_from_rad=wind_from + run_rng.normal(0.0, 0.6),
                payload_kg=round(load, 1),
                heater=_thermostat(motion.t, run_rng) if self.new else np.zeros(len(motion)),
                clock_s=clock if self.new else 0.0,
            )
            motors = conditions.temperature_degc + self._warming(motion)
            conditions = replace(conditions, motor_degc=motors)
            scene = Scene(motion, self.robot, self.site, conditions, self.home)
            factor = factor_along(
                motion.driven_m, motion.x, motion.y, self.config.noise, region, np.random.default_rng(noise_seed)
            )
            name = f"run_{k + 1:02d}.csv"
            stamp = 1e6 + self.day * _DAY_S + clock
            logger = Logger(self.config.log, stamp, weather.wind_logged)
            power = factor * true_power_w(scene, effects, inertia=self.config.inertia)
            logs.append(logger.log(name, scene, power, np.random.default_rng(log_seed)))
            if effects:
                still = replace(scene, conditions=replace(conditions, payload_kg=0.0))
                power = factor * true_power_w(still, (), inertia=self.config.inertia)
                logger = replace(logger, config=plain)
                twins.append(logger.log(name, still, power, np.random.default_rng(log_seed)))
            clock += float(motion.t[-1]) + run_rng.uniform(300.0, 1800.0)
        return Place(self.site, tuple(logs), tuple(twins or logs))

    def _motion(self, drive: DriveConfig, rng: np.random.Generator) -> Motion:
        return drive_over(
            self.site, drive, cruising_mps=self.robot.speed_mps, wheelbase_m=self.robot.wheelbase_m, rng=rng
        )

    def _warming(self, motion: Motion) -> FloatArray:
        """By how much the motors are warmer than the air [K]: a first-order lag behind the power without effects."""
        force = resistance_n(motion, self.robot, inertia=False)
        power = battery_power_w(force, motion.rolling_mps, self.robot) - self.robot.idle_power_w
        usual = self.robot.rolling_n * self.robot.speed_mps / self.robot.efficiency
        target = _WARMING_K * np.maximum(power, 0.0) / usual
        step = motion.t[1] - motion.t[0]
        share = step / _WARMING_S
        return np.asarray(lfilter([share], [1.0, share - 1.0], target))


def _thermostat(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """1 while a heater is on: intervals of 40 to 150 s."""
    switches = np.cumsum(rng.uniform(40.0, 150.0, int(t[-1] / 40.0) + 2))
    return ((np.searchsorted(switches, t) + int(rng.integers(2))) % 2).astype(np.float64)
