"""Large arrays in small pages are arrays like others."""

from __future__ import annotations

import mmap
import re
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.pages import empty_in_small_pages


@pytest.mark.parametrize("shape", [(3, 4), (1500, 1000, 3), (0, 5)])
def test_an_array_of_any_size_can_be_written_and_read(shape: tuple[int, ...]) -> None:
    found = empty_in_small_pages(shape, np.float32)
    assert found.shape == shape
    assert found.dtype == np.float32
    assert found.flags.c_contiguous
    found[...] = np.arange(found.size, dtype=np.float32).reshape(shape)
    assert float(found.sum(dtype=np.float64)) == found.size * (found.size - 1) / 2


@pytest.mark.skipif(not Path("/sys/kernel/mm/transparent_hugepage").exists(), reason="a kernel without large pages")
def test_a_large_array_has_no_huge_pages() -> None:
    found = empty_in_small_pages((4_000_000,), np.float64)
    found[...] = 1.0
    address = found.__array_interface__["data"][0]
    for part in re.split(r"\n(?=[0-9a-f]+-[0-9a-f]+ )", Path("/proc/self/smaps").read_text()):
        first, last = (int(end, 16) for end in part.split()[0].split("-"))
        if first <= address < last:
            assert re.search(r"AnonHugePages: +0 kB", part)
            assert re.search(r"VmFlags:.* nh", part)
            return
    raise AssertionError("its memory is not in the list of the process")


def test_a_kernel_without_large_pages_gives_the_array_too(monkeypatch: pytest.MonkeyPatch) -> None:
    class Refusing(mmap.mmap):
        def madvise(self, *_: int) -> None:
            raise OSError(22, "Invalid argument")

    monkeypatch.setattr(mmap, "mmap", Refusing)
    found = empty_in_small_pages((2_000_000,), np.float64)
    found[...] = 3.0
    assert float(found.sum()) == 6_000_000.0
