"""What a calibration says of the base parameters, in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joulemap.model.runs.words import number_words
from joulemap.service.words import capital

_NOTHING = 1e-9  # half a width of an interval: rounding
_BASE = {
    "rolling_resistance": "rolling resistance",
    "energy_of_motion": "energy of motion, as a multiple of the model's",
    "idle_power_w": "idle power",
    "descents": "share of the energy of descents that is lost",
    "driving_power": "power drawn while driving, beside the idle power",
    "speeding_up": "energy of speeding up, as a multiple of the kinetic energy",
    "slowing_down": "energy saved by slowing down, as a multiple of the kinetic energy",
    "measured_slope": "weight of the slope that the robot measured, beside the map's",
    "per_metre": "charge per metre",
    "uphill": "charge per joule of traction",
    "downhill": "charge saved per joule of braking",
    "standing_current": "current drawn all the time",
}


def base_name(key: str) -> str:
    """Return what a reader calls a base parameter."""
    return _BASE.get(key, key.replace("_", " "))


def base_words(document: Mapping[str, Any]) -> list[str]:
    """Return what the runs say of the base model's own parameters.

    Result: one line for each that the runs show: what was declared, what the runs say, and its 95 % interval.
    """
    lines = []
    for parameter in document["base_parameters"]:
        if not is_shown(parameter):
            continue
        unit = f" {parameter['unit']}".rstrip()
        value, low, high = map(number_words, (parameter["value"], *parameter["ci95"]))
        declared = "" if parameter["declared"] is None else f"{number_words(parameter['declared'])}{unit} declared, "
        lines.append(
            f"{capital(base_name(parameter['name']))}: {declared}{value}{unit} by the runs "
            f"(95 % interval {low} to {high})."
        )
    return lines


def is_shown(parameter: Mapping[str, Any]) -> bool:
    """Return whether the runs say anything of a base parameter.

    Result: False where the interval is wider than the value and than 1, and where nothing in the runs depends on it:
    then the interval has no width.
    """
    half = 0.5 * (parameter["ci95"][1] - parameter["ci95"][0])
    return _NOTHING < half <= max(1.0, abs(parameter["value"]))
