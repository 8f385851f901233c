"""A battery: its state, what of its capacity cold and age leave, and what it can give under load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model import ranges
from joulemap.model.errors import InputError, nearest_name

Curve = tuple[tuple[float, float], ...]

RATED_C = (15.0, 45.0)
"""Temperatures at which a battery gives its capacity [degC]: it is rated at 20 +- 5 degC (IEC 61960-3), and lithium-ion
cells may be discharged above that without loss. Colder, the data sheet's curve is needed."""
CELL_V = 3.63
"""Nominal voltage of the cell of the plain pack [V]: LG INR21700-M50."""
CELL_CUTOFF_V = 2.5
"""Its cut-off voltage [V]. Source: Chen et al. 2020, table II."""
CELL_CURVE: Curve = (
    (0.0, 2.500),
    (0.05, 3.107),
    (0.1, 3.292),
    (0.2, 3.484),
    (0.3, 3.578),
    (0.4, 3.664),
    (0.5, 3.746),
    (0.6, 3.835),
    (0.7, 3.941),
    (0.8, 4.034),
    (0.9, 4.095),
    (1.0, 4.181),
)
"""Its open-circuit voltage [V] by state of charge: the difference of the potentials of both electrodes of Chen et al.
2020, "Development of experimental techniques for parameterization of multi-scale lithium-ion battery models", from
4.18 V down to the cut-off voltage."""
DROP_AT_1C = 0.04
"""Voltage that a plain pack loses inside at the current that empties it in an hour, over its nominal voltage: 28 mOhm
of a cell of 4.9 Ah and 3.63 V, assumed from the resistances that makers of such cells give (20 to 40 mOhm)."""
_CURVES = {"open_circuit_v": "[charge, volts]", "capacity_curve": "[degrees Celsius, share of the capacity]"}


@dataclass(frozen=True)
class Battery:
    """A battery and its state at the start of a path.

    Attributes
    ----------
    capacity_wh : float
        Energy of the full battery when it was new, at its rated temperature [Wh].
    charge : float
        State of charge now, 0 to 1.
    reserve : float
        Share of the charge of the full battery that must remain at the end, 0 to 1.
    health : float
        Share of the capacity that age has left, 0.05 to 1.
    temperature_c : float or None
        Temperature of the battery [degC]. Below 15 degC it needs `capacity_curve`.
    capacity_curve : tuple of (float, float), or None
        Temperatures [degC] in ascending order, each with the share of the capacity that the battery gives there.
    nominal_voltage_v : float or None
        Nominal voltage [V]; None for that of the robot.
    open_circuit_v : tuple of (float, float), or None
        States of charge from 0 to 1 in ascending order, each with the voltage without a load [V]. None for the curve of
        a plain lithium-ion pack at the nominal voltage.
    resistance_ohm : float or None
        Internal resistance of the pack [ohm]. None for that of a plain pack.
    cutoff_v : float or None
        Voltage under load below which the robot switches off [V]. None for that of a plain pack.
    max_power_w : float or None
        Most power that the battery gives [W]; None for no limit of its own.

    Raises
    ------
    InputError
        If a value is outside its range, a curve is not one, or the battery is cold and has no curve.

    Notes
    -----
    With capacity, charge and reserve alone, a verdict counts energy. Once one of `open_circuit_v`, `resistance_ohm`,
    `cutoff_v` and `max_power_w` is given, it counts what the battery loses inside and whether its voltage holds too.
    """

    capacity_wh: float
    charge: float = 1.0
    reserve: float = 0.0
    health: float = 1.0
    temperature_c: float | None = None
    capacity_curve: Curve | None = None
    nominal_voltage_v: float | None = None
    open_circuit_v: Curve | None = None
    resistance_ohm: float | None = None
    cutoff_v: float | None = None
    max_power_w: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            if field.name in _CURVES:
                object.__setattr__(self, field.name, _curve(field.name, value))
            else:
                object.__setattr__(self, field.name, _number(field.name, value))
        if self.open_circuit_v is not None:
            _check_open_circuit(self.open_circuit_v)
        if self.capacity_curve is None and self.temperature_c is not None:
            low, high = RATED_C
            if not low <= self.temperature_c <= high:
                raise InputError(
                    f"battery: temperature_c is {self.temperature_c:g}; what a battery gives below {low:g} or above "
                    f"{high:g} degC is not known without its curve: give `capacity_curve` from its data sheet, such as "
                    "[[-20, 0.6], [0, 0.85], [20, 1]], or leave temperature_c out",
                    key="temperature_c",
                    value=self.temperature_c,
                    limit=[low, high],
                )

    def __repr__(self) -> str:
        words = (
            f"Battery of {self.capacity_wh:g} Wh, charge {100 * self.charge:.4g} %, reserve {100 * self.reserve:.4g} %"
        )
        if self.usable_share < 1.0:
            words += f", of which age and cold leave {100 * self.usable_share:.4g} %"
        return words

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Battery:
        """Return the battery with these values; what is missing keeps its default.

        Parameters
        ----------
        values : mapping
            Attributes by name, `capacity_wh` among them.

        Returns
        -------
        Battery
            The battery.

        Raises
        ------
        InputError
            On an unknown name, an impossible value, or without a capacity.
        """
        known = [field.name for field in fields(cls)]
        for name in values:
            if name not in known:
                near = nearest_name(str(name), known)
                hint = f"did you mean {near}?" if near else f"known are {', '.join(known)}"
                raise InputError(f"battery: unknown {ranges.short(name)!r}; {hint}", key=str(name)[:60])
        if values.get("capacity_wh") is None:
            raise InputError("battery: capacity_wh is missing: give the energy of the full battery [Wh]")
        return cls(**values)

    @property
    def usable_share(self) -> float:
        """Share of `capacity_wh` that age and temperature leave."""
        share = 1.0
        if self.temperature_c is not None and self.capacity_curve is not None:
            at, shares = np.array(self.capacity_curve).T
            share = float(np.interp(self.temperature_c, at, shares))
        return self.health * share

    @property
    def full_j(self) -> float:
        """Energy of the full battery as it is now [J]."""
        return self.usable_share * self.capacity_wh * 3600.0

    @property
    def available_j(self) -> float:
        """Energy above the reserve [J]; negative when the charge is already below it."""
        return (self.charge - self.reserve) * self.full_j

    @property
    def is_electric(self) -> bool:
        """Whether more than energy is known of it: a curve, a resistance, a cut-off voltage or a limit of power."""
        given = (self.open_circuit_v, self.resistance_ohm, self.cutoff_v, self.max_power_w)
        return any(value is not None for value in given)


@dataclass(frozen=True)
class Pack:
    """The electric side of a battery, with a plain pack's values where it does not say.

    Attributes
    ----------
    curve : tuple of (float, float)
        State of charge and open-circuit voltage [V].
    resistance_ohm : float
        Internal resistance [ohm].
    cutoff_v : float
        Least voltage under load [V].
    max_power_w : float
        Most power [W]; infinite without a limit.
    full_as : float
        Charge of the full battery [A s].
    """

    curve: Curve
    resistance_ohm: float
    cutoff_v: float
    max_power_w: float
    full_as: float

    def open_circuit_v(self, charge: ArrayLike) -> NDArray[np.float64]:
        """Return the voltage without a load. Result: voltage [V], linear between the points of the curve."""
        at, volts = np.array(self.curve).T
        return np.interp(np.asarray(charge, dtype=np.float64), at, volts)

    def most_power_w(self, charge: ArrayLike) -> NDArray[np.float64]:
        """Return the most power at which the voltage holds.

        Result: power [W]: where the voltage under load falls to the cut-off voltage or to half the open-circuit voltage
        (beyond, more current gives less power), or the limit; 0 where the open-circuit voltage is too low already.
        """
        open_v = self.open_circuit_v(charge)
        least_v = np.maximum(self.cutoff_v, 0.5 * open_v)
        if self.resistance_ohm > 0.0:
            power = least_v * np.maximum(open_v - least_v, 0.0) / self.resistance_ohm
        else:
            power = np.where(open_v > self.cutoff_v, np.inf, 0.0)
        return np.minimum(power, self.max_power_w)


def pack_of(battery: Battery, nominal_voltage_v: float) -> Pack:
    """Return the electric side of a battery. Its charge is such that the whole curve gives the battery's energy."""
    nominal = nominal_voltage_v if battery.nominal_voltage_v is None else battery.nominal_voltage_v
    if battery.open_circuit_v is not None:
        curve = battery.open_circuit_v
        if battery.nominal_voltage_v is None:
            nominal = _mean_v(curve)
    else:
        curve = tuple((charge, volts / CELL_V * nominal) for charge, volts in CELL_CURVE)
    cutoff = CELL_CUTOFF_V / CELL_V * nominal if battery.cutoff_v is None else battery.cutoff_v
    highest = curve[-1][1]
    if cutoff >= highest:
        source = "the curve has a" if battery.open_circuit_v is not None else f"a pack of {nominal:g} V nominal has a"
        raise InputError(
            f"battery: cutoff_v is {cutoff:.4g} V, and {source} highest voltage of {highest:.4g} V: the robot could "
            "not be switched on. Give a lower cutoff_v, or the battery's nominal_voltage_v or open_circuit_v",
            key="cutoff_v",
            value=cutoff,
            limit=highest,
        )
    full_as = battery.full_j / _mean_v(curve)
    resistance = battery.resistance_ohm
    if resistance is None:
        resistance = DROP_AT_1C * nominal / (battery.capacity_wh / nominal)
    power = np.inf if battery.max_power_w is None else battery.max_power_w
    return Pack(curve, resistance, cutoff, float(power), full_as)


def _mean_v(curve: Curve) -> float:
    """Mean voltage over the state of charge."""
    charge, volts = np.array(curve).T
    return float(np.trapezoid(volts, charge))


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"battery: {name} is {ranges.short(value)!r}; it must be a number", key=name)
    allowed = ranges.BATTERY[name]
    if value not in allowed:
        percent = allowed.high == 1.0 and value in ranges.Range(1.0, 100.0)
        hint = f": for {value:g} % write {value / 100:g}" if percent else ""
        between = f"lies between {allowed.low:g} and 1" if allowed.high == 1.0 else f"must be {allowed}"
        raise InputError(
            f"battery: {name} is {ranges.short(value)}; it {between}{hint}",
            key=name,
            value=ranges.short(value),
            limit=[allowed.low, allowed.high],
        )
    return float(value)


def _curve(name: str, value: Any) -> Curve:
    """A curve of two points at least, whose first numbers ascend."""
    form = _CURVES[name]
    low, high = ranges.BATTERY_CURVES[name]
    if not isinstance(value, Sequence) or isinstance(value, str) or not 2 <= len(value) <= ranges.CURVE_POINTS:
        raise InputError(
            f"battery: {name} must be a list of 2 to {ranges.CURVE_POINTS} points {form}, got {ranges.short(value)!r}",
            key=name,
        )
    points = []
    for k, point in enumerate(value):
        if not isinstance(point, Sequence) or isinstance(point, str) or len(point) != 2:
            raise InputError(f"battery: point {k} of {name} must be {form}, got {ranges.short(point)!r}", key=name)
        for number, allowed in zip(point, (low, high), strict=True):
            if isinstance(number, bool) or not isinstance(number, Real) or number not in allowed:
                raise InputError(
                    f"battery: point {k} of {name}, {form}, has {ranges.short(number)}; it must be {allowed}", key=name
                )
        points.append((float(point[0]), float(point[1])))
        if k and points[k][0] <= points[k - 1][0]:
            raise InputError(
                f"battery: the points of {name} must ascend: {points[k][0]:g} follows {points[k - 1][0]:g}", key=name
            )
    return tuple(points)


def _check_open_circuit(curve: Curve) -> None:
    if curve[0][0] != 0.0 or curve[-1][0] != 1.0:
        raise InputError(
            f"battery: open_circuit_v goes from a charge of {curve[0][0]:g} to {curve[-1][0]:g}; it must go from 0 to "
            "1",
            key="open_circuit_v",
        )
    for (_, before), (charge, volts) in zip(curve, curve[1:], strict=False):
        if volts < before:
            raise InputError(
                f"battery: open_circuit_v falls to {volts:g} V at a charge of {charge:g}; a fuller battery has no "
                "lower voltage",
                key="open_circuit_v",
            )
