"""What the columns of a table say of power: its unit, its agreement with voltage and current, and counters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.agreement import disagreement
from joulemap.model.runs.candidates import CONFIDENCE, Recognised
from joulemap.model.runs.column_values import words_of
from joulemap.model.runs.counters import is_per_row, no_counter, rate_of, total_of
from joulemap.model.runs.mapping import Source
from joulemap.model.runs.names import POSSIBLE
from joulemap.model.runs.table import FloatArray
from joulemap.model.runs.units import UNITS, conversion, own_unit

_AGREE, _ANOTHER = 0.2, 0.5  # a power differs from voltage times current by less, and one of another part by more


def take_thousandths(
    numbers: dict[str, FloatArray],
    chosen: Mapping[str, Source],
    mapping: Mapping[str, str],
    words: dict[str, str],
    found: Recognised,
) -> None:
    """Millivolts and milliamperes that nothing says. Beside millivolts a current may be in anything but amperes."""
    open_ = {
        key
        for key in ("voltage", "current")
        if key in numbers and not chosen[key].unit and key not in mapping and chosen[key].columns != [key]
    }
    there = agreement.thousandths(numbers.get("voltage"), numbers.get("current"))
    if not open_ >= {*there} or ("current" in open_ and there == ["voltage"]):
        return
    for key in there:
        numbers[key], words[key] = 1e-3 * numbers[key], {"voltage": "mV", "current": "mA"}[key]
        found.confidence[key] = min(found.confidence[key], CONFIDENCE[POSSIBLE])
        found.notes.append(f"`{key}` is taken for {words[key]}: in {own_unit(key)} no battery gives so much")


def check_power(
    numbers: dict[str, FloatArray],
    chosen: Mapping[str, Source],
    mapping: Mapping[str, str],
    reading: dict[str, str],
    found: Recognised,
    name: str,
) -> None:
    """A power that is not voltage times current is another one, or in another unit."""
    if "power" not in numbers or "power" in mapping or found.packs:
        return
    if not {"voltage", "current"} <= numbers.keys():
        speed = numbers.get("speed")
        if speed is None and "t" in numbers and (path_m := agreement.path_of(numbers)):
            took_s = float(np.nanmax(numbers["t"]) - np.nanmin(numbers["t"]))
            speed = np.full(numbers["t"].size, path_m / max(took_s, 1e-9))
        unit = "" if chosen["power"].unit or speed is None else agreement.power_unit(numbers["power"], speed)
        if unit:
            numbers["power"] = UNITS["power"][unit][0] * numbers["power"]
            if speed is not None and agreement.drives_nothing(numbers["power"], speed):
                column = chosen["power"].columns[0][:60]
                raise RunsError.of_run(
                    name,
                    f"nothing in it carries power: {column} is less than the air takes at that speed if it "
                    "is in W, and as large at rest as while driving if it is in kW. If it is the power all the same, "
                    f"say its unit with a mapping, such as power={column}:kW",
                    column="power",
                )
            reading["power"] = words_of("power", chosen["power"], unit)
            found.notes.append(f"`power` is taken for {unit}: in W it would be less than the air takes at that speed")
            found.confidence["power"] = min(found.confidence["power"], 0.8)
        return
    product = numbers["voltage"] * numbers["current"]
    units = {"": 1.0} if chosen["power"].unit else {unit: factor for unit, (factor, _) in UNITS["power"].items()}
    off = {unit: disagreement(factor * numbers["power"], product) for unit, factor in units.items()}
    best = min(off, key=lambda unit: off[unit])
    if not np.isfinite(off[best]):
        return
    if off[best] <= _AGREE:
        numbers["power"] = units[best] * numbers["power"]
        found.confidence["power"] = found.confidence["voltage"] = found.confidence["current"] = 0.99
        if best not in ("", "W"):
            reading["power"] = words_of("power", chosen["power"], best)
        return
    column, kept = chosen["power"].columns[0], off[best] <= _ANOTHER
    for unit, (factor, _) in UNITS["power"].items():
        ratio = factor / conversion("power", chosen["power"].unit or "W")[0]
        if not kept and disagreement(ratio * numbers["power"], product) <= _AGREE:
            raise RunsError.of_run(
                name,
                f"{column[:60]} is {1 / ratio:g} times voltage times current, so the unit of one is "
                f"wrong: say it with a mapping, such as power={column[:60]}:{unit}, or current=...:mA",
                column="power",
            )
    found.notes.append(
        f"{column[:60]} is not voltage times current, they differ by {off[best]:.0%} in the median: it is "
        f"{'taken for the power of the battery' if kept else 'not used'}"
    )
    if kept:
        return
    other = numbers.pop("power")
    numbers[column if column != "power" else "power (not of the battery)"] = other
    reading.pop("power", None)


def flows(numbers: Mapping[str, FloatArray]) -> bool:
    """Whether a power or a current was logged."""
    return any(
        key in ("power", "current", "left_current", "right_current") or key.startswith("current_") for key in numbers
    )


def take_counters(
    numbers: dict[str, FloatArray], reading: dict[str, str], found: Recognised, mapping: Mapping[str, str], name: str
) -> None:
    """Power or current from a counter, where neither was logged."""
    drawn = flows(numbers)
    for counter, target in (("energy", "power"), ("charge", "current")):
        if counter in numbers and "t" in numbers and not drawn:
            if is_per_row(numbers[counter]):
                source = found.chosen[counter]
                raise no_counter(name, counter, source.columns[0], source.unit or own_unit(counter))
            rate = rate_of(numbers["t"], total_of(numbers[counter]))
            numbers[target] = rate
            reading[target] = f"the rate of {reading.pop(counter, counter)}"
            found.confidence[target] = found.confidence.get(counter, 1.0)
            drawn = True
        if counter in numbers:
            numbers.pop(counter)
            reading.pop(counter, None)
    if not drawn and "soc" not in numbers:
        found.refuse(name, ("current", "power"))
    if "current" in numbers and "power" not in numbers:
        found.refuse(name, ("voltage",))
