"""Uphill: losses with the grade."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Climbing(Form):
    """Share of the energy of climbing that is added.

    Reference: Wong 2008, "Theory of Ground Vehicles", section 2.9 (slip and tractive effort).

    Attributes
    ----------
    slipping : bool
        A share of the whole traction that grows with the grade, as of wheels that slip: 1 / (1 - s) with s in
        proportion to the grade, to first order.
    """

    slipping: bool = False

    key = "climbing"
    label = "climbing"
    meaning = "share of the energy of climbing that is added"
    reveals = "straight climbs of several grades"
    covariates = ("grade",)
    low = 0.0
    options: ClassVar = {"slipping": (False, True)}

    @property
    def name(self) -> str:
        return "slip" if self.slipping else self.key

    @property
    def title(self) -> str:
        return "wheel slip on climbs" if self.slipping else self.label

    def units(self, energy: str) -> tuple[str, ...]:
        return ("1/tan" if self.slipping else "",)

    def column(self, rows: Features) -> FloatArray:
        up = rows.along(lambda grades: np.maximum(grades, 0.0))
        return rows.motion_part * up if self.slipping else rows.weight_length * up
