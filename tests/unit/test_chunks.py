"""Chunks read without zarr are what zarr reads, whoever wrote them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec, GzipCodec

from joulemap.model.errors import DamagedError
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import PIECE_BYTES, Checksums
from joulemap.planner.lattice.chunks import Chunks, read_array, read_chunk

VALUES = np.random.default_rng(5).normal(size=(25, 33, 4)).astype(np.float32)


def checked(written: zarr.Array) -> zarr.Array:
    """The same array, as a cost map's are opened."""
    folder = Path(str(written.store_path.store.root))
    opened = zarr.open_array(CheckedStore(Checksums.take(folder)), mode="r")
    assert isinstance(opened, zarr.Array)
    return opened


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
    array = checked(array)
    np.testing.assert_array_equal(read_array(array), VALUES)


def test_what_was_never_written_is_the_fill_value(tmp_path) -> None:
    array = zarr.create_array(
        tmp_path / "a", shape=(9, 9), chunks=(4, 4), dtype="uint8", fill_value=7, compressors=BloscCodec()
    )
    array[4:8, 4:8] = 1
    array = checked(array)
    assert read_chunk(array, 0, 2).tolist() == [[7]] * 4
    assert read_chunk(array, 1, 1).tolist() == [[1] * 4] * 4


@pytest.mark.parametrize("content", [b"", b"no chunk", None])
def test_a_chunk_that_no_decoder_takes_is_named(tmp_path, content) -> None:
    array = zarr.create_array(
        tmp_path / "a", shape=VALUES.shape, chunks=VALUES.shape, dtype="float32", compressors=BloscCodec()
    )
    array[:] = VALUES
    (file,) = (path for path in (tmp_path / "a" / "c").rglob("*") if path.is_file())
    file.write_bytes(file.read_bytes()[:-9] if content is None else content)  # before its checksum is taken
    with pytest.raises(DamagedError, match=r"damaged: a/c/0/0/0: "):
        read_chunk(checked(array), 0, 0)


@pytest.mark.parametrize("way", ["chunks", "zarr"])
def test_a_bit_of_the_rows_that_are_read_and_a_lost_chunk_are_errors(tmp_path, way) -> None:
    """Also in a part of a chunk that is read without the rest."""
    values = np.random.default_rng(7).normal(size=(80, 100, 16)).astype(np.float32)
    array = zarr.create_array(
        tmp_path / "a", shape=values.shape, chunks=(40, 100, 16), dtype="float32", compressors=BloscCodec(clevel=1)
    )
    array[:] = values
    array = checked(array)
    file = tmp_path / "a" / "c" / "1" / "0" / "0"
    content = bytearray(file.read_bytes())
    assert len(content) > 6 * PIECE_BYTES
    content[-20] ^= 4
    file.write_bytes(content)

    def _read(i: int, top: int, down: int) -> None:
        got = read_chunk(array, i, 0, top, down) if way == "chunks" else array[40 * i + top : 40 * i + down]
        np.testing.assert_array_equal(got, values[40 * i + top : 40 * i + down])

    _read(0, 0, 40)
    if way == "chunks":
        _read(1, 0, 5)
    with pytest.raises(DamagedError, match="a/c/1/0/0: its content"):
        _read(1, 30, 40)
    file.unlink()
    with pytest.raises(DamagedError, match="a/c/1/0/0: it is missing"):
        _read(1, 0, 40)


@pytest.mark.parametrize("shuffle", ["noshuffle", "shuffle", "bitshuffle"])
@pytest.mark.parametrize("values", [VALUES, np.zeros_like(VALUES), (VALUES * 1e9).view(np.uint32)])
@pytest.mark.parametrize("block", [0, 128, 1000, 100_000])
def test_some_rows_are_those_of_the_whole(tmp_path, shuffle, values, block) -> None:
    """Blocks of a row, of several, of parts of rows, and of more than the chunk; compressed and copied ones."""
    array = zarr.create_array(
        tmp_path / "a",
        shape=VALUES.shape,
        chunks=(16, 32, 4),
        dtype=values.dtype,
        compressors=BloscCodec(cname="lz4", shuffle=shuffle, blocksize=block),
    )
    array[:] = values
    array = checked(array)
    for i, rows in ((0, 16), (1, 9)):
        for top in range(rows):
            for down in range(top + 1, rows + 1):
                want = values[16 * i + top : 16 * i + down, 32:33]
                np.testing.assert_array_equal(read_chunk(array, i, 1, top, down), want)


def test_the_last_block_may_be_shorter(tmp_path) -> None:
    values = np.random.default_rng(7).normal(size=(70, 100, 16)).astype(np.float32)
    array = zarr.create_array(
        tmp_path / "a", shape=values.shape, chunks=values.shape, dtype="float32", compressors=BloscCodec(clevel=1)
    )
    array[:] = values
    array = checked(array)
    for top in range(70):
        np.testing.assert_array_equal(read_chunk(array, 0, 0, top), values[top:])


def test_no_more_is_kept_than_allowed(tmp_path, monkeypatch) -> None:
    array = zarr.create_array(tmp_path / "a", shape=(80, 8), chunks=(8, 8), dtype="uint8", compressors=BloscCodec())
    array[:] = np.arange(640, dtype=np.uint8).reshape(80, 8)
    array = checked(array)
    read: list[int] = []
    monkeypatch.setattr(
        "joulemap.planner.lattice.chunks.read_chunk", lambda of, i, *more: read.append(i) or read_chunk(of, i, *more)
    )
    chunks = Chunks(3 * 3 * 64)
    got = [chunks.get(array, i, 0, (0, 8), (0, 8)) for i in (*range(10), *reversed(range(10)))]
    np.testing.assert_array_equal(np.vstack(got[:10]), array[:])
    np.testing.assert_array_equal(np.vstack(got[:9:-1]), array[:])
    assert read == [*range(10), *reversed(range(7))]


def test_parts_are_those_of_the_whole_in_any_order(tmp_path) -> None:
    """From chunks that were read, from their borders, and from parts of borders."""
    array = zarr.create_array(
        tmp_path / "a", shape=VALUES.shape, chunks=(12, 16, 4), dtype="float32", compressors=BloscCodec()
    )
    array[:] = VALUES
    array = checked(array)
    chunks, rng = Chunks(4000), np.random.default_rng(6)
    for _ in range(2000):
        i, j = rng.integers(3, size=2)
        whole = VALUES[12 * i : 12 * i + 12, 16 * j : 16 * j + 16]
        (top, down), (left, right) = (np.sort(rng.choice(n + 1, 2, replace=False)).tolist() for n in whole.shape[:2])
        part = chunks.get(array, int(i), int(j), (top, down), (left, right))
        np.testing.assert_array_equal(part, whole[top:down, left:right])
