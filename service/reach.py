"""Reach of a battery: the planner's fields joined with the distribution of a route's energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.planner.areas.reach import Need, peak_need
from joulemap.planner.areas.reach_map import ReachMap
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.service.route_uncertainty import odds_along

MOST_CHARGES = 10
CONFIDENCE = (0.5, 0.99)
"""Least and most that may be asked for: beyond it the tails of the distribution are not known."""


def reach_map(
    planner: RoutePlanner | StoredPlanner,
    start_xy: tuple[float, float],
    battery: Battery,
    *,
    charges: Sequence[float] | None = None,
    confidence: float | None = None,
    round_trip: bool = False,
    snap: bool = False,
) -> ReachMap:
    """Return where a battery lasts to.

    `start_xy`: world x, y [m]. Result: a margin for each charge, in the order given. Raises BlockedError if the start
    is on blocked ground, and `snap` is off or finds nothing.
    """
    levels = (battery.charge,) if charges is None else tuple(float(charge) for charge in charges)
    if not 1 <= len(levels) <= MOST_CHARGES:
        raise InputError(f"`charges` has {len(levels)} values; from 1 to {MOST_CHARGES} can be answered at a time")
    batteries = [replace(battery, charge=charge) for charge in levels]
    if isinstance(planner, StoredPlanner):
        raise InputError(
            "a map of reach needs the whole cost map in memory, and this one is planned on from disk: make a cost map "
            "with a coarser spacing"
        )
    if confidence is not None:
        _check_confidence(planner.lattice, confidence)
    found, notes = planner.reach(start_xy, round_trip=round_trip, snap=snap)
    need = peak_need if confidence is None else _need_with(confidence)
    available = tuple(each.available_j for each in batteries)
    margins = np.stack([found.margin_j(energy, need=need) for energy in available])
    x, y = planner.lattice.frame.xy(*found.out.places[0])
    question = {
        "start": [float(x), float(y)],
        "charges": list(levels),
        "available_j": list(available),
        "reserve": battery.reserve,
        "round_trip": round_trip,
        "confidence": confidence,
    }
    record = {**planner.lattice.provenance, "reach": question}
    frame = planner.lattice.frame
    return ReachMap(
        frame, (float(x), float(y)), levels, available, round_trip, confidence, margins, record, tuple(notes)
    )


def _need_with(confidence: float) -> Need:
    """The energy that is enough with a probability, at every point of the routes."""

    def _need(routes: Sequence[Route]) -> float:
        odds = odds_along(routes)
        assert odds is not None  # the lattice was asked
        return float(odds.quantile(confidence).max(initial=0.0))

    return _need


def _check_confidence(lattice: CostLattice, confidence: float) -> None:
    if not CONFIDENCE[0] <= confidence <= CONFIDENCE[1]:
        raise InputError(
            f"the confidence is {confidence:g}; it must lie from {CONFIDENCE[0]:g} to {CONFIDENCE[1]:g}, because the "
            "tails of the distribution of errors are not known",
            confidence=confidence,
        )
    if lattice.std_j is None or lattice.provenance.get("model", {}).get("spread") is None:
        raise InputError(
            "the model of this cost map does not know its uncertainty, so no confidence can be given: leave it out, or "
            "use a model that was trained or calibrated on runs",
            confidence=confidence,
        )
