"""docs/how-to/add-a-heightmap-format.md: its example is run and registered, and a file is read with it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rasterio.io import MemoryFile

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain import formats
from joulemap.model.terrain.readers import open_ground
from joulemap.service.library.heightmaps import read_heightmap
from tests.docs.code_blocks import Machine, blocks_of

PAGE = "docs/how-to/add-a-heightmap-format.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """The page after its last block; its format is known while the tests of this module run."""
    known, path = list(formats.FORMATS), list(sys.path)
    with Machine(tmp_path_factory.mktemp("page")) as machine:
        for block in blocks_of(PAGE):
            machine.run(block)
        yield machine
    formats.FORMATS[:], sys.path[:] = known, path
    sys.modules.pop("surfer_grid", None)


def test_the_file_of_the_page_is_read(page: Machine) -> None:
    """Centres from (500000, 4100000) in steps of 1 m: the outer edges lie 0.5 m further out; row 0 is north."""
    heightmap = page.names["hill"]
    expected = [[15.0, 15.5, 16.0, 16.5], [12.0, 12.5, np.nan, 13.5], [10.0, 10.5, 11.0, 11.5]]
    np.testing.assert_array_equal(heightmap.heights, np.array(expected, dtype=np.float32))
    assert heightmap.frame == GridFrame(499_999.5, 4_100_002.5, 1.0, 3, 4, "EPSG:32630")


def test_it_agrees_with_gdal(page: Machine) -> None:
    data = (page.folder / "hill.grd").read_bytes()
    with MemoryFile(data) as memory, memory.open(driver="GSAG") as dataset:
        theirs = dataset.read(1, masked=True).filled(np.nan)
        np.testing.assert_allclose(read_heightmap(data).heights, theirs)
        assert read_heightmap(data).frame.bounds == pytest.approx(tuple(dataset.bounds))


def test_what_is_broken_or_too_large_is_refused(page: Machine) -> None:
    whole = (page.folder / "hill.grd").read_bytes()
    for change in ((b"16.5\n", b"\n"), (b"12.5", b"abc"), (b"4100002", b"4100004"), (b"500003", b"nan")):
        with pytest.raises(HeightmapError):
            read_heightmap(whole.replace(*change))
    with pytest.raises(HeightmapError, match="header"):
        read_heightmap(whole[:20])
    with pytest.raises(TooLargeError):
        read_heightmap(whole.replace(b"4 3\n", b"40000 30000\n"))


def test_the_lists_name_it_and_work_by_windows_reads_it_whole(page: Machine) -> None:
    assert "Surfer ASCII grid (.grd)" in formats.formats_in_words()
    with pytest.raises(HeightmapError, match="not what its name says"):
        read_heightmap(b"hello, this is no map", filename="map.grd")
    path = Path(page.folder / "hill.grd")
    assert open_ground(path).data_hash == read_heightmap(path).data_hash


def test_one_line_and_one_module_are_all_that_a_format_of_joulemap_needs() -> None:
    """What the page says: as many modules that recognise files as there are lines."""
    folder = Path(formats.__file__).parent
    modules = {
        f".{file.stem}" for file in folder.glob("*.py") if "\ndef recognise(" in file.read_text(encoding="utf-8")
    }
    assert {each.module for each in formats.FORMATS if each.module.startswith(".")} == modules
