"""Reuses a finished cost map: a calibrated model reads its base's answers from it instead of computing them anew."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from sqlalchemy import select

from joulemap.model.energy.predictor import Predictor
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.tiles import Tiling
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import DONE, CostmapRow


class StoredBase:
    """A base model that reads its answers for the cells of a lattice from a finished cost map.

    Everything else is asked of the base model itself.

    Parameters
    ----------
    base : Predictor
        The base model.
    store : Store
        Where the cost map is kept.
    costmap_id : str
        Id of a cost map that was made with the base model.
    tiling : Tiling
        Its cells.
    """

    def __init__(self, base: Predictor, store: Store, costmap_id: str, tiling: Tiling) -> None:
        self._base, self._store, self._costmap_id, self._tiling = base, store, costmap_id, tiling

    def __getattr__(self, name: str) -> Any:
        return getattr(self._base, name)

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Return the base's answer, bit by bit the same.

        Read from the cost map; computed where `frame` is not a part of it, or where it was deleted.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            The robot.
        frame : GridFrame
            Cells to answer for.
        headings_rad : ndarray of float64, (K,)
            Clockwise from north [rad].

        Returns
        -------
        traction_per_m : ndarray of float32, (rows, cols, K)
            Traction [J/m].
        std_j : ndarray of float32, (rows, cols, K), or None
            Standard deviation [J] of a segment of 1 m, where the base knows it.
        """
        place = _place_in(self._tiling.frame, frame)
        if place is not None:
            try:
                group = zarr.open_group(self._store.lattice_path(self._costmap_id), mode="r")
                traction = np.asarray(group["traction_per_m"][place])  # type: ignore[index]
                std = np.asarray(group["std_j"][place]) if "std_j" in group else None  # type: ignore[index]
                if self._store.status(self._costmap_id) == DONE:  # a map that is deleted loses its row before its files
                    return traction, std
            except (OSError, KeyError):
                pass
        return self._base.traction_and_std(heightmap, robot, frame, headings_rad)


def with_stored_base(store: Store, row: CostmapRow, source: Predictor, tiling: Tiling) -> Predictor:
    """Return the model of a cost map that is to be made, reading its base's answers where they are stored.

    Parameters
    ----------
    store : Store
        Open.
    row : CostmapRow
        The cost map that is to be made.
    source : Predictor
        Its model.
    tiling : Tiling
        Its cells.

    Returns
    -------
    Predictor
        `source` itself where it is not calibrated, or where no finished cost map fits.
    """
    if not isinstance(source, CalibratedPredictor):
        return source
    base = json.loads(json.dumps(source.base.provenance()))
    with store.sessions() as session:
        query = select(CostmapRow).where(CostmapRow.heightmap_id == row.heightmap_id, CostmapRow.status == DONE)
        for made in session.scalars(query):
            if _but_model(made) == _but_model(row) and (made.summary or {})["provenance"]["model"] == base:
                stored: Any = StoredBase(source.base, store, made.id, tiling)
                return CalibratedPredictor(stored, source.correction, name=source.name, version=source.version)
    return source


def _place_in(whole: GridFrame, part: GridFrame) -> tuple[slice, slice] | None:
    """The rows and columns of a part within the whole grid; None where it is not a part of it."""
    row, col = (round(float(at)) for at in whole.rowcol(*(float(c[0]) for c in part.centres())))
    inside = row >= 0 and col >= 0 and row + part.rows <= whole.rows and col + part.cols <= whole.cols
    if not inside or whole.window(row, row + part.rows, col, col + part.cols) != part:
        return None
    return slice(row, row + part.rows), slice(col, col + part.cols)


def _but_model(row: CostmapRow) -> dict[str, Any]:
    return {key: value for key, value in row.request.items() if key != "model"}
