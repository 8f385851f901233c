"""Answers as commands say them: a cost map, a path, a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.service.commands.console import Output
from joulemap.service.words import duration_words, energy_words, objective_rows, route_words, saving_words

if TYPE_CHECKING:
    from joulemap.service.client import ServedCostMap

_COLOURS = {"yes": "green", "likely": "green", "marginal": "yellow", "no": "red"}


def served_map(made: ServedCostMap, out: Path | None) -> dict[str, Any]:
    """The values of a cost map of a service, as those of one that is made here."""
    values = made.about.model_dump(mode="json")
    frame = values.pop("frame")
    return {**values, **frame, "costmap_id": made.id, "out": None if out is None else str(out)}


def say_map(output: Output, made: Mapping[str, Any], **more: str) -> None:
    """Say what is known of a cost map, made here or by a service."""
    price, blocked = made["energy_per_m"], made["blocked"]
    cells = "{rows} rows x {cols} columns of {spacing_m:g} m, {headings} headings".format(**made)
    words = ", ".join(f"{share:.1%} {reason.replace('_', ' ')}" for reason, share in blocked.items() if share > 0)
    energy = "{min:.1f} .. {max:.1f} J/m, mean {mean:.1f} J/m".format(**price) if price else "nothing is free"
    written = {} if made.get("out") is None else {"written": made["out"]}
    output.table({**more, "cells": cells, "energy": energy, "ground": words, **written})
    output.warn(made["warnings"])


def _proven(found: Mapping[str, Any]) -> dict[str, str]:
    """What is known of better paths, as rows of the answer."""
    if found.get("gap") is None:
        return {}
    less = 100 * found["gap"] / (1.0 + found["gap"])
    return {"lower bound": f"{energy_words(found['bound_j'])}: no path takes less by more than {less:.2g} %"}


def say_path(output: Output, found: Mapping[str, Any], robot: str, *, bound: bool = False) -> None:
    """Say a path, beside the shortest one; its lower bound where that was asked for."""
    output.say(f"for {robot}, planner {found['planner']}", head="Path")
    output.table(
        {
            "energy-optimal": route_words(found),
            **{f"alternative {k}": route_words(other) for k, other in enumerate(found["alternatives"], 1)},
            "shortest": route_words(found["shortest"]),
            "saved": saving_words(found, found["shortest"]),
            **objective_rows(found["objective"]),
            **_proven(found if bound else {}),
        }
    )
    output.warn(found["warnings"])


def say_verdict(output: Output, found: Mapping[str, Any]) -> None:
    """Say a verdict, in its colour."""
    output.say(head=found["message"], style=f"bold {_COLOURS[found['verdict']]}")
    output.say(found["verdict_text"])


def say_feasibility(output: Output, found: Mapping[str, Any]) -> None:
    """Say whether the battery lasts, with the ways that this was judged on."""
    say_verdict(output, found)
    rows = {"way out": route_words(found["out"])}
    if found["back"] is not None:
        rows["way back"] = route_words(found["back"])
    if (place := found["reserve_at"]) is not None:
        rows["reserve touched"] = f"after {place['distance_m']:.0f} m, {duration_words(place['time_s'])}"
    rows |= objective_rows(found["objective"])
    if found["least_voltage_v"] is not None:
        rows["least voltage"] = f"{found['least_voltage_v']:.1f} V under load"
    output.table(rows)
    output.warn(dict.fromkeys(found["warnings"]))
