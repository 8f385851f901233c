"""Reach as a product: what is left of some batteries at every cell, as contours, GeoTIFF and xarray."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import contourpy
import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.planner.lattice.xarray_dataset import coordinates_of

if TYPE_CHECKING:
    import xarray

Ring = NDArray[np.float64]
"""(n, 2) world x, y [m]; the last point is the first one."""


@dataclass(frozen=True, eq=False, repr=False)
class ReachMap:
    """Where a battery lasts to, for some charges.

    Attributes
    ----------
    frame : GridFrame
        Where the cells lie.
    start : tuple of float
        World x, y of the start [m].
    charges : tuple of float
        (n,) states of charge at the start, 0..1.
    available_j : tuple of float
        (n,) energy above the reserve of each [J].
    round_trip : bool
        Whether it must come back to the start.
    confidence : float or None
        Probability with which the battery lasts on the border; None where the border is that of the expected energy.
    margin_j : ndarray of float32, (n, rows, cols)
        What is left above the reserve [J]: negative where the battery does not last, NaN where no route leads.
    provenance : dict
        JSON-able record: the cost lattice's, with `reach`, the question.
    notes : tuple of str
        Where the start was moved to, if it was.
    """

    frame: GridFrame
    start: tuple[float, float]
    charges: tuple[float, ...]
    available_j: tuple[float, ...]
    round_trip: bool
    confidence: float | None
    margin_j: NDArray[np.float32]
    provenance: dict[str, Any]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"ReachMap({self})"

    def __str__(self) -> str:
        how = "there and back" if self.round_trip else "one way"
        sure = "" if self.confidence is None else f", with a probability of {self.confidence:.0%}"
        areas = "; ".join(
            f"{100 * charge:g} % charge: {self.area_m2(k):,.0f} m2" for k, charge in enumerate(self.charges)
        )
        return f"reach {how}{sure}: {areas}"

    def reached(self, k: int = 0) -> NDArray[np.bool_]:
        """Return the cells where the battery lasts.

        Parameters
        ----------
        k : int, default 0
            Which of the charges.

        Returns
        -------
        ndarray of bool, (rows, cols)
            False on blocked ground.
        """
        return self.margin_j[k] >= 0.0

    def area_m2(self, k: int = 0) -> float:
        """Return the area where the battery lasts.

        Parameters
        ----------
        k : int, default 0
            Which of the charges.

        Returns
        -------
        float
            Horizontal area [m2].
        """
        return float(self.reached(k).sum()) * self.frame.resolution_m**2

    def margin_at(self, x: float, y: float, k: int = 0) -> float:
        """Return what is left at a place.

        Parameters
        ----------
        x, y : float
            World point [m].
        k : int, default 0
            Which of the charges.

        Returns
        -------
        float
            Energy above the reserve [J]; NaN where no route leads.

        Raises
        ------
        PointError
            If the point is not finite or lies outside the map.
        """
        row, col = self.frame.cell_of(x, y, name="the place")
        return float(self.margin_j[k][row, col])

    def polygons(self, k: int = 0) -> list[list[Ring]]:
        """Return the outlines of where the battery lasts.

        Parameters
        ----------
        k : int, default 0
            Which of the charges.

        Returns
        -------
        list of list of Ring
            Of each part the outer ring, anticlockwise, and those of its holes, clockwise. Between cells the margin is
            interpolated; the rim of blocked ground lies half-way between a cell that is reached and one that is not.
        """
        margin = self.margin_j[k].astype(np.float64)
        if not self.reached(k).any():
            return []
        low = -max(float(np.nanmedian(np.abs(margin))), 1e-9)
        # a frame of cells that are not reached closes the outlines at the rim of the map
        padded = np.pad(np.where(np.isnan(margin), low, np.maximum(margin, low)), 1, constant_values=low)
        # where blocked ground begins is not a matter of energy: its margin mirrors that of the neighbour
        blocked = np.pad(np.isnan(margin), 1, constant_values=True)
        padded[blocked] = -_largest_around(np.where(blocked, 0.0, np.maximum(padded, 0.0)))[blocked] - 1e-9
        drawn: Any = contourpy.contour_generator(z=padded, fill_type=contourpy.FillType.OuterOffset)
        outlines, offsets = drawn.filled(0.0, float(padded.max()) + 1.0)
        parts = []
        for outline, offset in zip(outlines, offsets, strict=True):
            x, y = self.frame.xy(outline[:, 1] - 1.0, outline[:, 0] - 1.0)
            points = np.column_stack([x, y])
            rings = [points[a:b] for a, b in zip(offset[:-1], offset[1:], strict=True)]
            parts.append([_turned(ring, outer=i == 0) for i, ring in enumerate(rings)])
        return parts

    def to_xarray(self) -> xarray.Dataset:
        """Return the margins with coordinates and units.

        Returns
        -------
        xarray.Dataset
            `margin_j` [J] over `charge`, `y`, `x` [m].
        """
        import xarray

        words = "energy above the reserve that is left " + ("after coming back" if self.round_trip else "on arrival")
        data: dict[str, Any] = {"margin_j": (("charge", "y", "x"), self.margin_j, {"units": "J", "long_name": words})}
        coordinates: dict[str, Any] = coordinates_of(self.frame, 4, components=False)
        del coordinates["heading"]
        coordinates["charge"] = ("charge", np.array(self.charges), {"units": "1", "long_name": "state of charge"})
        attributes = {"Conventions": "CF-1.11", "title": words, "provenance": json.dumps(self.provenance)}
        return xarray.Dataset(data, coords=coordinates, attrs=attributes)

    def geotiff(self) -> bytes:
        """Return the margins as a GeoTIFF file.

        Returns
        -------
        bytes
            A band of float32 [J] for each charge, NaN (nodata) where no route leads.
        """
        words = [
            f"energy above the reserve that is left, begun with a charge of {charge:g} [J]" for charge in self.charges
        ]
        tags = {"JOULEMAP": json.dumps(self.provenance)}
        from joulemap.model.terrain.writers import write_bands_geotiff  # loads GDAL

        written = write_bands_geotiff(None, self.margin_j, self.frame, descriptions=words, tags=tags)
        assert written is not None
        return written


def _largest_around(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest value among each cell's four neighbours."""
    around = np.pad(values, 1)
    return np.maximum.reduce([around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]])


def _turned(ring: Ring, *, outer: bool) -> Ring:
    """The ring, anticlockwise if it is an outer one, else clockwise."""
    x, y = ring.T
    twice_area = float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())
    return ring if (twice_area > 0.0) == outer else ring[::-1]
