"""What a log says of power: current and voltage, the currents of several motors, or power itself; without spikes.

The currents of several motors are summed with their sign where it is that of power, so that a motor which feeds energy
back counts as that. In some logs the sign is the direction of rotation instead, and opposite for the two sides, whose
motors are mounted as mirror images. Energy is conserved: what the motors together feed back over a run is little beside
what they take. So of all readings of the signs the one is believed in which least is fed back:

- the sign is that of power: the currents are summed as they are;
- the sign is that of the rotation, the same or opposite on some sides: each current is given the sign of power by the
  logged speed of its wheels. Without wheel speeds, magnitudes are summed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import chain, product
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.runs.agreement import speed_of
from joulemap.model.runs.held_readings import between_readings
from joulemap.model.runs.reckoning import sides_of
from joulemap.model.runs.table import add_count, columns_there

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

Currents = Literal["auto", "signed", "magnitude"]
"""How the currents of several motors are summed."""

_TOTALS = ("power", "voltage", "current")
_SIDES = ("left_current", "right_current")
_MOST_MOTORS = 8  # of more, not all readings of the signs are tried
_USUAL = (0.01, 0.99)  # quantiles between which a meter reads nearly always
_SHORTEST_PEAK_S = 0.5  # a vehicle brakes or starts for longer
_LEAST_SEEN = 30  # rows, for the standard error of a correlation to be 1 / sqrt(n)
_CLEAR = 3.0  # standard errors: once in 400 by chance
_LEAST_LIKE = 0.5  # of a correlation: else other things move it more
_MOST_FED_BACK = 0.5  # going up and down again with an efficiency of 0.7 each way gives half of it back


def electric(
    numbers: dict[str, FloatArray],
    t: FloatArray,
    name: str,
    repairs: dict[str, int],
    currents: Currents = "auto",
    *,
    signed: Collection[str] = (),
    notes: list[str] | None = None,
) -> tuple[FloatArray, FloatArray | None, FloatArray | None, Currents | None, bool]:
    """Return current, voltage and power without spikes and blanks, and take their columns out of `numbers`.

    `numbers` (n,); `t` (n,): stamps [s]; `signed`: which of them are positive while the battery discharges, as the user
    or the log says; `notes`: what is to be known is added. Result: current [A], NaN where only power was logged;
    voltage [V] and power
    [W], None where they were not logged, (n,) each; how several currents of which some are negative were summed, None
    where the log leaves no choice; and whether the current is a sum of several.
    """
    if currents not in get_args(Currents):
        raise InputError(f"currents are summed as {', '.join(get_args(Currents))}, not {currents!r}", currents=currents)
    parts = sorted(key for key in numbers if key.startswith("current_") or key in _SIDES)
    held: dict[str, int] = {}
    for key in numbers.keys() & {*_TOTALS, *parts}:
        numbers[key], held[key] = between_readings(t, numbers[key])

    def _repaired(values: FloatArray, share: float, key: str, read: Collection[str]) -> FloatArray:
        for each in read:
            add_count(repairs, f"held_{each}", held[each])
        filled = _without_blanks(t, values, key, name, repairs)
        of_readings = any(held[each] for each in read)  # a reading that is a spike looks like the others
        return filled if of_readings else _without_spikes(t, values, filled, share, key, repairs)

    notes = [] if notes is None else notes
    power = _logged(numbers, "power", t, signed, repairs, notes)
    if power is not None:
        power = _repaired(power, 1.0, "power", ["power"])
    current, how = _logged(numbers, "current", t, signed, repairs, notes), None
    voltage = numbers.pop("voltage", None)
    if voltage is not None and not np.isfinite(voltage).any():
        voltage = None
    if voltage is not None:
        voltage = _repaired(voltage, 0.25, "voltage", ["voltage"])
    summed = current is None and bool(parts)
    if summed:
        current, how = _summed({key: numbers.pop(key) for key in parts}, numbers, repairs, currents)
    if current is not None:
        current = _repaired(current, 1.0, "current", parts if summed else ["current"])
        return current, voltage, power, how, summed
    if power is None:
        raise RunsError.of_run(
            name,
            f"there is neither a column 'current', nor any 'current_*', nor 'power'"
            f"{columns_there(numbers)}; a mapping says which it is, like current=batt_current_mA:mA",
            column="current",
        )
    if voltage is None:
        return np.full(t.size, np.nan), None, power, None, False
    return np.where(voltage > 0, power / np.where(voltage > 0, voltage, 1.0), 0.0), voltage, power, None, False


def _logged(
    numbers: dict[str, FloatArray],
    key: str,
    t: FloatArray,
    signed: Collection[str],
    repairs: dict[str, int],
    notes: list[str],
) -> FloatArray | None:
    """A total, positive while the battery discharges.

    Usually a battery discharges, in most rows and in sum. On a way down it need not: there its voltage, which falls
    under load, or its acceleration, which takes power, says which sign it has.
    """
    values = numbers.pop(key, None)
    if values is None or key in signed:
        return values
    flowing = np.isfinite(values) & (values != 0)  # at rest some ammeters say 0
    if not flowing.any():
        return values
    usual, total = np.median(values[flowing]) < 0, np.trapezoid(values[flowing], t[flowing]) < 0
    seen = _seen_to_charge(t[flowing], values[flowing], {name: each[flowing] for name, each in numbers.items()})
    charges = usual if seen is None else seen
    if charges:
        add_count(repairs, f"{key}_sign_flipped", 1)
    if seen is None and charges:
        notes.append(
            f"its `{key}` is negative in most rows, so its sign is changed, as a battery discharges more than it "
            f"charges: if it did charge, as on a way down, say so with a mapping: {key}=+ and the name of its column"
        )
    elif charges != usual or (charges != total and usual == total):
        notes.append(
            f"in most rows its `{key}` charges the battery, as its voltage or its acceleration says: if it does not, "
            f"say so with a mapping: {key}={'+' if charges else '-'} and the name of its column"
        )
    return -values if charges else values


def _seen_to_charge(t: FloatArray, values: FloatArray, others: Mapping[str, FloatArray]) -> bool | None:
    """Whether positive values charge the battery, as the voltage says that falls under load, or else the acceleration,
    which takes power; None where neither says it clearly.
    """
    if "voltage" in others and (found := _follows(t, values, others["voltage"])):
        return found > 0
    speed = others["speed"] if "speed" in others else speed_of(t, others)
    rising = speed is not None and t.size >= _LEAST_SEEN and bool((np.diff(t) > 0).all())
    if speed is not None and rising and (found := _follows(t, values, np.gradient(0.5 * speed**2, t))):
        return found < 0
    return None


def _follows(t: FloatArray, values: FloatArray, other: FloatArray) -> int:
    """1 where another quantity rises with the values, -1 where it falls, by its steps and by its course around a
    straight line; 0 where these differ, or may be chance.
    """
    both = np.isfinite(values) & np.isfinite(other)
    if both.sum() < _LEAST_SEEN:
        return 0
    t, values, other = t[both], values[both], other[both]
    level = _likeness(*(each - np.polyval(np.polyfit(t - t[0], each, 1), t - t[0]) for each in (values, other)))
    steps = _likeness(np.diff(values), np.diff(other))
    clear = level * steps > 0 and abs(level) > _LEAST_LIKE and abs(steps) > _CLEAR / np.sqrt(t.size)
    return int(np.sign(level)) if clear else 0


def _likeness(a: FloatArray, b: FloatArray) -> float:
    """Correlation; 0 with what is constant."""
    spread = float(a.std() * b.std())
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0 else 0.0


def _summed(
    parts: dict[str, FloatArray], numbers: Mapping[str, FloatArray], repairs: dict[str, int], currents: Currents
) -> tuple[FloatArray, Currents | None]:
    """The sum, and how it was made where that is a matter of choice."""
    every = np.stack(list(parts.values()))  # (motors, rows)
    if not (every < 0).any():
        return every.sum(axis=0), None
    if currents == "auto":
        signs = np.array([(1, *rest) for rest in product((1, -1), repeat=min(len(parts), _MOST_MOTORS) - 1)])
        if len(parts) > _MOST_MOTORS:
            signs = np.ones((1, len(parts)))
        wheels = _wheels_of(parts, numbers)
        if wheels is not None:
            turned = every * np.sign(wheels)
            resting = np.where(wheels == 0, np.abs(every), 0.0)  # at rest nothing is fed back
            others = (sign[:, None] * turned + resting for sign in np.vstack([signs, -signs]))
            found = min(chain([every], others), key=_fed_back)  # one after the other: each is as large as the log
            if found is not every:
                add_count(repairs, "currents_signed_by_wheels", 1)
            return found.sum(axis=0), None
        least = min(signs, key=lambda sign: _fed_back(sign[:, None] * every))
        plain = (least > 0).all() and _fed_back(every)[0] < _MOST_FED_BACK
        currents = "signed" if plain else "magnitude"
    if currents == "signed":
        return every.sum(axis=0), currents
    add_count(repairs, "currents_as_magnitudes", 1)
    return np.abs(every).sum(axis=0), currents


def _fed_back(every: FloatArray) -> tuple[float, float]:
    """Charge that goes into the battery over that which comes out: of all motors together, and of each by itself."""

    def _share(current: FloatArray) -> float:
        taken = float(np.nansum(np.maximum(current, 0.0)))
        return -float(np.nansum(np.minimum(current, 0.0))) / taken if taken > 0 else np.inf

    return _share(every.sum(axis=0)), _share(every)


def _wheels_of(parts: Mapping[str, FloatArray], numbers: Mapping[str, FloatArray]) -> FloatArray | None:
    """The wheel speed of each current, (motors, rows); None unless all currents name a side whose speed is logged."""
    sides = sides_of(numbers)
    named = [[side for side, word in enumerate(("left", "right")) if word in key] for key in parts]
    if sides is None or any(len(found) != 1 for found in named):
        return None
    return np.stack([sides[found[0]] for found in named])


def _without_blanks(t: FloatArray, values: FloatArray, key: str, name: str, repairs: dict[str, int]) -> FloatArray:
    blank = ~np.isfinite(values)
    if blank.mean() > 0.5:
        raise RunsError.of_run(name, f", column {key!r}: {int(blank.sum())} of {t.size} cells are blank", column=key)
    add_count(repairs, f"blank_{key}", int(blank.sum()))
    return np.interp(t, t[~blank], values[~blank])


def _short(t: FloatArray, rows: BoolArray) -> BoolArray:
    """Of marked rows those of stretches that are one row, or shorter than any braking or start."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(np.int8)))
    out = np.zeros(t.size, dtype=bool)
    for begin, end in ends.reshape(-1, 2):
        out[begin:end] = end - begin == 1 or t[end - 1] - t[begin] < _SHORTEST_PEAK_S
    return out


def _without_spikes(
    t: FloatArray, values: FloatArray, filled: FloatArray, share: float, key: str, repairs: dict[str, int]
) -> FloatArray:
    from scipy.ndimage import median_filter  # loads slowly, and only measured runs need it

    blank = ~np.isfinite(values)
    middle = median_filter(filled, 11, mode="nearest")
    away = np.abs(filled - middle)
    spread = 1.4826 * median_filter(away, 11, mode="nearest")
    low, high = np.quantile(filled, _USUAL)
    unseen = (filled < low - (high - low)) | (filled > high + (high - low))  # what is there again and again is no spike
    spikes = unseen & (away > 6.0 * spread + share * abs(float(np.median(filled))))
    spikes &= _short(t, spikes)
    add_count(repairs, f"{key}_spikes", int((spikes & ~blank).sum()))
    good = ~(spikes | blank)
    return np.interp(t, t[good], values[good])
