"""A cost lattice on disk: a zarr group that xarray opens too; an export to npz."""

from __future__ import annotations

import errno
import io
import json
import secrets
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from joulemap.model.errors import DamagedError, InputError, JoulemapError, NotFoundError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked, CostLattice, checksums, older_maps
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import Checksums, damaged
from joulemap.planner.lattice.chunks import read
from joulemap.planner.lattice.obstacles import Obstacles
from joulemap.planner.lattice.tiles import TILE_CELLS, Tiling
from joulemap.planner.lattice.xarray_dataset import CRS_VARIABLE, DIMENSIONS, attributes_of, coordinates_of

FORMAT = "joulemap.cost-lattice/1"
"""Dimension names, coordinates and units came later and are no part of it: folders without them are read as well."""
_ARRAYS = ("traction_per_m", "elevation_m", "gradient", "blocked")
_OPTIONAL = ("std_j",)
OBSTACLES = "obstacles"
"""The room of `Obstacles`, on squares of a whole number to the cell; without it there are none."""
_CHECKED = "checksums"
"""Attribute of a lattice that has checksums: without it they are only missing in a folder of an older version."""
_COMPRESSOR = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")  # noise of the last bits does not compress: be quick


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
            _lay_out(begun, tiling, robot, with_std=with_std, squares=squares)
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
        if self.path.exists() and not _is_lattice(self.path):
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
        for name in (*_ARRAYS, *_OPTIONAL):
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
        return _in_memory(self.partial, group)

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
            if not all((self.path / name / "zarr.json").is_file() for name in _ARRAYS):  # zarr made the folder anew
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


def _lay_out(place: Path, tiling: Tiling, robot: Robot, *, with_std: bool, squares: int) -> None:
    frame = tiling.frame
    group = zarr.open_group(place, mode="w")
    by_heading, side = (tiling.headings,), tiling.side
    arrays: dict[str, tuple[tuple[int, ...], str, float]] = {
        "traction_per_m": (by_heading, "float32", np.nan),
        "elevation_m": ((), "float32", np.nan),
        "gradient": ((2,), "float32", np.nan),
        "blocked": ((), "uint8", int(Blocked.UNKNOWN)),
    }
    if with_std:
        arrays["std_j"] = (by_heading, "float32", np.nan)
    for name, (more, dtype, unknown) in arrays.items():
        group.create_array(
            name,
            shape=(*frame.shape, *more),
            chunks=(*(min(side, n) for n in frame.shape), *more),
            dtype=dtype,
            fill_value=unknown,
            compressors=_COMPRESSOR,
            dimension_names=DIMENSIONS[name],
            attributes=attributes_of(name, frame.crs),
        )
    if squares:
        group.create_array(
            OBSTACLES,
            shape=tuple(squares * size for size in frame.shape),
            chunks=tuple(squares * min(side, size) for size in frame.shape),
            dtype="uint8",
            fill_value=255,
            compressors=_COMPRESSOR,
            dimension_names=DIMENSIONS[OBSTACLES],
            attributes=attributes_of(OBSTACLES, None),
        )
    for name, (dimensions, values, attributes) in coordinates_of(frame, tiling.headings).items():
        group.create_array(name, data=values, dimension_names=dimensions, attributes=attributes)
    group.attrs.update({"Conventions": "CF-1.11", **_metadata(frame, robot)})
    if frame.crs is not None:
        group.attrs["coordinates"] = CRS_VARIABLE  # else xarray takes it for data


def _describe(folder: Path, provenance: dict[str, Any]) -> None:
    """Write the provenance, and a copy of all metadata in one place: without it xarray gives a warning."""
    zarr.open_group(folder, mode="r+").attrs.update({"provenance": provenance, _CHECKED: checksums.FILE})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # zarr 3 has no standard for it yet; both libraries read it
        zarr.consolidate_metadata(folder)


def _is_lattice(path: Path) -> bool:
    """Whether a folder may be replaced: a lattice, or a damaged one."""
    if (path / checksums.FILE).is_file() and any((path / name).is_dir() for name in _ARRAYS):
        return True
    if not (path / "zarr.json").is_file():
        return False
    try:
        node = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        return str(node["attributes"]["format"]).startswith(FORMAT.split("/")[0])
    except (ValueError, KeyError, TypeError):
        return all((path / name).is_dir() for name in _ARRAYS)


def open_group(path: str | Path) -> zarr.Group:
    """Open the zarr group of a lattice.

    Parameters
    ----------
    path : str or Path
        The folder, usually NAME.zarr.

    Returns
    -------
    zarr.Group
        For reading; everything that is read is verified.

    Raises
    ------
    InputError
        If `path` is not a cost lattice.
    NotFoundError
        If it is missing.
    DamagedError
        If it is a damaged one.
    """
    path = Path(path)
    if not path.exists():
        raise NotFoundError(f"there is no cost map {path}", path=str(path))
    sums = Checksums.read(path) or _unchecked(path)
    if "zarr.json" not in sums:
        raise _no_lattice(path)
    group = zarr.open_group(CheckedStore(sums), mode="r", use_consolidated=False)  # what is there, not what was once
    _check_format(path, group.attrs)
    return group


def _unchecked(path: Path) -> Checksums:
    """The checksums of a folder of an older version. Raises InputError, DamagedError."""
    try:
        node = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        attributes: dict[str, Any] = node["attributes"]
    except (FileNotFoundError, NotADirectoryError):
        raise _no_lattice(path) from None
    except (ValueError, KeyError, TypeError) as error:
        if not _is_lattice(path):
            raise _no_lattice(path) from error
        raise damaged(f"{path.name}/zarr.json", f"{type(error).__name__} {error}") from error
    _check_format(path, attributes)
    if _CHECKED in attributes:
        raise damaged(f"{path.name}/{checksums.FILE}", "it is missing")
    return older_maps.checked(path, node)


def _no_lattice(path: Path) -> InputError:
    return InputError(f"{path} is not a cost lattice, which is a folder written by `joulemap costmap`", path=str(path))


def _check_format(path: Path, attributes: Mapping[str, Any]) -> None:
    found = attributes.get("format")
    if found != FORMAT:
        raise InputError(f"{path} holds format {found!r}, expected {FORMAT!r}", path=str(path))


def load_lattice(path: str | Path) -> CostLattice:
    """Read a folder written by `save_lattice` or `write_lattice`.

    Parameters
    ----------
    path : str or Path
        The folder, usually NAME.zarr.

    Returns
    -------
    CostLattice
        The lattice, in memory.

    Raises
    ------
    InputError
        If `path` is missing or is not a cost lattice.
    DamagedError
        If it is a damaged one.
    """
    return _in_memory(path, open_group(path))


def obstacles_of(group: zarr.Group) -> zarr.Array[Any] | None:
    """The stored obstacles of a lattice; None where no tile had any.

    Parameters
    ----------
    group : zarr.Group
        As `open_group` opens it.

    Returns
    -------
    zarr.Array or None
        The room of `Obstacles`, not read yet.
    """
    found = group.get(OBSTACLES)
    return found if isinstance(found, zarr.Array) and found.nchunks_initialized else None


def _in_memory(path: str | Path, group: zarr.Group) -> CostLattice:
    meta: dict[str, Any] = dict(group.attrs)
    try:
        arrays: dict[str, Any] = {
            name: read(group[name])  # type: ignore[arg-type]
            for name in (*_ARRAYS, *_OPTIONAL)
            if name in group
        }
        stored = obstacles_of(group)
        if stored is not None:
            arrays[OBSTACLES] = Obstacles(read(stored), stored.shape[0] // int(meta["frame"]["rows"]))
        return CostLattice(
            frame=GridFrame(**meta["frame"]),
            robot=Robot.from_mapping(meta["robot"]),
            provenance=meta["provenance"],
            **arrays,
        )
    except DamagedError:
        raise
    except (KeyError, TypeError, JoulemapError) as error:
        raise damaged(Path(path).name, f"{type(error).__name__} {error}") from error


def export_npz(lattice: CostLattice) -> bytes:
    """Return a lattice as a compressed NumPy npz file.

    Parameters
    ----------
    lattice : CostLattice
        What to export.

    Returns
    -------
    bytes
        The file: `energy_per_m` and `blocked` (rows, cols, headings), `headings_rad` (headings,), `elevation_m`
        (rows, cols), `std_j` where it is known, and `metadata` as JSON.
    """
    out = io.BytesIO()
    known: dict[str, Any] = {} if lattice.std_j is None else {"std_j": lattice.std_j}
    np.savez_compressed(
        out,
        energy_per_m=lattice.energy_per_m,
        blocked=lattice.blocked_by_heading(),
        headings_rad=heading_bins(lattice.headings),
        elevation_m=lattice.elevation_m,
        metadata=metadata_json(lattice),
        **known,
    )
    return out.getvalue()


def _metadata(frame: GridFrame, robot: Robot) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "frame": asdict(frame),
        "robot": robot.as_dict(),
        "blocked_codes": {str(int(reason)): reason.label for reason in Blocked},
        "units": {
            "traction_per_m": "J/m",
            "std_j": "J of a 1 m segment",
            "elevation_m": "m",
            "gradient": "m/m towards east, north",
        },
    }


def metadata_json(lattice: CostLattice) -> str:
    """Return what a lattice is, and how it was made.

    Parameters
    ----------
    lattice : CostLattice
        What is exported.

    Returns
    -------
    str
        JSON: frame, robot, codes of blocked reasons, units and provenance.
    """
    return json.dumps({**_metadata(lattice.frame, lattice.robot), "provenance": lattice.provenance})
