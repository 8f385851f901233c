"""What is expected of the rest of a drive, and why; and the charge of the battery along it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from joulemap.model.battery import Battery
from joulemap.model.loop.drive_filter import CAUSES, Ahead, DrivePrior
from joulemap.planner.verdict.budget import judge
from joulemap.planner.words import probability_words, range_words
from joulemap.service.driving.ahead import LENGTH_M, Metres
from joulemap.service.driving.tracking import OFF_ROUTE_M, Alarm, State, Tracking

_SURE = 0.95  # of either end of an interval
_SUBJECT = {
    "level": "driving takes",
    "ground": "rolling on this ground takes",
    "slope": "climbing takes",
    "power": "the power at rest takes",
}


@dataclass(frozen=True)
class Cause:
    """How much more something takes in this run than planned.

    Attributes
    ----------
    name : str
        One of `CAUSES`.
    share : float
        As a share of the plan; 0.31 is 31 % more.
    low, high : float
        5 % of its distribution lie below, and 5 % above.
    """

    name: str
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Forecast:
    """What is expected of the rest of a drive.

    Attributes
    ----------
    at_m : float
        Where the robot is, from the start of the route [m].
    left_m : float
        Length of the rest [m].
    off_route_m : float
        How far it is beside the route [m].
    used_j : float
        Energy drawn since the first sample [J].
    energy_j : float
        Expected energy of the rest [J].
    energy_p05_j : float
        Energy of the rest that 5 % of drives do not exceed [J].
    energy_p95_j : float
        Energy of the rest that 95 % of drives do not exceed [J].
    planned_j : float
        Energy of the rest as planned [J].
    left_s : float
        Time of the rest at the robot's speed [s].
    charge : float
        State of charge now, 0..1.
    charge_at_end : float
        Expected state of charge at the end, 0..1.
    probability : float
        That the battery lasts to the end with its reserve, 0.01..0.99.
    verdict : str
        "yes" (95 % likely, or more), "likely" (2/3), "marginal" (1/3) or "no".
    learnt_m : float
        Distance that was learnt from [m].
    more : Cause
        How much more the rest takes than planned, for what was learnt: the share of the one cause that is seen, or of
        all energy, named "level", where none is certain.
    causes : tuple of Cause
        Each cause by itself.
    alarms : tuple of Alarm
        Changes that were noticed, at most 20, the newest last.
    text : str
        All this in a sentence or two.
    """

    at_m: float
    left_m: float
    off_route_m: float
    used_j: float
    energy_j: float
    energy_p05_j: float
    energy_p95_j: float
    planned_j: float
    left_s: float
    charge: float
    charge_at_end: float
    probability: float
    verdict: str
    learnt_m: float
    more: Cause
    causes: tuple[Cause, ...]
    alarms: tuple[Alarm, ...]
    text: str

    def __str__(self) -> str:
        return self.text

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-able."""
        causes = {"more": asdict(self.more), "causes": [asdict(cause) for cause in self.causes]}
        return {**vars(self), **causes, "alarms": self.alarm_dicts()}

    def alarm_dicts(self) -> list[dict[str, Any]]:
        """Return the alarms, JSON-able, with their sentence."""
        return [alarm._asdict() | {"text": alarm_words(alarm)} for alarm in self.alarms]


def forecast(tracking: Tracking, ahead: Ahead, battery: Battery) -> Forecast:
    """Return what is expected of the rest of a drive. `battery`: at the start of the drive."""
    metres, state, known = tracking.metres, tracking.state, tracking.known()
    mean, scale = ahead.energy(place_of(metres, state.at_m), known)
    step, charge = half_width(known.prior), charge_now(state, battery)
    judged = judge(mean, replace(battery, charge=charge), std_j=scale, freedom=known.prior.freedom)
    rest = metres.up_to(metres.length_m) - metres.up_to(state.at_m)
    sizes = np.sqrt(np.diag(known.covariance))
    causes = tuple(
        Cause(name, float(u), float(u - step * s), float(u + step * s))
        for name, u, s in zip(CAUSES, known.mean, sizes, strict=False)
    )
    more = _more(causes, known.mean[:-1], known.covariance[:-1, :-1], rest[:-2], step)
    assert judged.probability is not None
    found = Forecast(
        at_m=state.at_m,
        left_m=metres.length_m - state.at_m,
        off_route_m=state.off_m,
        used_j=state.used_j,
        energy_j=mean,
        energy_p05_j=mean - step * scale,
        energy_p95_j=mean + step * scale,
        planned_j=float(rest[0]),
        left_s=float(rest[-1]),
        charge=charge,
        charge_at_end=judged.charge_at_end,
        probability=judged.probability,
        verdict=judged.verdict,
        learnt_m=state.learnt_m,
        more=more,
        causes=causes,
        alarms=state.alarms,
        text="",
    )
    return replace(found, text=_words(found))


def half_width(prior: DrivePrior) -> float:
    """Return half of the 90 % interval of a forecast, in its scale."""
    return float(stdtrit(prior.freedom or 1e9, _SURE))


def charge_now(state: State, battery: Battery) -> float:
    """Return the state of charge: as it was measured last, or at the start, less what was used since."""
    measured = not math.isnan(state.charge)
    begun, spent = (state.charge, state.used_j - state.used_at_charge_j) if measured else (battery.charge, state.used_j)
    return min(max(begun - spent / battery.full_j, 0.0), 1.0)


def place_of(metres: Metres, at_m: float) -> float:
    """Return a place in numbers of metres; the last metre may be shorter."""
    k = min(int(at_m), len(metres.marks_m) - 2)
    return k + (at_m - metres.marks_m[k]) / (metres.marks_m[k + 1] - metres.marks_m[k])


def alarm_words(alarm: Alarm) -> str:
    """Say what an alarm says."""
    return (
        f"Since about {alarm.since_m:.0f} m the robot takes {alarm.side} than expected from the metres before "
        f"(noticed at {alarm.at_m:.0f} m)."
    )


def _more(causes: tuple[Cause, ...], mean: np.ndarray, covariance: np.ndarray, rest: np.ndarray, step: float) -> Cause:
    """How much more the rest takes; or the one cause, in its own share, that explains most of it with 95 %."""
    planned = max(float(rest[0]), 1e-9)
    share = float(rest @ mean) / planned
    half = step * math.sqrt(max(float(rest @ covariance @ rest), 0.0)) / planned
    total = Cause("level", share, share - half, share + half)
    if total.low <= 0.0 <= total.high:
        return total
    for k, cause in enumerate(causes[1:], 1):
        beyond = math.copysign(1.0, share) * rest  # what this cause takes, less what all others take
        beyond[np.arange(len(rest)) != k] *= -1.0
        if beyond @ mean > step * math.sqrt(max(float(beyond @ covariance @ beyond), 0.0)):
            return cause
    return total


def _words(found: Forecast) -> str:
    if found.left_m < LENGTH_M.low:
        used = range_words(found.used_j, found.used_j, found.used_j).split(",")[0]
        arrived = f"The robot has arrived: it drew {used}, and {100.0 * found.charge:.0f} % of the battery is left."
        return " ".join([arrived, *(alarm_words(alarm) for alarm in found.alarms[-1:])])
    more, side = found.more, "more" if found.more.share >= 0.0 else "less"
    ends = sorted(abs(100.0 * end) for end in (more.low, more.high))
    if more.low <= 0.0 <= more.high:
        why = "as planned so far" if found.learnt_m else "nothing is learnt yet"
    else:
        why = f"{_SUBJECT[more.name]} {abs(100.0 * more.share):.0f} % {side} than planned, "
        why += f"{ends[0]:.0f} to {ends[1]:.0f} %"
    words = (
        f"the remaining {found.left_m:.0f} m take "
        f"{range_words(found.energy_j, found.energy_p05_j, found.energy_p95_j)} "
        f"({why}); the battery lasts with a probability of "
        f"{probability_words(found.probability)}, with {100.0 * found.charge_at_end:.0f} % left at the end."
    )
    if found.off_route_m > OFF_ROUTE_M:
        words += f" The robot is {found.off_route_m:.0f} m beside its route, and nothing is learnt there."
    if found.alarms:
        words += f" {alarm_words(found.alarms[-1])}"
    return words


PLACES = 100
"""Setting: places ahead of the robot at which the charge is given, at most: a curve on a screen needs no more."""


class ChargeAt(NamedTuple):
    """A place of the route.

    Attributes
    ----------
    distance_m : float
        From the start [m].
    x, y : float
        In the world [m].
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
