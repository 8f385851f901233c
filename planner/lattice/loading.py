"""Opens and reads the folder of a cost lattice, and tells a damaged one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zarr

from joulemap.model.errors import DamagedError, InputError, JoulemapError, NotFoundError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.planner.lattice import CostLattice, checksums, older_maps
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import Checksums, damaged
from joulemap.planner.lattice.chunks import read
from joulemap.planner.lattice.layout import ARRAYS, CHECKED, FORMAT, OBSTACLES, OPTIONAL, is_lattice
from joulemap.planner.lattice.obstacles import Obstacles


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
    return loaded(path, open_group(path))


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


def loaded(path: str | Path, group: zarr.Group) -> CostLattice:
    """Return the lattice of an open group, in memory.

    Parameters
    ----------
    path : str or Path
        What is named where it is damaged.
    group : zarr.Group
        As `open_group` returns it.

    Returns
    -------
    CostLattice
        All of it.

    Raises
    ------
    DamagedError
        If something is missing, or is not what it must be.
    """
    meta: dict[str, Any] = dict(group.attrs)
    try:
        arrays: dict[str, Any] = {
            name: read(group[name])  # type: ignore[arg-type]
            for name in (*ARRAYS, *OPTIONAL)
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


def _unchecked(path: Path) -> Checksums:
    """The checksums of a folder of an older version. Raises InputError, DamagedError."""
    try:
        node = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        attributes: dict[str, Any] = node["attributes"]
    except (FileNotFoundError, NotADirectoryError):
        raise _no_lattice(path) from None
    except (ValueError, KeyError, TypeError) as error:
        if not is_lattice(path):
            raise _no_lattice(path) from error
        raise damaged(f"{path.name}/zarr.json", f"{type(error).__name__} {error}") from error
    _check_format(path, attributes)
    if CHECKED in attributes:
        raise damaged(f"{path.name}/{checksums.FILE}", "it is missing")
    return older_maps.checked(path, node)


def _no_lattice(path: Path) -> InputError:
    return InputError(f"{path} is not a cost lattice, which is a folder written by `joulemap costmap`", path=str(path))


def _check_format(path: Path, attributes: Mapping[str, Any]) -> None:
    found = attributes.get("format")
    if found != FORMAT:
        raise InputError(f"{path} holds format {found!r}, expected {FORMAT!r}", path=str(path))
