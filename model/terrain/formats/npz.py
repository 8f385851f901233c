"""NumPy archives: heights and, if they are there, their place, in one .npz file."""

from __future__ import annotations

import lzma
import math
import struct
import zipfile
import zlib
from typing import IO

import numpy as np

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling
from joulemap.model.terrain.formats.npy import read_header, read_heights

_MAX_SCALAR_BYTES = 65_536  # a CRS in WKT is about 1,000
_NAMES = ("heights", "elevation", "height", "dem", "z", "topo")
_SCALARS = ("resolution_m", "west_m", "north_m", "crs")
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error)
_SIDES = ("resolution", "cell_size", "cellsize")  # in metres, like the heights


def recognise(head: bytes, name: str) -> bool:
    """Decide by the signature of zip archives."""
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06"))


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read the array `heights` (or `elevation`) and, where they are there, `resolution_m`, `west_m`, `north_m`, `crs`.

    Only what the headers declare is decompressed, after the declared size was accepted: a zip bomb stays packed.
    """
    try:
        with source.open() as stream, zipfile.ZipFile(stream) as archive:
            members = {i.filename.removesuffix(".npy"): i for i in archive.infolist() if i.filename.endswith(".npy")}
            named = [name for name in _NAMES if name in members]
            if len(named) != 1:
                raise HeightmapError(
                    f"the .npz file has no array `heights`; it has {', '.join(sorted(members)[:20])[:500] or 'none'}",
                    found=sorted(members)[:20],
                )
            with archive.open(members[named[0]]) as member:
                length = members[named[0]].file_size
                heights = read_heights(
                    member, f"`{named[0]}` of the .npz file", scaling, max_cells, expected_length=length
                )
            scalars = {} if "resolution_m" in members else _axes(archive, members, heights.shape)
            if scalars.pop("south_first", False):
                heights = np.ascontiguousarray(heights[::-1])
            for key in _SCALARS:
                there = [each for each in (key, *(_SIDES if key == "resolution_m" else ())) if each in members]
                if there:
                    with archive.open(members[there[0]]) as member:
                        scalars[key] = _read_scalar(member, key)
    except (*_BROKEN, EOFError, OSError, RuntimeError, KeyError, ValueError) as error:
        raise HeightmapError(f"the .npz file is truncated or corrupt: {str(error)[:200]}") from error
    return Decoded(
        heights,
        west_m=_number(scalars, "west_m"),
        north_m=_number(scalars, "north_m"),
        resolution_m=_number(scalars, "resolution_m"),
        crs=str(scalars["crs"]) if "crs" in scalars and scalars["crs"] not in ("", "None") else None,
    )


def _axes(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], shape: tuple[int, ...]) -> dict[str, object]:
    """Where the heights lie, if the centres of their rows and columns are there as `y` and `x` at even steps."""
    centres = []
    for key, size in (("y", shape[0]), ("x", shape[1])):
        if key not in members:
            return {}
        with archive.open(members[key]) as stream:
            there, _, dtype, _ = read_header(stream, f'the array "{key}" of the .npz file')
            if there != (size,) or dtype.kind not in "fiu" or size < 2:
                return {}
            centres.append(np.frombuffer(stream.read(size * dtype.itemsize), dtype=dtype).astype(np.float64))
    steps = [np.diff(values) for values in centres]
    side = abs(float(steps[1][0]))
    even = all(np.abs(np.abs(step) - side).max() <= SAME_LENGTH * side for step in steps)
    if not even or side == 0 or steps[1][0] < 0:
        return {}
    return {
        "resolution_m": side,
        "west_m": float(centres[1][0]) - side / 2,
        "north_m": float(centres[0].max()) + side / 2,
        "south_first": bool(steps[0][0] > 0),
    }


def _number(scalars: dict[str, object], key: str) -> float | None:
    if key not in scalars:
        return None
    value = scalars[key]
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        raise HeightmapError(
            f'the array "{key}" of the .npz file must be a finite number of metres, got {str(value)[:80]!r}'
        )
    return float(value)


def _read_scalar(stream: IO[bytes], key: str) -> object:
    what = f'the array "{key}" of the .npz file'
    shape, _, dtype, _ = read_header(stream, what)
    if math.prod(shape) != 1 or dtype.kind not in "fiuUS" or dtype.itemsize > _MAX_SCALAR_BYTES:
        raise HeightmapError(f"{what} must be a single number or text, got shape {shape} of {dtype.name}")
    data = stream.read(dtype.itemsize)
    if len(data) < dtype.itemsize:
        raise HeightmapError(f"{what} is truncated")
    value = np.frombuffer(data, dtype=dtype)[0].item()
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
