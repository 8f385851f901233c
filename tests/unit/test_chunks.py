"""Chunks of arrays: what was written, kept as far as allowed; what was damaged is an error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec

from joulemap.model.errors import DamagedError
from joulemap.planner.lattice import chunks as chunks_module
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import PIECE_BYTES, Checksums
from joulemap.planner.lattice.chunks import Chunks, read

VALUES = np.random.default_rng(5).normal(size=(25, 33, 4)).astype(np.float32)


def checked(written: zarr.Array) -> zarr.Array:
    """The same array, as a cost map's are opened."""
    folder = Path(str(written.store_path.store.root))
    opened = zarr.open_array(CheckedStore(Checksums.take(folder)), mode="r")
    assert isinstance(opened, zarr.Array)
    return opened


@pytest.mark.parametrize("content", [b"", b"no chunk", None])
def test_a_chunk_that_no_decoder_takes_is_an_error(tmp_path, content) -> None:
    array = zarr.create_array(
        tmp_path / "a", shape=VALUES.shape, chunks=VALUES.shape, dtype="float32", compressors=BloscCodec()
    )
    array[:] = VALUES
    (file,) = (path for path in (tmp_path / "a" / "c").rglob("*") if path.is_file())
    file.write_bytes(file.read_bytes()[:-9] if content is None else content)  # before its checksum is taken
    with pytest.raises(DamagedError, match=r"damaged: a: "):
        read(checked(array))


def test_a_bit_of_a_chunk_and_a_lost_one_are_errors(tmp_path) -> None:
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
    chunks = Chunks(10**9)
    np.testing.assert_array_equal(chunks.get(array, 0, 0), values[:40])
    with pytest.raises(DamagedError, match="a/c/1/0/0: its content"):
        chunks.get(array, 1, 0)
    file.unlink()
    with pytest.raises(DamagedError, match="a/c/1/0/0: it is missing"):
        read(array)


def test_no_more_is_kept_than_allowed(tmp_path, monkeypatch) -> None:
    array = zarr.create_array(tmp_path / "a", shape=(80, 8), chunks=(8, 8), dtype="uint8", compressors=BloscCodec())
    array[:] = np.arange(640, dtype=np.uint8).reshape(80, 8)
    array = checked(array)
    seen: list[int] = []
    monkeypatch.setattr(chunks_module, "read", lambda of, part: seen.append(part[0].start // 8) or read(of, part))
    chunks = Chunks(3 * 64)
    got = [chunks.get(array, i, 0) for i in (*range(10), *reversed(range(10)))]
    np.testing.assert_array_equal(np.vstack(got[:10]), array[:])
    np.testing.assert_array_equal(np.vstack(got[:9:-1]), array[:])
    assert seen == [*range(10), *reversed(range(7))]
