"""Points in PCD files: text, binary, or compressed."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.formats.point_lines import HEADER_BYTES, check_points, records, table

_PCD_TYPES = {
    "F4": "<f4",
    "F8": "<f8",
    **{f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in "1248"},
}


def is_pcd(head: bytes) -> bool:
    """Decide by the comment or the version that such a file begins with."""
    return head.startswith((b"# .PCD", b"VERSION .7", b"VERSION 0.7"))


def pcd_points(source: SourceFile, most: int) -> NDArray[np.float64]:
    """Read the points of a PCD file. The result is (n, 3)."""
    with source.open() as stream:
        content = stream.read()
    header, fields = dict[str, list[str]](), list[tuple[str, str, tuple[int, ...]]]()
    at = 0
    while "DATA" not in header:
        end = content.find(b"\n", at, at + HEADER_BYTES)
        if end < 0 or end > HEADER_BYTES:
            raise HeightmapError(f"{source.name} is truncated or corrupt: the header of its points has no end")
        key, *words = content[at:end].decode("ascii", "replace").split() or ["#"]
        header[key], at = words, end + 1
    try:
        counts = header.get("COUNT") or ["1"] * len(header["FIELDS"])
        for k, (name, kind, size, count) in enumerate(
            zip(header["FIELDS"], header["TYPE"], header["SIZE"], counts, strict=True)
        ):
            fields.append((name if name in "xyz" else f"_{k}", _PCD_TYPES[kind + size], (int(count),)))
        many = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        how = header["DATA"][0]
        record = np.dtype([(name, kind) if shape == (1,) else (name, kind, shape) for name, kind, shape in fields])
        axes = [record.names.index(axis) for axis in "xyz"]  # type: ignore[union-attr]
    except (KeyError, ValueError, IndexError) as error:
        raise HeightmapError(f"{source.name} is corrupt: the header of its points has no {error}") from error
    check_points(many, most, source.name)
    if how == "ascii":
        widths = np.cumsum([0, *(shape[0] for _, _, shape in fields)])
        return table(content[at:], many, int(widths[-1]), source.name)[:, widths[axes]]
    body = memoryview(content)[at:]
    if how == "binary_compressed":
        long, full = (int(each) for each in np.frombuffer(body[:8], "<u4")) if len(body) >= 8 else (0, 0)
        if full != many * record.itemsize or long > len(body) - 8:
            raise HeightmapError(
                f"{source.name} is truncated or corrupt: {many:,} points declared, {full:,} bytes packed"
            )
        plain, length = lzf(np.frombuffer(body[8 : 8 + long], np.uint8), full)
        if length != full:
            raise HeightmapError(f"{source.name} is truncated or corrupt: {length:,} of {full:,} bytes can be unpacked")
        sizes = np.cumsum([0, *(many * record[k].itemsize for k in range(len(fields)))])
        return np.column_stack(
            [plain[sizes[k] : sizes[k] + many * record[k].itemsize].view(record[k]) for k in axes]
        ).astype(np.float64)
    return records(body, record, many, source.name)


@njit(cache=True)
def lzf(packed: NDArray[np.uint8], size: int) -> tuple[NDArray[np.uint8], int]:
    """Unpack the LZF compression of PCD files. Result: the content, and how much of it could be unpacked."""
    out = np.zeros(size, np.uint8)
    i, o = 0, 0
    while i < packed.size:
        control = int(packed[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > packed.size or o + length > size:
                return out, o
            out[o : o + length] = packed[i : i + length]
            i, o = i + length, o + length
            continue
        length = control >> 5
        if length == 7:
            if i >= packed.size:
                return out, o
            length += int(packed[i])
            i += 1
        if i >= packed.size:
            return out, o
        back = o - ((control & 31) << 8) - int(packed[i]) - 1
        i, length = i + 1, length + 2
        if back < 0 or o + length > size:
            return out, o
        for k in range(length):
            out[o + k] = out[back + k]
        o += length
    return out, o
