"""What it takes to drive between many places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from joulemap.model.ranges import MAX_PLACES
from joulemap.service.questions.parts import BatteryIn, Neighbours, OnMap, Snap, battery_of, on_map
from joulemap.service.schemas.base import Place, ResponseModel

if TYPE_CHECKING:  # they take their time to load
    from collections.abc import Callable

    from joulemap.planner.questions.matrix import Matrix
    from joulemap.planner.route_planner import RoutePlanner

Values = list[list[float | None]]


class MatrixRequest(OnMap):
    """From which places to which."""

    starts: list[Place] = Field(
        min_length=1,
        max_length=MAX_PLACES,
        description="world points [m]",
        examples=[[[12.5, 40.5], [60.0, 50.0]]],
    )
    goals: list[Place] = Field(
        min_length=1,
        max_length=MAX_PLACES,
        description="world points [m]; the starts again, for the ways between all of them",
        examples=[[[80.0, 15.0]]],
    )
    neighbours: Neighbours = 32
    only_cheapest: bool = Field(
        default=False,
        description="for each start only the goal of least energy, such as the cheapest charger: one search for all",
    )
    snap: Snap = False
    battery: BatteryIn | None = Field(default=None, description="given: how likely it is that this battery lasts")


class MatrixOut(ResponseModel):
    """Energies between places: a row for each start, with a value for each goal; null where there is no way."""

    energies_j: Values = Field(description="least expected energy over grid moves [J]")
    lengths_m: Values = Field(description="horizontal length of that way [m]")
    energies_p05_j: Values | None = Field(description="5 % of drives take less [J]; null if unknown")
    energies_p95_j: Values | None = Field(description="95 % of drives take less [J]; null if unknown")
    probabilities: Values | None = Field(description="that the battery lasts; null if unknown or not asked for")
    reasons: list[list[str | None]] = Field(description="why there is no way; null where there is one")
    cheapest: list[int | None] = Field(description="for each start, the number of the goal of least energy")
    warnings: list[str]
    crs: str | None


@dataclass(frozen=True, eq=False)
class EnergyMatrix:
    """What it takes to drive from n starts to m goals, by the cheapest ways over grid moves.

    Attributes
    ----------
    energies_j : ndarray of float, (n, m)
        Expected energy [J]; infinite where there is no way, or none was asked for.
    lengths_m : ndarray of float, (n, m)
        Horizontal length [m]; likewise.
    reasons : list of list of str or None, (n, m)
        Why an energy is infinite.
    energies_p05_j, energies_p95_j : ndarray of float, (n, m), or None
        Energies that 5 % and 95 % of drives do not exceed [J]; None where the model does not know its uncertainty.
    probabilities : ndarray of float, (n, m), or None
        That the battery lasts, where one was given and the model knows its uncertainty.
    notes : tuple of str
        Where places were moved to, and how they were read.
    crs : str or None
        Coordinate reference system of the map.
    """

    energies_j: NDArray[np.float64]
    lengths_m: NDArray[np.float64]
    reasons: list[list[str | None]]
    energies_p05_j: NDArray[np.float64] | None
    energies_p95_j: NDArray[np.float64] | None
    probabilities: NDArray[np.float64] | None
    notes: tuple[str, ...]
    crs: str | None

    @property
    def cheapest(self) -> list[int | None]:
        """For each start the number of the goal of least energy, None where it reaches none."""
        return [int(np.argmin(row)) if np.isfinite(row).any() else None for row in self.energies_j]


def ask(
    planner: RoutePlanner, wanted: MatrixRequest, *, progress: Callable[[float], None] | None = None
) -> EnergyMatrix:
    """Find the energies, by one field for each start or for each goal, whichever are fewer.

    Their odds are those of ways on ground of the map's mean energy and uncertainty.
    """
    from joulemap.service.analysis.route_uncertainty import odds_of_energies

    asked = on_map(planner, wanted)
    given = {"start": wanted.starts, "goal": wanted.goals}
    ends = [[asked.places(place, f"{name} {k}") for k, place in enumerate(places)] for name, places in given.items()]
    how: dict[str, Any] = {name: getattr(wanted, name) for name in ("neighbours", "snap", "only_cheapest")}
    found: Matrix
    found, notes = asked.planner.matrix(*ends, progress=progress, **how)
    there, lattice = np.isfinite(found.energies_j), asked.planner.lattice
    odds = odds_of_energies(lattice, found.energies_j[there])

    def _spread(values: NDArray[np.float64], elsewhere: float) -> NDArray[np.float64]:
        whole = np.full(there.shape, elsewhere)
        whole[there] = values
        return whole

    low, high = (None if odds is None else _spread(odds.quantile(share), np.inf) for share in (0.05, 0.95))
    lasts = None
    if odds is not None and wanted.battery is not None:
        battery = battery_of(wanted.battery, lattice.robot)
        lasts = _spread(odds.lasts(battery.available_j), 0.0)
    if odds is None and wanted.battery is not None:
        notes = [*notes, "the model does not know its uncertainty, so nothing is said of whether the battery lasts"]
    notes = tuple(dict.fromkeys([*asked.places.notes, *notes]))
    return EnergyMatrix(found.energies_j, found.lengths_m, found.reasons, low, high, lasts, notes, lattice.frame.crs)


def answer(found: EnergyMatrix, warnings: list[str]) -> dict[str, Any]:
    """The values of `MatrixOut`."""

    def _values(array: NDArray[np.float64] | None) -> Values | None:
        return None if array is None else [[v if np.isfinite(v) else None for v in row] for row in array.tolist()]

    names = ("energies_j", "lengths_m", "energies_p05_j", "energies_p95_j", "probabilities")
    return {
        **{name: _values(getattr(found, name)) for name in names},
        "reasons": found.reasons,
        "cheapest": found.cheapest,
        "warnings": [*found.notes, *warnings],
        "crs": found.crs,
    }
