"""Reuses a finished cost map: a calibrated model reads its base's answers from it instead of computing them anew."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import DamagedError, InputError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice.loading import open_group
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.lattice.tiles import Tiling


class StoredBase:
    """A base model that reads its answers for the cells of a lattice from a finished cost map.

    Everything else is asked of the base model itself.
    """

    def __init__(self, base: Predictor, place: Path, tiling: Tiling) -> None:
        self._base, self._place, self._tiling = base, place, tiling

    def __getattr__(self, name: str) -> Any:
        return getattr(self._base, name)

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Return the base's answer, bit by bit the same.

        Read from the cost map; computed where `frame` is not a part of it, or where it was deleted or is damaged.

        `headings_rad` (K,): clockwise from north [rad]. Returns `traction_per_m` (rows, cols, K): traction [J/m];
        `std_j` (rows, cols, K): standard deviation [J] of a segment of 1 m, where the base knows it.
        """
        place = _place_in(self._tiling.frame, frame)
        if place is not None:
            rows, cols = place
            try:
                found = StoredLattice(self._place, kept_bytes=0).window(
                    rows.start, rows.stop, cols.start, cols.stop, what=("traction_per_m", "std_j")
                )
            except (InputError, DamagedError, OSError):  # it was deleted, is deleted at this moment, or is damaged
                pass
            else:
                return found.traction_per_m, found.std_j
        return self._base.traction_and_std(heightmap, robot, frame, headings_rad)


def with_stored_base(source: Predictor, robot: Robot, tiling: Tiling, finished: Iterable[Path]) -> Predictor:
    """Return the model of a cost map that is to be made, reading its base's answers where they are stored.

    `finished`: cost maps of the same robot. Result: `source` itself where it is not calibrated, where it asks its base
    of another robot, or where no finished cost map fits.
    """
    if not isinstance(source, CalibratedPredictor) or source.robot_of_base(robot) != robot:
        return source
    base = json.loads(json.dumps(source.base.provenance()))
    for place in finished:
        try:
            made: Any = open_group(place).attrs["provenance"]
        except (InputError, DamagedError, OSError, KeyError):  # it was deleted meanwhile, or is damaged
            continue
        if made["model"] == base:
            stored: Any = StoredBase(source.base, place, tiling)
            return CalibratedPredictor(stored, source.correction, name=source.name, version=source.version)
    return source


def _place_in(whole: GridFrame, part: GridFrame) -> tuple[slice, slice] | None:
    """The rows and columns of a part within the whole grid; None where it is not a part of it."""
    row, col = (round(float(at)) for at in whole.rowcol(*(float(c[0]) for c in part.centres())))
    inside = row >= 0 and col >= 0 and row + part.rows <= whole.rows and col + part.cols <= whole.cols
    if not inside or whole.window(row, row + part.rows, col, col + part.cols) != part:
        return None
    return slice(row, row + part.rows), slice(col, col + part.cols)
