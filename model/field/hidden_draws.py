"""Hidden effects with a random strength in a realistic range, and a day on which each can be observed.

Forces are drawn as shares of the weight, so that they mean the same for every robot: rolling on grass or dirt takes
0.05 to 0.08 of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from joulemap.model.errors import NotFoundError, nearest_name
from joulemap.model.field.conditions import Conditions, Day
from joulemap.model.field.effects import Effect, Within
from joulemap.model.field.hidden_forces import (
    Acceleration,
    AirDrag,
    ColdGrease,
    Drift,
    Furrows,
    Payload,
    SideSlip,
    SoftClass,
    Speed,
    Turning,
    WetPatch,
)
from joulemap.model.field.hidden_losses import Braking, Connector, HotelLoad, HotMotors, SensorGain
from joulemap.model.field.robots import FieldRobot

Draw = Callable[[np.random.Generator, FieldRobot], Effect]

WORDS = ("grass", "gravel")
"""What the operator calls the two kinds of ground of a validation case."""


def _turning(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    return Turning(scrub=float(rng.uniform(0.5, 1.5)))


def _turning_uphill(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    return Within(Turning(scrub=float(rng.uniform(1.2, 2.4))), "grade_deg", above=float(rng.uniform(0.0, 1.5)))


def _speed(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    usual = robot.declared.speed_mps
    return Speed(viscous_s_per_m=float(rng.uniform(0.015, 0.04)) / usual, spread=float(rng.uniform(0.25, 0.4)))


def _acceleration(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    speed, weight = robot.declared.speed_mps, float(robot.kernel_parameters()[0])
    lost_per_m = float(rng.uniform(0.008, 0.02)) * weight  # when every spin-up is lost
    every = float(rng.uniform(3.5, 6.0))
    return Acceleration(rotors_kg=2.0 * lost_per_m * every / speed**2, every_m=every)


def _local_friction(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    return WetPatch(
        factor=float(rng.uniform(1.8, 3.0)),
        radius_m=float(rng.uniform(6.0, 9.0)),
        east=float(rng.uniform(0.25, 0.75)),
        north=float(rng.uniform(0.3, 0.7)),
    )


def _drift(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    if rng.random() < 0.5:
        return Drift(float(rng.uniform(0.010, 0.020)), "km")
    return Drift(float(rng.uniform(0.0025, 0.005)), "h")


def _sensor_gain(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    away = float(rng.uniform(0.10, 0.25))
    return SensorGain(1.0 + away if rng.random() < 0.5 else 1.0 - 0.8 * away)


def _connector(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    volts = robot.declared.nominal_voltage_v
    usual_w = robot.idle_w + 0.11 * float(robot.kernel_parameters()[0]) * robot.declared.speed_mps
    return Connector(resistance_ohm=float(rng.uniform(0.06, 0.14)) * volts**2 / usual_w, volts=volts)


def _hot_motors(rng: np.random.Generator, robot: FieldRobot) -> Effect:
    return HotMotors(share_per_k=float(rng.uniform(0.02, 0.04)), from_c=float(rng.uniform(8.0, 14.0)))


_DRAWS: Mapping[str, Draw] = {
    "turning": _turning,
    "hotel_load": lambda rng, robot: HotelLoad(robot.idle_w * float(rng.uniform(0.35, 1.0))),
    "wind": lambda rng, robot: AirDrag(float(rng.uniform(0.25, 0.7)) * (robot.mass_kg / 35.0) ** 0.8),
    "payload": lambda rng, robot: Payload(),
    "speed": _speed,
    "acceleration": _acceleration,
    "temperature": lambda rng, robot: ColdGrease(float(rng.uniform(0.02, 0.045))),
    "cross_slope": lambda rng, robot: SideSlip(float(rng.uniform(0.15, 0.35))),
    "braking": lambda rng, robot: Braking(float(rng.uniform(0.6, 1.4))),
    "terrain_class": lambda rng, robot: SoftClass(str(rng.choice(WORDS)), float(rng.uniform(1.35, 1.9))),
    "local_friction": _local_friction,
    "drift": _drift,
    "sensor_gain": _sensor_gain,
    "battery": _connector,
    "heading": lambda rng, robot: Furrows(float(rng.uniform(0.02, 0.045)), float(rng.uniform(0.0, math.pi))),
    "motor_temperature": _hot_motors,
    "turning_uphill": _turning_uphill,
}

EFFECT_NAMES = tuple(_DRAWS)
"""The effects that `draw_effect` knows, by name."""


def draw_effect(name: str, rng: np.random.Generator, robot: FieldRobot) -> Effect:
    """Draw the strength of an effect. Raises NotFoundError for another name."""
    if name not in _DRAWS:
        near = nearest_name(name, EFFECT_NAMES)
        hint = f"did you mean {near}?" if near else f"known are {', '.join(EFFECT_NAMES)}"
        raise NotFoundError(f"there is no hidden effect {name!r}; {hint}", name=name)
    return _DRAWS[name](rng, robot)


def day_for(effects: Sequence[Effect], rng: np.random.Generator) -> Day:
    """Draw a day on which effects can be observed: cold for stiff grease, windy for air drag, otherwise any day."""
    day = Day.drawn(rng)
    names = {effect.name for effect in effects}
    if ColdGrease.name in names:
        day = replace(day, mean_c=float(rng.uniform(2.0, 9.0)), swing_c=float(rng.uniform(5.0, 8.0)))
    if HotMotors.name in names:
        day = replace(day, mean_c=float(rng.uniform(8.0, 16.0)))
    if AirDrag.name in names:
        day = replace(day, wind_mps=float(rng.uniform(4.5, 8.0)))
    return day


def conditions_for(
    effects: Sequence[Effect],
    conditions: Conditions,
    robot: FieldRobot,
    rng: np.random.Generator,
    *,
    payload_logged: bool,
) -> Conditions:
    """Return the conditions of a run with a payload, if that is among the effects."""
    if not any(isinstance(effect, Payload) for effect in effects):
        return conditions
    carried = round(float(rng.choice([0.0, rng.uniform(0.1, 0.35)], p=[0.25, 0.75])) * robot.mass_kg, 1)
    return replace(conditions, payload_kg=carried, payload_logged=payload_logged)
