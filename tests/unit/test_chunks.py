"""Chunks read without zarr are what zarr reads, whoever wrote them."""

from __future__ import annotations

import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec, GzipCodec

from joulemap.model.errors import InputError
from joulemap.planner.chunks import Chunks, read_array, read_chunk

VALUES = np.random.default_rng(5).normal(size=(25, 33, 4)).astype(np.float32)


@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize("compressor", [BloscCodec(cname="lz4"), BloscCodec(cname="zstd"), GzipCodec(), None])
@pytest.mark.parametrize("chunks", [(10, 16, 4), (25, 33, 4), (64, 8, 4), (10, 16, 2)])
def test_an_array_is_read_whoever_wrote_it(tmp_path, endian, compressor, chunks) -> None:
    array = zarr.create_array(
        tmp_path / "a",
        shape=VALUES.shape,
        chunks=chunks,
        dtype="float32",
        serializer=zarr.codecs.BytesCodec(endian=endian),
        compressors=compressor,
    )
    array[:] = VALUES
    np.testing.assert_array_equal(read_array(array), VALUES)


def test_what_was_never_written_is_the_fill_value(tmp_path) -> None:
    array = zarr.create_array(
        tmp_path / "a", shape=(9, 9), chunks=(4, 4), dtype="uint8", fill_value=7, compressors=BloscCodec()
    )
    array[4:8, 4:8] = 1
    assert read_chunk(array, 0, 2).tolist() == [[7]] * 4
    assert read_chunk(array, 1, 1).tolist() == [[1] * 4] * 4


@pytest.mark.parametrize("content", [b"", b"no chunk", None])
def test_a_damaged_chunk_is_named(tmp_path, content) -> None:
    array = zarr.create_array(
        tmp_path / "a", shape=VALUES.shape, chunks=VALUES.shape, dtype="float32", compressors=BloscCodec()
    )
    array[:] = VALUES
    (file,) = (path for path in (tmp_path / "a" / "c").rglob("*") if path.is_file())
    file.write_bytes(file.read_bytes()[:-9] if content is None else content)
    with pytest.raises(InputError, match=r"c/0/0/0 is a damaged chunk"):
        read_chunk(array, 0, 0)


def test_no_more_is_kept_than_allowed(tmp_path) -> None:
    array = zarr.create_array(tmp_path / "a", shape=(80, 8), chunks=(8, 8), dtype="uint8", compressors=BloscCodec())
    array[:] = np.arange(640, dtype=np.uint8).reshape(80, 8)
    chunks = Chunks(3 * 64)
    first = [chunks.get(array, i, 0) for i in range(10)]
    again = [chunks.get(array, i, 0) for i in reversed(range(10))]
    assert [a is b for a, b in zip(first, reversed(again), strict=True)] == [False] * 7 + [True] * 3
    np.testing.assert_array_equal(np.vstack(first), array[:])
