"""What the columns of a table say of power: its unit, its agreement with voltage and current, and counters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.agreement import disagreement
from joulemap.model.runs.candidates import CONFIDENCE, Recognised
from joulemap.model.runs.counters import is_per_row, no_counter, rate_of, total_of
from joulemap.model.runs.mapping import Source
from joulemap.model.runs.names import POSSIBLE
from joulemap.model.runs.table import FloatArray, spread
from joulemap.model.runs.units import UNITS, conversion, own_unit
from joulemap.model.runs.unsaid_units import ALIKE, UNSAID, clear, drawn_cost, fitting, off

_ANOTHER = 0.5  # the power of another part differs from voltage times current by more


def take_drawn(
    numbers: dict[str, FloatArray],
    words: dict[str, str],
    mapping: Mapping[str, str],
    found: Recognised,
    name: str,
) -> None:
    """Voltage, current and power in the units in which they agree best.

    A power that is not voltage times current is another one. Beside millivolts a current may be in anything.
    """
    chosen = found.chosen
    there: dict[str, FloatArray] = {
        key: numbers[key] for key in ("voltage", "current", "power") if key in numbers and key in chosen
    }
    if found.packs or not there:
        return

    def _units(key: str) -> Sequence[str]:
        own = key != "power" and chosen[key].columns == [key]
        return [""] if chosen[key].unit or key in mapping or own else UNSAID[key]

    choices = {key: _units(key) for key in there}
    fits = fitting(choices, lambda units: drawn_cost(there, units, _speed(numbers)))
    if fits.get("voltage") == ["mV"] and fits.get("current") == ["A"] and "power" not in there:
        fits["voltage"] = fits["current"] = [""]
    for key, units in fits.items():
        unit = clear(units, choices[key][0])
        if unit not in ("", own_unit(key)):
            numbers[key], words[key] = conversion(key, unit)[0] * numbers[key], unit
            found.confidence[key] = min(found.confidence[key], CONFIDENCE[POSSIBLE])
            found.notes.append(
                f"`{key}` is taken for {unit}: so it agrees with the others, and with what vehicles draw"
            )
    if "power" in there and "power" not in mapping:
        _check_power(numbers, chosen["power"], found, name)


def _speed(numbers: Mapping[str, FloatArray]) -> FloatArray | None:
    """The speed [m/s], or else its mean by the positions, (n,)."""
    if "speed" not in numbers and "t" in numbers and (path_m := agreement.path_of(numbers)):
        return np.full(numbers["t"].size, path_m / max(spread(numbers["t"]), 1e-9))
    return numbers.get("speed")


def _check_power(numbers: dict[str, FloatArray], source: Source, found: Recognised, name: str) -> None:
    """A power that is not voltage times current is another one, or in another unit than it says."""
    column = source.columns[0]
    if not {"voltage", "current"} <= numbers.keys():
        placed = {key: each for key, each in numbers.items() if key != "distance"}  # whose steps are coarse
        rising = "t" in numbers and bool((np.diff(numbers["t"]) > 0).all())
        frozen = "distance" in numbers and off(agreement.path_of(placed) or 0.0, spread(numbers["distance"])) > 1.0
        by_place = agreement.speed_of(numbers["t"], placed) if rising and not frozen else None
        speed = numbers.get("speed", by_place)
        if speed is not None and agreement.drives_nothing(numbers["power"], speed):
            words = f"{column[:60]} is as large at rest as while driving, but for less than the air takes"
            if source.unit:
                found.notes.append(f"{words}: was it measured?")
                return
            raise RunsError.of_run(
                name,
                f"nothing in it carries power: {words}. If it is the power all the same, say its unit with a mapping, "
                f"such as power={column[:60]}:kW; it may be a voltage, voltage={column[:60]}:V",
                column="power",
            )
        return
    product = numbers["voltage"] * numbers["current"]
    away = disagreement(numbers["power"], product)
    if not np.isfinite(away):
        return
    if away <= ALIKE:
        found.confidence |= dict.fromkeys(("power", "voltage", "current"), 0.99)
        return
    for unit, (factor, _) in UNITS["power"].items():
        ratio = factor / conversion("power", source.unit or "W")[0]
        if away > _ANOTHER and disagreement(ratio * numbers["power"], product) <= ALIKE:
            raise RunsError.of_run(
                name,
                f"{column[:60]} is {1 / ratio:g} times voltage times current, so the unit of one is "
                f"wrong: say it with a mapping, such as power={column[:60]}:{unit}, or current=...:mA",
                column="power",
            )
    found.notes.append(
        f"{column[:60]} is not voltage times current, they differ by {away:.0%} in the median: it is "
        f"{'taken for the power of the battery' if away <= _ANOTHER else 'not used'}"
    )
    if away > _ANOTHER:
        numbers[column if column != "power" else "power (not of the battery)"] = numbers.pop("power")


def flows(numbers: Mapping[str, FloatArray]) -> bool:
    """Whether a power or a current was logged."""
    return any(
        key in ("power", "current", "left_current", "right_current") or key.startswith("current_") for key in numbers
    )


def take_share(numbers: dict[str, FloatArray], words: dict[str, str], chosen: Mapping[str, Source]) -> None:
    """A state of charge from 0 to 1 that says no unit, as sensor_msgs/BatteryState has it, in per cent."""
    if "soc" in numbers and not chosen["soc"].unit and 0.0 < float(np.nanmax(numbers["soc"], initial=0.0)) <= 1.0:
        numbers["soc"], words["soc"] = 100.0 * numbers["soc"], "0 to 1"


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
            drawn = found.counted = True
        if counter in numbers:
            numbers.pop(counter)
            reading.pop(counter, None)
    if not drawn and "soc" not in numbers:
        found.refuse(name, ("current", "power"))
    if "current" in numbers and "power" not in numbers:
        found.refuse(name, ("voltage",))
