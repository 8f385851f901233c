"""Writes a cost lattice to a folder: whole or not at all, tile by tile, by several processes."""

from __future__ import annotations

import errno
import secrets
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import zarr

from joulemap.model.errors import InputError
from joulemap.model.robot import Robot
from joulemap.planner.lattice import CostLattice, checksums
from joulemap.planner.lattice.checksums import Checksums
from joulemap.planner.lattice.layout import ARRAYS, CHECKED, OBSTACLES, OPTIONAL, is_lattice, lay_out_arrays
from joulemap.planner.lattice.loading import loaded
from joulemap.planner.lattice.tiles import TILE_CELLS, Tiling

# zarr 3 has no standard for it yet; both libraries read it. For all threads: `catch_warnings` would take theirs too.
warnings.filterwarnings("ignore", "Consolidated metadata", UserWarning)


class LatticeFolder:
    """A lattice on its way to disk: it is built beside its place, in `path`.partial, and moved there by `finish`.

    Tiles may come in any order, again, and from several processes that share the folder: a tile is whole chunks. Such
    processes need a folder of notes, `path`.tiles. `discard` removes it first; who finds it gone removes what it wrote.

    Parameters
    ----------
    path : str or Path
        The folder to write, usually NAME.zarr.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + ".partial")
        self.notes = self.path.with_name(self.path.name + ".tiles")

    @property
    def is_whole(self) -> bool:
        """Whether the lattice is in its place; one that is being removed is not."""
        return (self.path / "zarr.json").is_file()

    def begin(self) -> None:
        """Make the folder of notes; tiles without notes, of an older version, are removed."""
        try:
            self.notes.mkdir()
        except FileExistsError:
            return
        shutil.rmtree(self.partial, ignore_errors=True)

    def lay_out(self, tiling: Tiling, robot: Robot, *, with_std: bool, squares: int = 0, again: bool = True) -> None:
        """Make the empty arrays with their coordinates, whole or not at all.

        Parameters
        ----------
        tiling : Tiling
            Frame, headings and tiles of the lattice; one chunk per tile.
        robot : Robot
            Whose prices these are.
        with_std : bool
            Whether `std_j` will be written.
        squares : int, optional
            Squares of obstacles along the side of a cell; 0 where there are none.
        again : bool, optional
            Remove what an earlier try left; else it is kept, and the tiles that are there with it.

        Raises
        ------
        InputError
            If `path` exists and is not a cost lattice.
        """
        self.check_place()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        begun = self.path.with_name(f"{self.path.name}.{secrets.token_hex(4)}.partial")
        try:
            lay_out_arrays(begun, tiling, robot, with_std=with_std, squares=squares)
            if again:
                shutil.rmtree(self.partial, ignore_errors=True)
            if not self.partial.exists():
                begun.rename(self.partial)
        finally:
            shutil.rmtree(begun, ignore_errors=True)

    def check_place(self) -> None:
        """Refuse a place where something else is.

        Raises
        ------
        InputError
            If `path` exists and is not a cost lattice.
        """
        if self.path.exists() and not is_lattice(self.path):
            raise InputError(
                f"{self.path} exists and is not a cost lattice: it will not be overwritten", path=str(self.path)
            )

    @contextmanager
    def whole_or_nothing(self) -> Iterator[None]:
        """Remove the unfinished folder when the block ends by an exception, Ctrl-C included.

        For a writer that cannot go on later from the tiles that are there.

        Yields
        ------
        None
            Nothing; the block lays out, writes and finishes.

        Raises
        ------
        InputError
            If `path` exists and is not a cost lattice.
        """
        self.check_place()
        try:
            yield
        except BaseException:
            shutil.rmtree(self.partial, ignore_errors=True)
            raise

    def write(self, part: CostLattice, rows: slice, cols: slice) -> None:
        """Write the cells of one tile.

        Parameters
        ----------
        part : CostLattice
            The lattice of these cells alone.
        rows, cols : slice
            Where they lie in the whole lattice.
        """
        group = zarr.open_group(self.partial, mode="r+")
        for name in (*ARRAYS, *OPTIONAL):
            data = getattr(part, name)
            if data is not None:
                group[name][rows, cols] = data  # type: ignore[index]
        if part.obstacles is not None:
            n = part.obstacles.per_cell
            squares = slice(rows.start * n, rows.stop * n), slice(cols.start * n, cols.stop * n)
            group[OBSTACLES][squares] = part.obstacles.under(*part.frame.shape)  # type: ignore[index]

    def read_unfinished(self, provenance: dict[str, Any]) -> CostLattice:
        """Read a lattice all of whose tiles are written, before it is finished.

        Parameters
        ----------
        provenance : dict
            As of `finish`.

        Returns
        -------
        CostLattice
            In memory.
        """
        group = zarr.open_group(self.partial, mode="r+")
        group.attrs["provenance"] = provenance
        return loaded(self.partial, group)

    def finish(self, provenance: dict[str, Any], *, replace: bool = True) -> None:
        """Write how the lattice was made, and move it into place where it is not there yet.

        Parameters
        ----------
        provenance : dict
            JSON-able record of model, heightmap, settings and warnings.
        replace : bool, optional
            Remove a lattice that is in its place.

        Raises
        ------
        OSError
            If a lattice is in its place that is not to be replaced, or if it was discarded meanwhile.
        """
        if self.partial.exists():
            for torn in self.partial.rglob("*.partial"):  # a chunk whose writer was killed; it was written again
                torn.unlink()
            _describe(self.partial, provenance)
            Checksums.take(self.partial).write()
            if replace:
                shutil.rmtree(self.path, ignore_errors=True)
            self.partial.rename(self.path)
            if not all((self.path / name / "zarr.json").is_file() for name in ARRAYS):  # zarr made the folder anew
                shutil.rmtree(self.path, ignore_errors=True)
                raise FileNotFoundError(errno.ENOENT, "the lattice was discarded while it was finished", str(self.path))
        elif not self.is_whole:
            raise FileNotFoundError(errno.ENOENT, "there is no lattice to be finished", str(self.path))

    def discard(self) -> None:
        """Remove the folder, finished or not: first what makes it whole, so that nobody reads a part of it.

        What another process moves into its place at this moment is removed there, because the place comes last.
        """
        gone = self.path.with_name(f"{self.path.name}.{secrets.token_hex(4)}.partial")
        with suppress(FileNotFoundError):
            self.notes.rename(gone)  # at once: a note that is written meanwhile would keep the folder
        shutil.rmtree(gone, ignore_errors=True)
        for place in (self.partial, self.path):
            (place / "zarr.json").unlink(missing_ok=True)
            shutil.rmtree(place, ignore_errors=True)


def save_lattice(lattice: CostLattice, path: str | Path) -> None:
    """Write a lattice to a folder, whole or not at all.

    Parameters
    ----------
    lattice : CostLattice
        What to write.
    path : str or Path
        The folder, usually NAME.zarr. A cost lattice that is there is replaced.

    Raises
    ------
    InputError
        If something else is at `path`.

    Notes
    -----
    The folder is a zarr group with dimension names, coordinates, units and CRS after the CF conventions:
    `xarray.open_zarr(path)` reads it.
    """
    folder = LatticeFolder(path)
    tiling = Tiling(lattice.frame, lattice.headings, TILE_CELLS)
    with folder.whole_or_nothing():
        squares = 0 if lattice.obstacles is None else lattice.obstacles.per_cell
        folder.lay_out(tiling, lattice.robot, with_std=lattice.std_j is not None, squares=squares)
        folder.write(lattice, slice(0, lattice.frame.rows), slice(0, lattice.frame.cols))
        folder.finish(lattice.provenance)


def _describe(folder: Path, provenance: dict[str, Any]) -> None:
    """Write the provenance, and a copy of all metadata in one place: without it xarray gives a warning."""
    zarr.open_group(folder, mode="r+").attrs.update({"provenance": provenance, CHECKED: checksums.FILE})
    zarr.consolidate_metadata(folder)
