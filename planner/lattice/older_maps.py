"""Cost maps of a version that wrote no checksums: what can be checked is checked once, then checksums are kept.

What was damaged before is found where files, shapes, names or codes do not fit together. Another number where any
number may stand is not: nothing in such a folder says what it was.
"""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from joulemap.model.errors import JoulemapError
from joulemap.model.frames import GridFrame
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import Checksums, damaged
from joulemap.planner.lattice.chunks import read

_CODES = np.array([int(code) for code in Blocked], dtype=np.uint8)


def checked(folder: Path, node: dict[str, Any]) -> Checksums:
    """Return the checksums of a cost map that has none, once it is checked; they are kept in its folder.

    Raises DamagedError if something is lost, or does not fit together.
    """
    sums = Checksums.take(folder)
    _check_metadata(folder, node, sums)
    group = zarr.open_group(CheckedStore(sums), mode="r", use_consolidated=False)
    arrays: dict[str, Any] = {}
    try:
        for name in ("traction_per_m", "elevation_m", "gradient", "blocked", "std_j"):
            if name in group or name != "std_j":
                arrays[name] = group[name]
        frame = GridFrame(**node["attributes"]["frame"])
    except (KeyError, TypeError, ValueError, JoulemapError) as error:
        raise damaged(folder.name, f"{type(error).__name__} {error}") from error
    _check_frame(folder, frame, group, arrays)
    high, wide = arrays["blocked"].chunks[:2]
    for i in range(-(-frame.rows // high)):
        for j in range(-(-frame.cols // wide)):
            _check_chunks(folder, sums, arrays, i, j)
    with suppress(OSError):  # a folder that cannot be written: the next reader checks it again
        sums.write()
    return sums


def _check_metadata(folder: Path, node: dict[str, Any], sums: Checksums) -> None:
    """The metadata of every array, of which `zarr.json` has a copy. Raises DamagedError."""
    copies = (node.get("consolidated_metadata") or {}).get("metadata") or {}
    for name, copy in copies.items():
        place = f"{name}/zarr.json"
        if place not in sums:
            raise damaged(f"{folder.name}/{place}", "it is missing")
        try:
            own = json.loads(sums.content(place))
        except ValueError as error:
            raise damaged(f"{folder.name}/{place}", str(error)) from error
        if own != copy:
            raise damaged(f"{folder.name}/{place}", "it is not what zarr.json says")


def _check_frame(folder: Path, frame: GridFrame, group: zarr.Group, arrays: dict[str, Any]) -> None:
    """Shapes, and coordinates where there are some, against the frame. Raises DamagedError."""
    for name, array in arrays.items():
        if array.shape[:2] != frame.shape or array.chunks[:2] != arrays["blocked"].chunks[:2]:
            raise damaged(f"{folder.name}/{name}", f"its shape is {array.shape}, that of the map {frame.shape}")
    for name, wanted in zip(("x", "y"), frame.centres(), strict=True):
        if name not in group:
            continue
        try:
            same = np.array_equal(np.asarray(group[name][:]), wanted)  # type: ignore[index]
        except (RuntimeError, ValueError):  # as the decoder says it
            same = False
        if not same:
            raise damaged(f"{folder.name}/{name}", "the coordinates are not those of the frame in zarr.json")


def _check_chunks(folder: Path, sums: Checksums, arrays: dict[str, Any], i: int, j: int) -> None:
    """That one chunk of every array can be decoded, and that none is lost. Raises DamagedError.

    A chunk without a file holds nothing but unknown cells. A free cell has known values; one whose values are all known
    is not unknown.
    """
    high, wide = arrays["blocked"].chunks[:2]
    part = np.s_[i * high : (i + 1) * high, j * wide : (j + 1) * wide]
    chunk = {name: read(array, part) for name, array in arrays.items()}
    blocked: NDArray[np.uint8] = chunk["blocked"]
    if not np.isin(blocked, _CODES).all():
        raise damaged(f"{folder.name}/blocked", "it has codes that say nothing")
    for name, array in arrays.items():
        file = f"{name}/{array.metadata.encode_chunk_key((i, j, *(0,) * (array.ndim - 2)))}"
        if file in sums:
            continue
        if name == "blocked":
            known = [np.isfinite(chunk[of].reshape(*blocked.shape, -1)).all(axis=2) for of in _VALUES]
            lost = bool(np.logical_and.reduce(known).any())
        else:
            lost = bool((blocked == Blocked.FREE).any())
        if lost:
            raise damaged(f"{folder.name}/{file}", "it is missing")


_VALUES = ("traction_per_m", "elevation_m", "gradient")
