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
from joulemap.model.terrain.decoded import Decoded, Scaling
from joulemap.model.terrain.formats.npy import read_header, read_heights
from joulemap.model.terrain.formats.npz_place import Place, is_of_place, place_of

_MAX_SCALAR_BYTES = 65_536  # a CRS in WKT is about 1,000
_NAMES = ("heights", "elevation", "height", "dem", "z", "topo")
_SCALARS = ("resolution_m", "west_m", "north_m", "crs")
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error)
_MOST_OF_A_PLACE = 16  # numbers, of a transform of points
_FARTHEST_M = 1e12
_SIDES = ("resolution", "cell_size", "cellsize")  # in metres, like the heights


def recognise(head: bytes, name: str) -> bool:
    """Decide by the signature of zip archives."""
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06"))


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read the array `heights` (or `elevation`), `resolution_m` and `crs`, and what else says where they lie.

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
            scalars = dict[str, object]()
            for key in _SCALARS:
                there = [each for each in (key, *(_SIDES if key == "resolution_m" else ())) if each in members]
                if there:
                    with archive.open(members[there[0]]) as member:
                        scalars[key] = _read_scalar(member, key)
            place = _place(archive, members, heights.shape, scalars)
    except (*_BROKEN, EOFError, OSError, RuntimeError, KeyError, ValueError) as error:
        raise HeightmapError(f"the .npz file is truncated or corrupt: {str(error)[:200]}") from error
    west, north, side = (_number(scalars, key) for key in ("west_m", "north_m", "resolution_m"))
    unused = sorted({*filter(is_of_place, members)} - {*place.used, *scalars})
    return Decoded(
        np.ascontiguousarray(heights[::-1]) if place.south_first else heights,
        west_m=place.west_m if west is None else west,
        north_m=place.north_m if north is None else north,
        resolution_m=place.resolution_m if side is None else side,
        crs=str(scalars["crs"]) if "crs" in scalars and scalars["crs"] not in ("", "None") else None,
        notes=(_not_used(unused),) if unused and not place.used and west is None and north is None else (),
    )


def _not_used(names: list[str]) -> str:
    return (
        f"its {', '.join(f'`{name}`' for name in names)[:200]} did not say clearly where the heights lie, and "
        f"{'was' if len(names) == 1 else 'were'} not used: give `west_m` and `north_m`, the outer edges of the "
        "north-west cell"
    )


def _place(
    archive: zipfile.ZipFile,
    members: dict[str, zipfile.ZipInfo],
    shape: tuple[int, int],
    scalars: dict[str, object],
) -> Place:
    """What the arrays beside the heights say of their place."""
    arrays = {}
    for name in filter(is_of_place, members):
        with archive.open(members[name]) as stream:
            there, _, dtype, _ = read_header(stream, f'the array "{name}" of the .npz file')
            if dtype.kind in "fiu" and math.prod(there) <= max(*shape, _MOST_OF_A_PLACE):
                data = stream.read(math.prod(there) * dtype.itemsize)
                values = np.frombuffer(data, dtype=dtype).astype(np.float64)
                if (np.abs(values) < _FARTHEST_M).all():  # which no NaN is
                    arrays[name] = values
    return place_of(arrays, shape, _number(scalars, "resolution_m"))


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
