"""Turning: tyres or tracks that scrub sideways over the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Turning(Form):
    """Turning to either side, up to a curvature at which scrubbing saturates.

    Reference: Morales et al. 2009, "Power consumption modeling of skid-steer tracked mobile robots on rigid terrain".

    Attributes
    ----------
    limit_per_m : float, optional
        Curvature above which a tighter turn takes no more current from motors [rad/m]. Without it every radian costs
        the same.
    """

    limit_per_m: float | None = None

    key = "turning"
    label = "turning"
    meaning = "energy per radian of heading change"
    unit = "{E}/rad"
    reveals = "circles of several radii at one place"
    covariates = ("turning",)
    low = 0.0

    def column(self, rows: Features) -> FloatArray:
        return rows.slowness * rows.turned_up_to(self.limit_per_m)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        if rows.drives.motor_speed_mps is None:
            yield cls()
        else:
            yield from (cls(round(share * rows.pivot_per_m, 6)) for share in (1.0, 0.5, 2.0))

    def where(self, coefficients: tuple[float, ...]) -> str:
        if self.limit_per_m is None:
            return "everywhere"
        return f"everywhere; a curve of a radius below {1.0 / self.limit_per_m:.2g} m takes no more current"
