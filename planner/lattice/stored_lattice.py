"""A cost lattice that stays on disk: windows of it are read when they are asked for."""

from __future__ import annotations

import math
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from joulemap.model.errors import DamagedError, JoulemapError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.avoid import Polygon, without
from joulemap.planner.lattice.checksums import damaged
from joulemap.planner.lattice.chunks import Chunks
from joulemap.planner.lattice.layout import OBSTACLES
from joulemap.planner.lattice.loading import obstacles_of, open_group
from joulemap.planner.lattice.obstacles import Obstacles, reach_m

_FILLS: dict[str, float] = {
    "traction_per_m": np.nan,
    "elevation_m": np.nan,
    "gradient": np.nan,
    "blocked": int(Blocked.OUTSIDE),
    "std_j": np.nan,
}


class StoredLattice:
    """A lattice folder, opened without reading its arrays. Several threads may ask at once.

    Parameters
    ----------
    path : str or Path
        The folder.
    kept_bytes : int
        Most memory for chunks that were read.

    Raises
    ------
    DamagedError
        If it is a damaged one, here or when a window is read.
    """

    def __init__(self, path: str | Path, *, kept_bytes: int = 100_000_000) -> None:
        self.path = Path(path)
        group = open_group(self.path)
        meta: dict[str, Any] = dict(group.attrs)
        try:
            self.frame = GridFrame(**meta["frame"])
            self.robot = Robot.from_mapping(meta["robot"])
            self.provenance: dict[str, Any] = meta["provenance"]
            self._arrays: dict[str, zarr.Array[Any]] = {name: group[name] for name in _FILLS if name in group}  # type: ignore[misc]
            self.headings = int(self._arrays["traction_per_m"].shape[2])
            self._room = obstacles_of(group)
            self.chunk = int(self._arrays["traction_per_m"].chunks[0])
        except DamagedError:
            raise
        except (KeyError, TypeError, JoulemapError) as error:
            raise damaged(self.path.name, f"{type(error).__name__} {error}") from error
        self._chunks = Chunks(kept_bytes)
        self._avoided: tuple[Polygon, ...] = ()

    def avoiding(self, areas: tuple[Polygon, ...]) -> StoredLattice:
        """Return the same lattice, which shares what was read, with the cells of some polygons blocked.

        Parameters
        ----------
        areas : tuple of polygons
            Closed ground, each (n, 2) world x, y [m].
        """
        other = copy(self)
        other._avoided = areas
        return other

    @property
    def arrays(self) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Name of each array, with its shape beyond rows and columns, and its type."""
        return {name: (of.shape[2:], of.dtype) for name, of in self._arrays.items()}

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.frame.rows * self.frame.cols

    def window(self, row0: int, row1: int, col0: int, col1: int, *, what: tuple[str, ...] | None = None) -> CostLattice:
        """Return the lattice of some cells; what lies beyond the map is blocked.

        Parameters
        ----------
        row0, row1, col0, col1 : int
            The cells [row0, row1) x [col0, col1), which may lie beyond the map.
        what : tuple of str, optional
            Names of the arrays to be read; the others are unknown. All without it.
        """
        arrays: dict[str, Any] = {}
        shape = row1 - row0, col1 - col0
        for name, of in self._arrays.items():
            if what is not None and name not in what:
                if name == "std_j":
                    continue
                more = of.shape[2:]
                arrays[name] = np.broadcast_to(np.array(_FILLS[name], dtype=of.dtype), (*shape, *more))
            else:
                arrays[name] = self.read(of, _FILLS[name], row0, row1, col0, col1)
        placed = self.frame.window(row0, row1, col0, col1)
        if self._room is not None and (what is None or "blocked" in what):
            arrays[OBSTACLES] = self._obstacles(self._room, row0, row1, col0, col1)
        lattice = CostLattice(placed, self.robot, provenance=self.provenance, **arrays)
        return without(lattice, self._avoided) if self._avoided and (what is None or "blocked" in what) else lattice

    @property
    def squares_per_cell(self) -> int:
        """Squares of obstacles along the side of a cell; 0 where there are none."""
        return 0 if self._room is None else int(self._room.shape[0]) // self.frame.rows

    def room(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """Return `Obstacles.room` under some cells.

        Parameters
        ----------
        rows, cols : slice
            The cells, each with a start and a stop.
        """
        n = self.squares_per_cell
        return self.read(self._room, 0, rows.start * n, rows.stop * n, cols.start * n, cols.stop * n)  # type: ignore[arg-type]

    def _obstacles(self, room: zarr.Array[Any], row0: int, row1: int, col0: int, col1: int) -> Obstacles | None:
        """The obstacles that the robot may meet from some cells; what lies beyond the map is one."""
        margin = math.ceil(reach_m(self.robot) / self.frame.resolution_m) + 2
        n = self.squares_per_cell
        around = ((row0 - margin) * n, (row1 + margin) * n, (col0 - margin) * n, (col1 + margin) * n)
        found = self.read(room, 0, *around)
        return Obstacles(found, n, margin * n, margin * n) if (found == 0).any() else None

    def read(self, of: zarr.Array[Any], fill: float, row0: int, row1: int, col0: int, col1: int) -> NDArray[Any]:
        """Return a window of an array over the cells of this lattice, or of the squares of its obstacles.

        Parameters
        ----------
        of : zarr.Array
            (rows, cols, ...), chunked along rows and columns alone.
        fill : float
            What lies beyond the map.
        row0, row1, col0, col1 : int
            The cells or squares [row0, row1) x [col0, col1).
        """
        high, wide = of.chunks[:2]
        out = np.full((row1 - row0, col1 - col0, *of.shape[2:]), fill, dtype=of.dtype)
        rows, cols = of.shape[:2]
        for i in range(max(row0, 0) // high, -(-min(row1, rows) // high)):
            for j in range(max(col0, 0) // wide, -(-min(col1, cols) // wide)):
                top, down = max(i * high, row0), min((i + 1) * high, row1, rows)
                left, right = max(j * wide, col0), min((j + 1) * wide, col1, cols)
                out[top - row0 : down - row0, left - col0 : right - col0] = self._chunks.get(of, i, j)[
                    top - i * high : down - i * high, left - j * wide : right - j * wide
                ]
        return out
