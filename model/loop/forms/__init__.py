"""The library of forms: one form is one class in one file; adding one is a file and a line here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from joulemap.model.errors import ModelError
from joulemap.model.loop.forms._base_parameters import BaseParameters
from joulemap.model.loop.forms.auxiliary_power import AuxiliaryPower
from joulemap.model.loop.forms.base import Form
from joulemap.model.loop.forms.baseline_change import CHANGES
from joulemap.model.loop.forms.change import Change
from joulemap.model.loop.forms.climbing import Climbing
from joulemap.model.loop.forms.copper_loss import CopperLoss
from joulemap.model.loop.forms.cross_slope import CrossSlope
from joulemap.model.loop.forms.drift import Drift
from joulemap.model.loop.forms.log_faults import MapShift, MeterLag
from joulemap.model.loop.forms.payload import Payload
from joulemap.model.loop.forms.power_limit import PowerLimit
from joulemap.model.loop.forms.reversing import Reversing
from joulemap.model.loop.forms.roughness import Roughness
from joulemap.model.loop.forms.simple_costs import SimpleCosts
from joulemap.model.loop.forms.speed import Speed
from joulemap.model.loop.forms.structure import Curve, PlaceField
from joulemap.model.loop.forms.temperature import Temperature
from joulemap.model.loop.forms.terrain_class import TerrainClass, TurningByClass
from joulemap.model.loop.forms.turning import Turning
from joulemap.model.loop.forms.warming_up import WarmingUp
from joulemap.model.loop.forms.wind import Wind

NAMED: tuple[type[Form], ...] = (
    Turning,
    Speed,
    CrossSlope,
    Roughness,
    Reversing,
    Climbing,
    CopperLoss,
    PowerLimit,
    AuxiliaryPower,
    Temperature,
    Payload,
    Wind,
    Drift,
    Change,
    WarmingUp,
    TerrainClass,
    TurningByClass,
    PlaceField,
    MeterLag,
    MapShift,
)
"""Forms with a formula."""

NOT_OF_SLOPE: tuple[type[Form], ...] = (Turning, Speed, CrossSlope, Roughness, Reversing, Payload, Wind, TerrainClass)
"""Forms that say nothing of the slope, nor of the force that it asks for."""

UNNAMED: tuple[type[Form], ...] = (Curve,)
"""Structure without a formula."""

_EVERY: tuple[type[Form], ...] = (*NAMED, *CHANGES, *UNNAMED, BaseParameters, SimpleCosts)
FORMS: dict[str, type[Form]] = {form.key: form for form in _EVERY}
"""Every form by its key."""


def form_from_dict(values: Mapping[str, Any]) -> Form:
    """Read a form from what `Form.as_dict` returned."""
    key = values.get("form")
    if key not in FORMS:
        raise ModelError(f"the model has an effect of the form {key!r}, which this version does not know")
    known = {f.name for f in fields(FORMS[key])}
    given = {k: _as_tuple(v) for k, v in values.items() if k != "form" and (k in known or v)}  # off: as without it
    needed = {f.name for f in fields(FORMS[key]) if f.default is MISSING}  # a model of before may lack a newer setting
    if unknown := sorted(set(given) - known):
        raise ModelError(f"the effect {key!r} has settings that this version does not know: {unknown}. Calibrate again")
    if not needed <= set(given):
        raise ModelError(f"the effect {key!r} needs the settings {sorted(known)}, got {sorted(given)}")
    return FORMS[key](**given)


def _as_tuple(value: Any) -> Any:
    return tuple(_as_tuple(v) for v in value) if isinstance(value, list) else value


__all__ = ["CHANGES", "FORMS", "NAMED", "NOT_OF_SLOPE", "UNNAMED", "Form", "form_from_dict"]
