"""Least energies from a start to every cell, from every cell to a goal, or over every cell between both."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from pydantic import Field

from joulemap.model.ranges import CORRIDOR_PERCENT
from joulemap.service.questions.parts import Neighbours, OnMap, Snap, on_map
from joulemap.service.schemas.base import Place, within

if TYPE_CHECKING:  # they take their time to load
    from joulemap.planner.areas.energy_map import EnergyMap
    from joulemap.planner.route_planner import RoutePlanner

Within = Annotated[
    Annotated[float, within(CORRIDOR_PERCENT)] | None,
    Field(description="with start and goal: the corridor of routes so much dearer at most [%]"),
]


class FieldRequest(OnMap):
    """From where, to where, or both."""

    start: Place | None = None
    goal: Place | None = None
    within_percent: Within = None
    neighbours: Neighbours = 16
    snap: Snap = False


class Found(NamedTuple):
    """The energies, the corridor's share where one is wanted, and what the user should know of places."""

    energies: EnergyMap
    within: float | None
    notes: list[str]


def ask(planner: RoutePlanner, wanted: FieldRequest) -> Found:
    """Find the energies, over grid moves."""
    asked = on_map(planner, wanted)
    ends = {
        name: None if place is None else asked.places(place, name)
        for name, place in (("start", wanted.start), ("goal", wanted.goal))
    }
    energies, notes = asked.planner.field(**ends, neighbours=wanted.neighbours, snap=wanted.snap)
    share = None if wanted.within_percent is None else wanted.within_percent / 100.0
    return Found(energies, share, [*asked.places.notes, *notes])


def answer(found: Found, warnings: Sequence[str] = ()) -> dict[str, Any]:
    """The values of `FieldOut`."""
    import numpy as np

    energies = found.energies
    known = energies.energy_j[np.isfinite(energies.energy_j)]
    return {
        "kind": str(energies.kind),
        "cells": energies.energy_j.size,
        "reached": known.size,
        "least_j": float(known.min()) if known.size else None,
        "most_j": float(known.max()) if known.size else None,
        "corridor_cells": None if found.within is None else int(energies.corridor(found.within).sum()),
        "warnings": [*found.notes, *warnings],
    }
