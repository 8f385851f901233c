"""From the force at the wheels to volts and amperes: drivetrain of each side, battery, temperature of the motors.

Drivetrain: force through gears (efficiency both ways), constant friction, copper loss. Battery: open-circuit voltage
over the state of charge, internal resistance that grows in the cold. The terminals obey V = V_oc - R I and V I = P at
the same time; the smaller current that solves the quadratic is the one that flows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.field.robot_dynamics import Motion
from joulemap.model.field.robots import FieldRobot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Pack:
    """A lithium battery pack."""

    nominal_v: float  # Voltage [V] and capacity [Ah] as labelled
    capacity_ah: float
    resistance_ohm: float  # Internal resistance at 25 degC [ohm]
    charge: float = 0.95  # State of charge at the start, 0 to 1
    temperature_c: float = 18.0  # Temperature of the pack [degC]

    @classmethod
    def of(cls, robot: FieldRobot, *, charge: float = 0.95, temperature_c: float = 18.0) -> Pack:
        """Return the pack that the declared voltage and energy suggest, with 4 % sag at a one-hour discharge."""
        nominal = robot.declared.nominal_voltage_v
        capacity = robot.declared.battery_wh / nominal
        return cls(nominal, capacity, 0.04 * nominal / capacity, charge, temperature_c)


def open_circuit_v(pack: Pack, charge: float) -> float:
    """Return the voltage without load: 0.84 of nominal when empty, 1.15 when full, flat between.

    Result: voltage [V].
    """
    return float(_open_circuit(pack.nominal_v, charge))


def wheel_power_w(motion: Motion, robot: FieldRobot, speed_mps: FloatArray, curvature: FloatArray) -> FloatArray:
    """Return the electrical power of both drives, without the idle power.

    `speed_mps` (n,): speed [m/s]; `curvature` (n,): curvature of the path, > 0 to the right [rad/m]. Result (n,): power
    [W].
    """
    power = np.zeros_like(speed_mps)
    for force, sign in ((motion.force_left_n, 1.0), (motion.force_right_n, -1.0)):
        side_speed = speed_mps * np.maximum(1.0 + sign * 0.5 * robot.track_m * curvature, 0.0)
        geared = np.where(force > 0.0, force / robot.gear_efficiency, force * robot.gear_efficiency)
        motor = geared + 0.5 * robot.drag_n
        mechanical = motor * side_speed
        power += np.where(mechanical > 0.0, mechanical, robot.regeneration * mechanical)
        power += np.where(motor > 0.0, robot.copper_w_per_n2 * motor**2, 0.0)
    return power


def terminals(power_w: FloatArray, duration_s: FloatArray, pack: Pack) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what is measured at the terminals while power is drawn step by step.

    `power_w` (n,); `duration_s` (n,). Result (n,): voltage [V], current [A] and state of charge (0 to 1).
    """
    warm = pack.resistance_ohm * math.exp(0.02 * (25.0 - pack.temperature_c))
    voltage, current, charge = _terminals(
        np.ascontiguousarray(power_w),
        np.ascontiguousarray(duration_s),
        pack.nominal_v,
        pack.capacity_ah * 3600.0,
        warm,
        pack.charge,
    )
    bad = np.flatnonzero(~np.isfinite(voltage))
    if bad.size:
        k = int(bad[0])
        raise InputError(
            f"the simulated battery cannot deliver {power_w[k]:.0f} W (charge {charge[k]:.2f}, {pack.nominal_v:g} V)",
            power_w=float(power_w[k]),
            charge=float(charge[k]),
        )
    return voltage, current, charge


def motor_temperature_c(
    power_w: FloatArray, duration_s: FloatArray, ambient_c: float, *, kelvin_per_w: float = 0.25
) -> FloatArray:
    """Return the temperature of the motor housing: two fifths of the power become heat, time constant four minutes.

    `power_w` (n,): power of the drives in each step [W]; `duration_s` (n,): duration of each step [s]. Result (n,):
    temperature [degC].
    """
    return _warmth(
        np.ascontiguousarray(power_w), np.ascontiguousarray(duration_s), ambient_c, 0.4 * kelvin_per_w, 240.0
    )


@njit(cache=True)
def _open_circuit(nominal: float, charge: float) -> float:
    return nominal * (0.95 + 0.13 * charge + 0.07 * charge**8 - 0.11 * math.exp(-18.0 * charge))


@njit(cache=True)
def _terminals(
    power: FloatArray, duration: FloatArray, nominal: float, capacity_as: float, resistance: float, charge: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n = power.size
    volts = np.full(n, np.nan)
    amps = np.full(n, np.nan)
    charges = np.empty(n)
    for k in range(n):
        charges[k] = charge
        source = _open_circuit(nominal, charge)
        inside = source * source - 4.0 * resistance * power[k]
        if inside < 0.0 or charge <= 0.0:
            return volts, amps, charges
        amps[k] = (source - math.sqrt(inside)) / (2.0 * resistance)
        volts[k] = source - resistance * amps[k]
        charge -= amps[k] * duration[k] / capacity_as
    return volts, amps, charges


@njit(cache=True)
def _warmth(
    power: FloatArray, duration: FloatArray, ambient: float, kelvin_per_w: float, constant_s: float
) -> FloatArray:
    out = np.empty(power.size)
    now = ambient + 3.0
    for k in range(power.size):
        target = ambient + kelvin_per_w * power[k]
        now += (target - now) * (1.0 - math.exp(-duration[k] / constant_s))
        out[k] = now
    return out
