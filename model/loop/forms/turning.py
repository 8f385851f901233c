"""Turning: tyres or tracks that scrub sideways over the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.features import Features
from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.track import TURN_LIMITS_RADPS

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Turning(Form):
    """Turning to either side, up to a rate at which the power of scrubbing saturates.

    Attributes
    ----------
    limit_radps : float, optional
        Rate above which a faster turn takes no more power [rad/s]; one of `TURN_LIMITS_RADPS`. Without it every radian
        costs the same.

    References
    ----------
    Morales et al. 2009, "Power consumption modeling of skid-steer tracked mobile robots on rigid terrain".
    """

    limit_radps: float | None = None

    key = "turning"
    label = "turning"
    meaning = "energy per radian of heading change"
    unit = "{E}/rad"
    reveals = "circles of several radii at one place"
    low = 0.0

    @property
    def covariates(self) -> tuple[str, ...]:
        return ("turning",)

    @property
    def tuned(self) -> int:
        return int(self.limit_radps is not None)

    def column(self, rows: Features) -> FloatArray:
        if self.limit_radps is None:
            return rows.turned_abs_rad
        return rows.gentle_turn_rad[:, TURN_LIMITS_RADPS.index(self.limit_radps)]

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield cls()
        yield from (cls(limit) for limit in TURN_LIMITS_RADPS)

    def where(self, coefficients: tuple[float, ...]) -> str:
        if self.limit_radps is None:
            return "everywhere"
        return f"everywhere; a turn faster than {self.limit_radps:g} rad/s takes no more power than one at that rate"
