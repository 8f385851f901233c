"""Energy fields as products: arrays of the size of the map, for xarray and GeoTIFF, and the corridor of good routes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.planner.grid.fields import EnergyField
from joulemap.planner.grid.search import no_route
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.xarray_dataset import GRID, Variable, coordinates_of

if TYPE_CHECKING:
    import xarray


class FieldKind(StrEnum):
    """What the energy of a cell is that of."""

    FROM = "from"
    TO = "to"
    THROUGH = "through"


_WORDS = {
    FieldKind.FROM: "least energy from the start to the cell",
    FieldKind.TO: "least energy from the cell to the nearest goal",
    FieldKind.THROUGH: "least energy from the start over the cell to the nearest goal",
}


@dataclass(frozen=True, eq=False, repr=False)
class EnergyMap:
    """Least energies over grid moves, cell by cell.

    Attributes
    ----------
    frame : GridFrame
        Where the cells lie.
    kind : FieldKind
        From a start, to goals, or from a start over the cell to goals.
    energy_j : ndarray of float32, (rows, cols)
        Least energy [J]; NaN where there is no path.
    provenance : dict
        JSON-able record: the cost lattice's, with `field`, the kind and the places [x, y].
    """

    frame: GridFrame
    kind: FieldKind
    energy_j: NDArray[np.float32]
    provenance: dict[str, Any]

    @property
    def least_j(self) -> float:
        """The least energy of any cell [J]: of a map through cells, that of the best route over grid moves."""
        return float(np.nanmin(self.energy_j)) if np.isfinite(self.energy_j).any() else np.nan

    def corridor(self, within: float) -> NDArray[np.bool_]:
        """Return where routes lie that cost at most a share more than the best one.

        Parameters
        ----------
        within : float
            Share of the best route's energy, for example 0.05.

        Returns
        -------
        ndarray of bool, (rows, cols)
            True in every cell that such a route over grid moves may cross.

        Raises
        ------
        InputError
            If `within` is negative, or the map is not one through cells.
        NoRouteError
            If no route joins start and goal.
        """
        if self.kind is not FieldKind.THROUGH:
            raise InputError(f"a corridor needs a start and a goal, and this is a map of energies {self.kind} a place")
        if not 0.0 <= within < np.inf:
            raise InputError(f"`within` is {within}: give a share of the best route's energy of at least 0")
        if np.isnan(self.least_j):
            raise NoRouteError("no route joins start and goal within the robot's limits")
        rounding = 1e-6 * abs(self.least_j)
        return self.energy_j <= self.least_j + within * abs(self.least_j) + rounding

    def to_xarray(self, *, within: float | None = None) -> xarray.Dataset:
        """Return the energies with coordinates and units.

        Parameters
        ----------
        within : float, optional
            Add `corridor`, see there.

        Returns
        -------
        xarray.Dataset
            Over `y`, `x` [m]: `energy_j` [J].
        """
        import xarray

        data: dict[str, Variable] = {
            "energy_j": (GRID, self.energy_j, {"units": "J", "long_name": _WORDS[self.kind]}),
        }
        if within is not None:
            words = f"whether a route that costs at most {100 * within:g} % more than the best one may cross the cell"
            data["corridor"] = (GRID, self.corridor(within).astype(np.uint8), {"units": "1", "long_name": words})
        coordinates = coordinates_of(self.frame, 4, components=False)
        del coordinates["heading"]
        attributes = {"Conventions": "CF-1.11", "title": _WORDS[self.kind], "provenance": json.dumps(self.provenance)}
        return xarray.Dataset(data, coords=coordinates, attrs=attributes)

    def geotiff(self, *, within: float | None = None) -> bytes:
        """Return the energies as a GeoTIFF file.

        Parameters
        ----------
        within : float, optional
            Add a band that is 1 in the corridor and 0 elsewhere, see `corridor`.

        Returns
        -------
        bytes
            The file: float32 [J], NaN (nodata) where there is no path.
        """
        bands, words = [self.energy_j], [f"{_WORDS[self.kind]} [J]"]
        if within is not None:
            bands.append(self.corridor(within).astype(np.float32))
            words.append(f"corridor of all routes within {100 * within:g} % of the best")
        tags = {"JOULEMAP": json.dumps(self.provenance)}
        from joulemap.model.terrain.writers import write_bands_geotiff  # loads GDAL

        written = write_bands_geotiff(None, np.stack(bands), self.frame, descriptions=words, tags=tags)
        assert written is not None
        return written


def energy_map(out: EnergyField | None, back: EnergyField | None) -> EnergyMap:
    """Return a field, or the sum of one from a start and one towards goals, as a map.

    Parameters
    ----------
    out : EnergyField or None
        From a start, made by `field_from`.
    back : EnergyField or None
        Towards goals, made by `field_towards`, on the same moves.

    Returns
    -------
    EnergyMap
        With both, energies through cells: where turning costs, the robot leaves a cell in the heading that it came in.

    Raises
    ------
    InputError
        If both are None.
    NoRouteError
        If no route joins the two.
    """
    known = [field for field in (out, back) if field is not None]
    if not known:
        raise InputError("a field needs a start, a goal, or both")
    lattice: CostLattice = known[0].lattice
    total = sum(field.search.energy_j for field in known)
    states = np.asarray(total).reshape(*lattice.frame.shape, known[0].search.layers).min(axis=2)
    energy = np.where(np.isfinite(states), states, np.nan).astype(np.float32)
    if not np.isfinite(energy).any():
        raise no_route(lattice.robot, int(np.isfinite(known[0].energy_j).sum()))
    kind = FieldKind.THROUGH if len(known) == 2 else FieldKind.TO if out is None else FieldKind.FROM
    record: dict[str, Any] = {"kind": str(kind)}
    for name, field in (("start", out), ("goals", back)):
        if field is not None:
            x, y = lattice.frame.xy(field.places[:, 0], field.places[:, 1])
            record[name] = np.column_stack([x, y]).tolist()
    return EnergyMap(lattice.frame, kind, energy, {**lattice.provenance, "field": record})
