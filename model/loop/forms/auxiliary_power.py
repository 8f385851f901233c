"""Auxiliary power: what a heater, a computer or an arm takes from the same battery, where it was logged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity
from joulemap.model.runs.units import watts_of_column


@dataclass(frozen=True)
class AuxiliaryPower(Form):
    """Energy in proportion to a logged power of something that is no drive.

    Attributes
    ----------
    logged : str
        The logged column.
    watts : float
        Of one unit of it [W].
    """

    logged: str
    watts: float = 1.0

    key = "auxiliary_power"
    label = "auxiliary power"
    meaning = "watts that the battery gives for each logged watt, on top of what the base model counts"
    unit = ""
    reveals = "the same drive with it switched on and off"
    planned = False
    low = 0.0
    high = 1.3  # the wiring and the converter in between lose up to a quarter (DC-DC converters: 80 to 95 %)

    @property
    def name(self) -> str:
        return f"{self.key}:{self.logged}"

    @property
    def title(self) -> str:
        return f"auxiliary power ({self.logged})"

    @property
    def covariates(self) -> tuple[str, ...]:  # type: ignore[override]
        return (f"column:{self.logged}",)

    def column(self, rows: Features) -> FloatArray:
        return self.watts * quantity(rows, f"column:{self.logged}") * rows.duration_s / rows.unit_j

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        for column in rows.columns:
            if (watts := watts_of_column(column)) is not None:
                yield cls(column, watts)
