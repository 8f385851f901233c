"""LAS and LAZ point clouds: the mean height of the ground points of each cell, and holes where there is none."""

from __future__ import annotations

import struct
from typing import Any, BinaryIO

import numpy as np

from joulemap.model.errors import HeightmapError, JoulemapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.crs_text import proj_crs
from joulemap.model.terrain.decoded import Decoded, Scaling
from joulemap.model.terrain.point_grid import PointGrid
from joulemap.model.terrain.units import HeightUnit, height_unit

_GROUND = 2  # class of the LAS specification
_CHUNK_POINTS = 1_000_000
_HEADER_BYTES = 375  # of LAS 1.4, whose specification says where the fields are
_POINTS_AT, _FORMAT_AT, _COMPRESSED = 96, 104, 0x80
_RECORDS_AT, _RECORD_BYTES = 100, 54
_LONG_RECORDS_AT, _LONG_RECORD_BYTES = 243, 60


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(b"LASF")


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Lay a grid over the points that are classified as ground, or over all where none is."""
    try:
        import laspy
    except ImportError as error:
        raise HeightmapError(
            f"{source.name} is a LAS point cloud; the library laspy that reads it is not installed: pip install "
            "'joulemap[clouds]'"
        ) from error
    _check_counts(source)
    done = 0
    try:
        with source.open() as stream, laspy.open(stream, laz_backend=laspy.LazBackend.Lazrs) as cloud:
            header = cloud.header
            count = int(header.point_count)
            if count < 4:
                raise HeightmapError(f"{source.name} holds {count} points: there is no ground in it", points=count)
            if not header.are_points_compressed and count * header.point_format.size > source.size_bytes:
                raise HeightmapError(
                    f"the point cloud is truncated: {count:,} points declared, room for "
                    f"{source.size_bytes // header.point_format.size:,}"
                )
            (west, south), (east, north) = map(float, header.mins[:2]), map(float, header.maxs[:2])
            bounds = (west, south, east, north)
            how: dict[str, Any] = {"cell_m": scaling.cell_m, "max_cells": max_cells, "what": source.name}
            every = PointGrid(bounds, count, **how)
            ground = PointGrid(bounds, count, **how | {"cell_m": every.cell_m})
            classified = 0
            for points in cloud.chunk_iterator(_CHUNK_POINTS):
                x, y, z = (np.asarray(getattr(points, axis), dtype=np.float64) for axis in "xyz")
                known = np.asarray(points.classification) == _GROUND
                every.add(x, y, z)
                ground.add(x[known], y[known], z[known])
                classified += int(known.sum())
                done += x.size
            if done < count:
                raise HeightmapError(f"the point cloud is truncated: {count:,} points declared, {done:,} there")
            crs, whole_crs = _crs(header)
    except (JoulemapError, MemoryError):
        raise
    except Exception as error:  # laspy and its decoders do not say what they raise on a broken file
        what = "ends too early" if isinstance(error, (EOFError, struct.error)) else str(error).split("\n")[0][:200]
        raise HeightmapError(f"the point cloud is truncated or corrupt after {done:,} points: {what}") from error
    grid = ground if classified else every
    heights = grid.heights()
    unit = height_unit(None, whole_crs, source.name, or_horizontal=True)  # LAS 1.4 R15, 3.2: x, y and z of the CRS
    if scaling.scale_m is not None:
        unit = HeightUnit()
    return Decoded(
        scaling.to_metres(heights, known=~np.isnan(heights), band_scale=unit.factor),
        west_m=grid.west_m,
        north_m=grid.north_m,
        resolution_m=grid.cell_m,
        crs=crs,
        notes=(unit.note,) if unit.note else (),
    )


def _check_counts(source: SourceFile) -> None:
    """Refuse more records than there is room for: laspy would read them beyond the end of the file."""
    with source.open() as stream:
        head = stream.read(_HEADER_BYTES)
        if len(head) > _FORMAT_AT and head[_FORMAT_AT] & _COMPRESSED:
            _check_chunks(source, stream, head)
    for place, least in ((_RECORDS_AT, _RECORD_BYTES), (_LONG_RECORDS_AT, _LONG_RECORD_BYTES)):
        field = head[place : place + 4]
        long = place == _LONG_RECORDS_AT
        if len(field) < 4 or (long and tuple(head[24:26]) < (1, 4)):
            continue
        (count,) = struct.unpack("<I", field)
        if count * least > source.size_bytes:
            raise HeightmapError(
                f"the point cloud is truncated or corrupt: {count:,} variable length records declared, room for "
                f"{source.size_bytes // least:,}",
                declared=count,
            )


def _check_chunks(source: SourceFile, stream: BinaryIO, head: bytes) -> None:
    """Refuse a table of more chunks than there are bytes: the decoder would read it for ever."""
    (points_at,) = struct.unpack_from("<I", head, _POINTS_AT)
    stream.seek(points_at)
    place = stream.read(8)
    if len(place) < 8:
        raise HeightmapError(f"the point cloud is truncated: its points begin at byte {points_at:,}, beyond its end")
    (table_at,) = struct.unpack("<q", place)
    if table_at == -1 and source.size_bytes > points_at + 16:  # written at the end, where it was not known before
        stream.seek(source.size_bytes - 8)
        (table_at,) = struct.unpack("<q", stream.read(8))
    if not points_at < table_at <= source.size_bytes - 8:
        raise HeightmapError(
            f"the point cloud is truncated or corrupt: its table of chunks begins at byte {table_at:,} of "
            f"{source.size_bytes:,}"
        )
    stream.seek(table_at)
    _, chunks = struct.unpack("<II", stream.read(8))
    if chunks > source.size_bytes:
        raise HeightmapError(f"the point cloud is corrupt: {chunks:,} chunks declared in {source.size_bytes:,} bytes")


def _crs(header: Any) -> tuple[str | None, str | None]:
    """The horizontal CRS, if the file names one, and all of it."""
    written = header.parse_crs()
    if written is None:
        return None, None
    crs = proj_crs(written)
    flat = crs.to_2d()
    code = flat.to_epsg()
    return f"EPSG:{code}" if code else str(flat.to_wkt("WKT1_GDAL")), str(crs.to_wkt())
