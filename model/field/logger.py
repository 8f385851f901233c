"""The robot's logger: a 10 Hz log of a drive, with the errors of real logs."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from joulemap.model.field.conditions import Conditions
from joulemap.model.field.drives import Drive
from joulemap.model.field.effects import Effect
from joulemap.model.field.electrics import Pack, motor_temperature_c, terminals
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import Trace, simulate_trace
from joulemap.model.field.sites import Site
from joulemap.model.frames import TAU

FloatArray = NDArray[np.float64]

COLUMNS = (
    "t",
    "x",
    "y",
    "z",
    "voltage",
    "current",
    "speed",
    "heading",
    "roll",
    "pitch",
    "temperature",
    "wind_speed",
    "wind_from",
    "payload",
    "terrain",
    "motor_temperature",
    "gps_error",
)
_DECIMALS = dict(zip(COLUMNS, (3, 3, 3, 3, 2, 3, 3, 2, 2, 2, 1, 1, 0, 1, 0, 1, 3), strict=True))


@dataclass(frozen=True)
class Logger:
    """How accurately a robot is recorded. `Logger.perfect()` records the truth."""

    rate_hz: float = 10.0  # Rows per second [Hz]
    jitter_s: float = 0.001  # Standard deviation of the time between rows [s]
    # Noise of the RTK position, horizontal and vertical [m]; half of its variance is slow, over about 2 s
    position_m: float = 0.01
    height_m: float = 0.015
    voltage_v: float = 0.03  # Noise of the voltmeter [V]
    current_share: float = 0.02  # Noise of the current meter, relative and absolute [A]
    current_a: float = 0.02
    angle_deg: float = 0.4  # Noise of heading, roll and pitch [deg]
    dropouts: float = 0.0006  # Gaps of 0.3 to 2 s, per row
    repeats: float = 0.002  # Rows written twice, per row
    spikes: float = 0.001  # Wrong values of voltage or current, per row
    jumps: float = 0.0004  # Single wrong positions, per row
    floats: float = 0.00005  # Times of 2 to 8 s in which RTK is lost and the position is 0.2 to 0.8 m off, per row
    standing_s: float = 3.0  # How long the robot waits before it drives [s]

    @classmethod
    def perfect(cls) -> Logger:
        """Return a logger without errors, which starts when the robot does."""
        return cls(10.0, *([0.0] * 13))


@dataclass(frozen=True)
class RunLog:
    """A log as recorded."""

    columns: dict[str, FloatArray]  # (n,): Columns by name, in the units of the run format; NaN means not recorded
    terrain: NDArray[np.str_]  # (n,): What the operator calls the ground

    def write_csv(self, path: str | Path) -> Path:
        """Write the log in the run format; a NaN becomes a blank."""
        texts = []
        for name in COLUMNS:
            if name == "terrain":
                texts.append(self.terrain.tolist())
                continue
            digits = _DECIMALS[name]
            texts.append(["" if v != v else f"{v:.{digits}f}" for v in self.columns[name].tolist()])
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(zip(*texts, strict=True))
        return Path(path)


def simulate_run(
    site: Site,
    robot: FieldRobot,
    drive: Drive,
    *,
    rng: np.random.Generator,
    logger: Logger | None = None,
    pack: Pack | None = None,
    start_s: float = 0.0,
    effects: Sequence[Effect] = (),
    conditions: Conditions | None = None,
) -> RunLog:
    """Drive over a site and log it."""
    trace = simulate_trace(site, robot, drive, rng=rng, effects=effects, conditions=conditions)
    gain = math.prod(effect.reading() for effect in effects)
    return log_trace(
        trace,
        robot,
        rng=rng,
        logger=logger,
        pack=pack,
        terrain=site.words_at(trace.x, trace.y),
        start_s=start_s,
        conditions=conditions,
        current_gain=gain,
    )


def log_trace(
    trace: Trace,
    robot: FieldRobot,
    *,
    rng: np.random.Generator,
    logger: Logger | None = None,
    pack: Pack | None = None,
    terrain: str | NDArray[np.str_] = "",
    start_s: float = 0.0,
    conditions: Conditions | None = None,
    current_gain: float = 1.0,
) -> RunLog:
    """Log a trace. `terrain` is (n,)."""
    logger = logger or Logger()
    if conditions is not None:
        start_s = conditions.start_s
        air = float(conditions.temperature_c(trace.t).mean())
        pack = pack or Pack.of(robot, charge=conditions.charge, temperature_c=air)
    pack = pack or Pack.of(robot, temperature_c=float(rng.uniform(8.0, 28.0)))
    duration = np.diff(trace.t, prepend=trace.t[0])
    volts, amps, _ = terminals(trace.power_w, duration, pack)
    warmth = motor_temperature_c(trace.wheels_w, duration, pack.temperature_c)

    t = np.arange(-logger.standing_s, trace.t[-1], 1.0 / logger.rate_hz)
    t = t + logger.jitter_s * rng.standard_normal(t.size).clip(-3.0, 3.0)
    standing = t < 0.0
    step = np.clip(np.searchsorted(trace.t, t), 0, trace.t.size - 1)  # the step of the path that is under way at t

    def _at(values: FloatArray) -> FloatArray:
        return np.interp(t, trace.t, values)

    idle_v, idle_a, _ = terminals(np.array([trace.standing_w]), np.array([1.0]), pack)
    n = t.size
    angles = {
        "heading": np.degrees(_at(np.unwrap(trace.heading_rad))),
        "roll": np.degrees(_at(trace.roll_rad)),
        "pitch": np.degrees(_at(trace.pitch_rad)),
    }
    angles = {name: values + logger.angle_deg * rng.standard_normal(n) for name, values in angles.items()}
    columns: dict[str, FloatArray] = {
        "t": t + logger.standing_s + start_s,
        "x": _at(trace.x) + _rtk(rng, n, logger.position_m, logger.rate_hz),
        "y": _at(trace.y) + _rtk(rng, n, logger.position_m, logger.rate_hz),
        "z": _at(trace.z) + _rtk(rng, n, logger.height_m, logger.rate_hz),
        "voltage": np.where(standing, idle_v, volts[step]) + logger.voltage_v * rng.standard_normal(n),
        "current": np.where(standing, idle_a, amps[step]) * (1.0 + logger.current_share * rng.standard_normal(n))
        + logger.current_a * rng.standard_normal(n),
        "speed": np.where(standing, 0.0, trace.speed_mps[step]) + logger.position_m * rng.standard_normal(n),
        "heading": np.mod(angles["heading"], 360.0),
        "roll": angles["roll"],
        "pitch": angles["pitch"],
        "temperature": np.full(n, pack.temperature_c),
        "wind_speed": np.full(n, np.nan),
        "wind_from": np.full(n, np.nan),
        "payload": np.zeros(n),
        "motor_temperature": _at(warmth) + 0.2 * (logger.angle_deg > 0) * rng.standard_normal(n),
        "gps_error": np.abs(0.012 + 0.002 * rng.standard_normal(n)),
    }
    columns["current"] *= current_gain
    if conditions is not None:
        columns.update(_weather(conditions, t, quiet=logger.angle_deg == 0.0))
    _disturb(columns, logger, rng)
    keep = _kept_rows(n, logger, rng)
    words = np.broadcast_to(np.asarray(terrain), trace.t.shape)[step]
    return RunLog({name: values[keep] for name, values in columns.items()}, words[keep])


def _weather(conditions: Conditions, t: FloatArray, *, quiet: bool) -> dict[str, FloatArray]:
    """Columns of the conditions as the robot's instruments measure them; their noise has its own generator."""
    rng = np.random.default_rng([conditions.seed, 3])
    noise = (0.0 if quiet else 1.0) * rng.standard_normal((3, t.size))
    speed, source = conditions.wind.at(t)
    blank = 0.0 if conditions.wind_logged else np.nan
    return {
        "temperature": conditions.temperature_c(t) + 0.1 * noise[0],
        "wind_speed": np.maximum(speed + 0.2 * noise[1], 0.0) + blank,
        "wind_from": np.mod(np.degrees(source) + 4.0 * noise[2], 360.0) + blank,
        "payload": np.full(t.size, conditions.payload_kg if conditions.payload_logged else np.nan),
    }


def _rtk(rng: np.random.Generator, n: int, sigma_m: float, rate_hz: float) -> FloatArray:
    """Noise of a fix [m], rms sigma: half its variance white, half with a memory of 2 s."""
    memory = float(np.exp(-1.0 / (2.0 * rate_hz)))
    slow = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal(n))
    return np.asarray(sigma_m * np.sqrt(0.5) * (rng.standard_normal(n) + slow))


def _disturb(columns: dict[str, FloatArray], logger: Logger, rng: np.random.Generator) -> None:
    n = columns["t"].size
    for name in ("voltage", "current"):
        hit = rng.random(n) < 0.5 * logger.spikes
        columns[name][hit] *= rng.choice([0.0, 0.3, 3.0, 10.0], int(hit.sum()))
    for k in np.flatnonzero(rng.random(n) < logger.jumps):
        _shift(columns, slice(k, k + 1), rng.uniform(1.0, 20.0), rng)
    for k in np.flatnonzero(rng.random(n) < logger.floats):
        spell = slice(k, k + int(rng.uniform(2.0, 8.0) * logger.rate_hz))
        far = rng.uniform(0.2, 0.8)
        _shift(columns, spell, far, rng)
        columns["gps_error"][spell] = far * rng.uniform(0.6, 1.2)


def _shift(columns: dict[str, FloatArray], rows: slice, far_m: float, rng: np.random.Generator) -> None:
    angle = rng.uniform(0.0, TAU)
    columns["x"][rows] += far_m * np.sin(angle)
    columns["y"][rows] += far_m * np.cos(angle)


def _kept_rows(n: int, logger: Logger, rng: np.random.Generator) -> NDArray[np.int64]:
    """Row numbers as written: dropouts are missing, repeats come twice."""
    kept = np.ones(n, dtype=bool)
    for k in np.flatnonzero(rng.random(n) < logger.dropouts):
        kept[k : k + int(rng.uniform(0.3, 2.0) * logger.rate_hz)] = False
    rows = np.flatnonzero(kept)
    return np.sort(np.concatenate([rows, rows[rng.random(rows.size) < logger.repeats]]))
