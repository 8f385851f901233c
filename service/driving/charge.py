"""The battery along a drive: what it had behind the robot, and what is expected ahead of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from joulemap.model.battery import Battery
from joulemap.model.loop.drive_filter import Ahead
from joulemap.service.driving.forecast import charge_now, half_width
from joulemap.service.driving.tracking import Tracking

PLACES = 100
"""Setting: places ahead of the robot at which the charge is given, at most: a curve on a screen needs no more."""


class ChargeAt(NamedTuple):
    """A place of the route.

    Attributes
    ----------
    distance_m, x, y : float
        From the start, and in the world [m].
    planned : float
        State of charge there as planned; below 0 where the battery would be empty before.
    charge, low, high : float
        What it was behind the robot; ahead of it what is expected, and the ends of the 90 % interval, 0..1.
    """

    distance_m: float
    x: float
    y: float
    planned: float
    charge: float
    low: float
    high: float


def charge_along(tracking: Tracking, battery: Battery) -> list[ChargeAt]:
    """Return the charge along a route, in order. `battery`: at the start of the drive."""
    metres, state, known = tracking.metres, tracking.state, tracking.known()
    now = charge_now(state, battery)

    def _place(at_m: float, used_j: float, half_j: float) -> ChargeAt:
        planned = battery.charge - float(metres.up_to(at_m)[0]) / battery.full_j
        charge, half = now - (used_j - state.used_j) / battery.full_j, half_j / battery.full_j
        known = (min(max(share, 0.0), 1.0) for share in (charge, charge - half, charge + half))
        return ChargeAt(at_m, *metres.point(at_m), planned, *known)

    found = [_place(at_m, used_j, 0.0) for at_m, used_j in state.trail if at_m < state.at_m]
    found.append(_place(state.at_m, state.used_j, 0.0))
    first = int(np.searchsorted(metres.marks_m, state.at_m, side="right"))  # the end of the metre where it is
    columns, std = metres.columns[first - 1 :].copy(), metres.std_j[first - 1 :].copy()
    ends = metres.marks_m[first:]
    if not len(ends):
        return found
    left = (ends[0] - state.at_m) / (ends[0] - metres.marks_m[first - 1])
    columns[0], std[0] = left * columns[0], left * std[0]
    for k in np.unique(np.append(np.arange(0, len(ends), math.ceil(len(ends) / PLACES)), len(ends) - 1)).tolist():
        mean, scale = Ahead.of(known.prior, columns[: k + 1], std[: k + 1]).energy(0.0, known)
        found.append(_place(float(ends[k]), state.used_j + mean, half_width(known.prior) * scale))
    return found
