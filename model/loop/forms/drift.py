"""Time: what grows over a run or over a day."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity

_NIGHT_S = 43_200.0  # without a stamp: runs with less than half a day between them are of one day


@dataclass(frozen=True)
class Drift(Form):
    """A share of everything, or energy per metre, that grows in proportion to time or distance.

    Attributes
    ----------
    over : str
        `since_start`, `driven`, or `clock` for the time since the first stamp of the day.
    start : float or tuple of float
        First stamp of each day of the runs.
    end : float
        Largest value of the covariate in the runs, up to which it grows.
    of_all : bool
        A share of the predicted energy instead of energy per metre.
    """

    over: str
    start: float | tuple[float, ...] = ()
    of_all: bool = True
    end: float | None = None

    key = "drift"
    resists = True
    label = "drift over time or distance"
    meaning = "energy added per hour or per kilometre"
    reveals = "the same loop at the start and at the end of a long day"
    planned = False

    @property
    def per(self) -> tuple[float, str]:
        """Amount of the covariate to which a coefficient belongs, and its unit."""
        return (3600.0, "h") if self.over in ("since_start", "clock") else (1000.0, "km")

    def units(self, energy: str) -> tuple[str, ...]:
        return (f"{'1' if self.of_all else energy + '/m'}/{self.per[1]}",)

    def column(self, rows: Features) -> FloatArray:
        amount = rows.hotel_and_motion if self.of_all else rows.work_m * rows.pulling
        since = _of_day(rows.clock_s, self.start)[0] if self.over == "clock" else quantity(rows, self.over)
        return amount * np.clip(since, 0.0, self.end) / self.per[0]

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        since, start = _of_day(rows.clock_s)
        for over in ("since_start", "driven", "clock"):
            end = float((since if over == "clock" else quantity(rows, over)).max())
            yield from (cls(over, start if over == "clock" else (), of_all, end) for of_all in (True, False))


def _of_day(clock_s: FloatArray, start: float | tuple[float, ...] = ()) -> tuple[FloatArray, tuple[float, ...]]:
    """Time since the first stamp of each row's day, (n,), and the first stamps of all days. start : known stamps."""
    stamps = np.unique(np.append(clock_s, start))
    first = stamps[np.diff(stamps, prepend=-np.inf) > _NIGHT_S]
    return clock_s - first[np.searchsorted(first, clock_s, side="right") - 1], tuple(first.tolist())
