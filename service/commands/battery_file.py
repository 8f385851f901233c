"""A battery of which more than energy is known, from a TOML file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.model.errors import InputError
from joulemap.service.commands.options import there

_STATE = ("charge", "reserve")

BatteryFile = Annotated[
    Path | None,
    typer.Option(
        "--battery",
        metavar="FILE",
        callback=there,
        help="TOML with more of the battery: health, temperature_c, capacity_curve, nominal_voltage_v, open_circuit_v, "
        "resistance_ohm, cutoff_v, max_power_w, capacity_wh. Then its voltage under load is judged too.",
    ),
]


def battery_values(file: Path | None) -> dict[str, Any]:
    """The values of a battery file."""
    values: dict[str, Any] = {}
    if file is not None:
        try:
            values = tomllib.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"battery file {file}: {str(error)[:200]}", path=str(file)) from error
        for name in _STATE:
            if name in values:
                raise InputError(
                    f"battery file {file} says {name}: leave it out there, and give --{name}", path=str(file), key=name
                )
    return values
