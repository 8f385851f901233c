"""What the log of a drive says, sample by sample: where the robot is, what it took, and what that teaches the filter.

Samples may come in any order within `LATE_S`: a late one is put where it belongs, and those after it are read again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from joulemap.model.errors import InputError
from joulemap.model.loop.drive_alarms import Cusum, threshold_of
from joulemap.model.loop.drive_filter import DriveFilter, DrivePrior, limited
from joulemap.service.driving.ahead import BACK_M, FASTEST, Metres

LATE_S = 5.0
"""Setting: a sample may be so much older than the newest [s]. An older one, and one that was there already, is not
used."""
MOST_HELD = 1000
"""Samples that are kept for late ones: 200 a second."""
GAP_S = 10.0
"""Setting: longest time between samples over which the power is interpolated and learnt from [s]."""
LONGEST_GAP_S = 3600.0
"""Setting: over a longer time without samples the mean of the powers at its ends says nothing of what was taken, and
the clock may have jumped [s]. A break at midday is shorter."""
OFF_ROUTE_M = 3.0
"""Setting: beside the route by more, the robot drives over other ground, from which nothing is learnt [m]. It is
less than the error of a fix without corrections: such a robot learns where its fixes are good."""
MOST_ALARMS = 20
"""The newest alarms that are kept."""
_ROW_M = 1.0
_TRAIL = 100


class Sample(NamedTuple):
    """A moment of a drive: time [s], world x, y [m], power drawn [W], and the state of charge 0..1, NaN if unknown."""

    time_s: float
    x: float
    y: float
    power_w: float
    charge: float = math.nan


class Alarm(NamedTuple):
    """A change that was noticed.

    Attributes
    ----------
    at_m : float
        Where it was noticed, from the start [m].
    since_m : float
        Where it probably began [m].
    time_s : float
        Time of the sample at which it was noticed [s].
    side : str
        "more" or "less".
    """

    at_m: float
    since_m: float
    time_s: float
    side: str


@dataclass
class State:
    """All that is known of a drive after some samples; the row is the stretch that is not learnt from yet."""

    mean: list[float]
    covariance: list[list[float]]
    last: Sample | None = None
    at_m: float = 0.0
    off_m: float = 0.0
    used_j: float = 0.0
    learnt_m: float = 0.0
    row_m: float | None = None
    row_j: float = 0.0
    row_s: float = 0.0
    charge: float = math.nan
    used_at_charge_j: float = 0.0
    cusum: Cusum = field(default_factory=Cusum)
    alarms: tuple[Alarm, ...] = ()
    trail: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    """Places [m] and the energy drawn up to each [J], for who looks back: at most `_TRAIL` + 1."""


class Tracking:
    """Follows a drive along a route."""

    def __init__(self, metres: Metres, prior: DrivePrior, idle_power_w: float, speed_mps: float) -> None:
        self.metres, self.prior = metres, prior
        self._idle_w, self._speed_mps = idle_power_w, speed_mps
        self._threshold = threshold_of(metres.length_m)
        start = DriveFilter(prior)
        self.state = State(start.mean.tolist(), start.covariance.tolist())
        self._recent: list[tuple[Sample, State]] = []
        """Samples of the last `LATE_S`, and the state before each."""
        self.unused = 0

    def known(self) -> DriveFilter:
        """Return what is known of this run."""
        return self._known(self.state)

    def _known(self, state: State) -> DriveFilter:
        known = DriveFilter(self.prior)
        known.mean, known.covariance = np.array(state.mean), np.array(state.covariance)
        return known

    def add(self, samples: Iterable[Sample]) -> None:
        """Take in samples that came together, in any order. Raises InputError, and takes in none, if one is wrong."""
        given = list(samples)
        recent, state, unused = self._recent, self.state, len(given)
        if self._first_was_wrong(given):
            recent, state, unused = [], recent[0][1], unused + 1
        new = _not_known(given, recent, state)
        if not new:
            self.unused += unused
            return
        first = min(new)
        place = next((k for k, (one, _) in enumerate(recent) if one.time_s > first), len(recent))
        before = recent[place][1] if place < len(recent) else state
        coming = sorted([*new.values(), *(one for one, _ in recent[place:])])
        _check_gaps(before.last, coming)
        self.unused += unused - len(new)
        self._recent, self.state = recent[:place], before
        for one in coming:
            self._recent.append((one, self.state))
            self.state = self._after(self.state, one)
        oldest = coming[-1].time_s - LATE_S
        kept = next(k for k, (one, _) in enumerate(self._recent) if one.time_s >= oldest)
        del self._recent[: max(kept, len(self._recent) - MOST_HELD)]

    def _first_was_wrong(self, given: list[Sample]) -> bool:
        """Whether the only sample so far, from which nothing follows yet, is of another clock than all that come now:
        that of a computer that did not know the time yet.
        """
        if len(self._recent) != 1 or self._recent[0][1].last is not None:
            return False
        only = self._recent[0][0].time_s
        return all(abs(one.time_s - only) > LONGEST_GAP_S for one in given)

    def keep_learnt(self, before: Tracking) -> None:
        """Go on with what was learnt of this run on another route."""
        known = before.state
        self.state = replace(self.state, mean=known.mean, covariance=known.covariance, learnt_m=known.learnt_m)

    def as_dict(self) -> dict[str, Any]:
        """Return all that another process needs to go on, JSON-able."""
        before = self._recent[0][1] if self._recent else self.state
        return {"state": _written(before), "recent": [_plain(one) for one, _ in self._recent], "unused": self.unused}

    def restore(self, values: Mapping[str, Any]) -> None:
        """Go on from what `as_dict` wrote."""
        self.state, self._recent = _read(values["state"]), []
        self.add(_sample(one) for one in values["recent"])
        self.unused = int(values["unused"])

    def _after(self, before: State, sample: Sample) -> State:
        """The state after a sample."""
        state = replace(before, last=sample, cusum=replace(before.cusum))
        if math.isfinite(sample.charge):
            state.charge, state.used_at_charge_j = sample.charge, before.used_j
        if before.last is None:
            self._place(state, 0.0, self.metres.length_m)
            state.row_m = state.at_m if state.off_m <= OFF_ROUTE_M else None
            return state
        seconds = sample.time_s - before.last.time_s
        energy = 0.5 * (sample.power_w + before.last.power_w) * seconds
        state.used_j += energy
        if before.off_m > OFF_ROUTE_M or seconds > GAP_S:  # it may be anywhere by now
            low, high = before.at_m - BACK_M, self.metres.length_m
        else:
            low, high = before.at_m - BACK_M, before.at_m + BACK_M + FASTEST * self._speed_mps * seconds
        self._place(state, max(low, 0.0), min(high, self.metres.length_m))
        if state.off_m > OFF_ROUTE_M:
            state.row_m = None
        elif before.row_m is None or seconds > GAP_S or state.at_m < before.row_m - BACK_M:
            state.row_m, state.row_j, state.row_s = state.at_m, 0.0, 0.0
        else:
            state.row_j += energy
            state.row_s += seconds
            if state.at_m - before.row_m >= _ROW_M:
                self._learn(state, before.row_m)
        return state

    def _place(self, state: State, low_m: float, high_m: float) -> None:
        """Note where on the route the last sample is; from beside it nothing follows, and a wild fix moves nobody."""
        assert state.last is not None
        at, state.off_m = self.metres.nearest(state.last.x, state.last.y, low_m, high_m)
        if state.off_m <= OFF_ROUTE_M:
            state.at_m = at
            if at >= state.trail[-1][0] + self.metres.length_m / _TRAIL:
                state.trail = (*state.trail, (at, state.used_j))

    def _learn(self, state: State, begin_m: float) -> None:
        """Learn from the row that ends here."""
        row = self.metres.up_to(state.at_m) - self.metres.up_to(begin_m)
        longer_j = self._idle_w * (state.row_s - float(row[-1]))  # than planned
        columns, known = row[:-2] + np.array([longer_j, 0.0, 0.0, longer_j]), self._known(state)
        length = np.array([state.at_m - begin_m])
        steps = known.learn(columns[None], np.array([state.row_j]), np.sqrt(row[-2:-1]), length)
        found = state.cusum.add(float(limited(steps)[0]) / self.prior.change_std, begin_m, self._threshold)
        if found is not None:
            assert state.last is not None
            alarm = Alarm(state.at_m, found[1], state.last.time_s, found[0])
            state.alarms = (*state.alarms, alarm)[-MOST_ALARMS:]
            known.widen()
        state.mean, state.covariance = known.mean.tolist(), known.covariance.tolist()
        state.learnt_m += float(length[0])
        state.row_m, state.row_j, state.row_s = state.at_m, 0.0, 0.0


def _not_known(given: list[Sample], recent: list[tuple[Sample, State]], state: State) -> dict[float, Sample]:
    """Those that are neither too late nor there already, by their time."""
    known = {one.time_s for one, _ in recent}
    before = recent[0][1] if recent else state
    read = -math.inf if before.last is None else before.last.time_s
    oldest = -math.inf if state.last is None else state.last.time_s - LATE_S
    new: dict[float, Sample] = {}
    for sample in given:
        if not all(math.isfinite(value) for value in sample[:4]):
            raise InputError(f"a sample needs finite time, place and power, got {sample}")
        if sample.time_s > read and sample.time_s >= oldest and sample.time_s not in known:
            new.setdefault(sample.time_s, sample)
    return new


def _check_gaps(last: Sample | None, samples: list[Sample]) -> None:
    for before, after in pairwise(samples if last is None else [last, *samples]):
        if (gap := after.time_s - before.time_s) > LONGEST_GAP_S:
            raise InputError(
                f"a sample at {after.time_s:g} s comes {gap:g} s after the one before, at most {LONGEST_GAP_S:g} s are "
                "followed: begin a new drive, or leave the sample out if its clock was wrong",
                found=gap,
                limit=LONGEST_GAP_S,
            )


def _plain(sample: Sample) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in sample]


def _sample(values: list[float | None]) -> Sample:
    return Sample(*(math.nan if value is None else value for value in values))


def _written(state: State) -> dict[str, Any]:
    last = None if state.last is None else _plain(state.last)
    charge = state.charge if math.isfinite(state.charge) else None
    return {**vars(state), "last": last, "charge": charge, "cusum": asdict(state.cusum)}


def _read(values: Mapping[str, Any]) -> State:
    return State(
        **{
            **values,
            "last": None if values["last"] is None else _sample(values["last"]),
            "charge": math.nan if values["charge"] is None else values["charge"],
            "cusum": Cusum(**values["cusum"]),
            "alarms": tuple(Alarm(*alarm) for alarm in values["alarms"]),
            "trail": tuple((at_m, used_j) for at_m, used_j in values["trail"]),
        }
    )
