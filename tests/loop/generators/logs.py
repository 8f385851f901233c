"""Logs: what a logger writes of a drive, as columns in memory or as a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.loop.generators.config import LogConfig
from tests.loop.generators.effect import Scene

FloatArray = NDArray[np.float64]

INNOCENT = ("wind_speed", "wind_from", "humidity", "motor_temperature", "aux_2", "terrain")
"""Columns without an influence on the energy, unless a hidden effect uses them."""

GROUNDS = ("grass", "gravel")

_SAG = 0.08  # of the voltage, from the full to the empty battery
_BATTERY_H = 8.0  # of driving at usual power


@dataclass(frozen=True, eq=False)
class Log:
    """One log.

    Attributes
    ----------
    name : str
        Name of the file.
    numbers : dict of str to ndarray of float, (n,)
        Columns of numbers.
    texts : dict of str to ndarray of str, (n,)
        Columns of text.
    """

    name: str
    numbers: dict[str, FloatArray]
    texts: dict[str, NDArray[np.str_]]

    def write(self, folder: Path) -> Path:
        """Write the log as a CSV file into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        columns = [[f"{v:.4f}" for v in values] for values in self.numbers.values()]
        columns += [list(values) for values in self.texts.values()]
        lines = [",".join([*self.numbers, *self.texts]), *map(",".join, zip(*columns, strict=True))]
        path = folder / self.name
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path


@dataclass(frozen=True)
class Logger:
    """What the logger of one run adds.

    Attributes
    ----------
    config : LogConfig
        Settings.
    begins_s : float
        Stamp of the first row.
    wind_logged : bool
        Whether there are columns of the wind.
    """

    config: LogConfig
    begins_s: float
    wind_logged: bool

    def log(self, name: str, scene: Scene, power_w: FloatArray, rng: np.random.Generator) -> Log:
        """Log a run whose true power [W], (n,), is given."""
        config, motion, conditions = self.config, scene.motion, scene.conditions
        n = len(motion)
        sd = rng.uniform(*config.gps_sd_m)
        late = np.interp(motion.t - config.lag_s, motion.t, power_w)
        used = np.cumsum(late) / (np.mean(late) * 3600.0 * _BATTERY_H / (motion.t[1] - motion.t[0]))
        voltage = scene.robot.voltage_v * (1.0 - _SAG * used)
        forward = np.sign(motion.speed_mps + 1e-9)
        numbers = {
            "t": self.begins_s + motion.t,
            "x": motion.x + config.shift_m[0] + sd * rng.standard_normal(n),
            "y": motion.y + config.shift_m[1] + sd * rng.standard_normal(n),
            "z": motion.z + 2.0 * sd * rng.standard_normal(n),
            "voltage": voltage,
            "current": late / voltage * (1.0 + config.current_sd * rng.standard_normal(n)),
            "speed": motion.speed_mps + 0.01 * rng.standard_normal(n),
            "heading": np.mod(np.degrees(motion.heading_rad) + 0.5 * rng.standard_normal(n), 360.0),
            "roll": np.degrees(np.arctan(motion.cross)) + 0.3 * rng.standard_normal(n),
            "pitch": np.degrees(np.arctan(forward * motion.grade)) + 0.3 * rng.standard_normal(n),
            "temperature": np.round(conditions.temperature_degc, 1),
            "payload": np.full(n, conditions.payload_kg),
            "gps_error": np.full(n, round(sd, 3)),
        }
        texts: dict[str, NDArray[np.str_]] = {}
        spare = rng.standard_normal(n)
        ground = GROUNDS[int(rng.integers(len(GROUNDS)))]
        humidity = rng.uniform(35.0, 95.0)
        if config.innocent:
            if self.wind_logged:
                numbers["wind_speed"] = np.maximum(conditions.wind_mps + 0.3 * spare, 0.0)
                numbers["wind_from"] = np.mod(np.degrees(conditions.wind_from_rad) + 3.0 * spare[::-1], 360.0)
            numbers["humidity"] = np.round(humidity + 2.0 * np.sin(motion.t / 200.0), 1)
            numbers["motor_temperature"] = np.round(conditions.motor_degc, 1)
            numbers["aux_2"] = conditions.heater
            texts["terrain"] = np.full(n, ground)
        return Log(name, numbers, texts)
