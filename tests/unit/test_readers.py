"""Heightmaps from files of any format: what contradicts itself, is too large, or is no heightmap is refused."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.readers import read_heightmap
from tests.reference.heightmap_files import (
    ASC,
    HEIGHTS,
    geotiff,
    huge_geotiff,
    huge_npz,
    npy,
    npy_header,
    png_header,
)


def test_what_contradicts_the_file_is_refused() -> None:
    assert read_heightmap(geotiff(), resolution_m=0.5002, crs="EPSG:32630").resolution_m == 0.5
    with pytest.raises(HeightmapError, match=r"1 m was given.*0\.5 m"):
        read_heightmap(geotiff(), resolution_m=1.0)
    with pytest.raises(HeightmapError, match=r"EPSG:32631 was given.*EPSG:32630"):
        read_heightmap(geotiff(), crs="EPSG:32631")
    for unknown in (
        "EPSG:nowhere",
        "EPSG:9999999999",
        "EPSG:1",
        "/etc/passwd",
        "http://localhost/1",
        "PROJCS[",
    ):
        with pytest.raises(HeightmapError, match="not known"):
            read_heightmap(npy(HEIGHTS), resolution_m=1.0, crs=unknown)
    with pytest.raises(HeightmapError, match="degrees"):
        read_heightmap(npy(HEIGHTS), resolution_m=1.0, crs="EPSG:4326")


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_resolutions_are_refused(bad: float) -> None:
    with pytest.raises(HeightmapError, match="resolution_m must be"):
        read_heightmap(npy(HEIGHTS), resolution_m=bad)


@pytest.mark.parametrize("suspect", [-9999.0, -32768.0])
def test_an_undeclared_nodata_value_is_refused_and_can_be_named(suspect: float) -> None:
    heights = HEIGHTS.copy()
    heights[0, 0] = suspect
    for source in (geotiff(heights), npy(heights)):
        options = {} if source[:2] == b"II" else {"resolution_m": 1.0}
        with pytest.raises(HeightmapError, match=f"nodata={suspect:g}"):
            read_heightmap(source, **options)
        assert np.isnan(read_heightmap(source, nodata=suspect, **options).heights[0, 0])
    heights[0, 0] = -3.4e38
    with pytest.raises(HeightmapError, match="nodata"):
        read_heightmap(geotiff(heights))


def test_a_map_of_unknowns_is_refused() -> None:
    with pytest.raises(HeightmapError, match="every cell"):
        read_heightmap(geotiff(np.full((4, 4), -9999.0, dtype=np.float32), nodata=-9999.0))
    with pytest.raises(HeightmapError, match="2 x 2"):
        read_heightmap(geotiff(HEIGHTS[:1]))


@pytest.mark.parametrize(
    "data",
    [
        huge_geotiff(),
        npy_header((40_000, 30_000)),
        huge_npz(),
        png_header(40_000, 30_000),
        ASC.replace(b"ncols 3", b"ncols 40000").replace(b"nrows 2", b"nrows 30000"),
    ],
    ids=["geotiff", "npy", "npz", "png", "ascii"],
)
def test_a_billion_cells_in_a_tiny_file_are_never_allocated(data: bytes) -> None:
    assert len(data) < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(TooLargeError, match="1200000000 cells, more than the limit of 400000000") as caught:
            read_heightmap(data, resolution_m=0.5, scale_m=1.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert caught.value.context == {"cells": 1_200_000_000, "limit": 400_000_000}
    assert peak < 5_000_000


def test_a_bomb_behind_an_honest_header_stays_packed() -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("heights.npy", npy(HEIGHTS) + b"\0" * 50_000_000)
        archive.writestr("resolution_m.npy", npy_header((), "<f8") + b"\0" * 50_000_000)
    tracemalloc.start()
    try:
        with pytest.raises(HeightmapError, match="resolution"):
            read_heightmap(out.getvalue())
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("data", "name", "words"),
    [
        (b"", "map.tif", "empty"),
        (b"hello, this is no map", "notes.txt", "not a heightmap: GeoTIFF"),
        (b"hello, this is no map", "map.tif", "not what its name says"),
        (b"\xff\xd8\xff\xe0" + b"\0" * 100, "photo.jpg", "not a heightmap"),
        (b"II*\0" + b"\xff" * 200, "map.tif", "truncated or corrupt"),
        (b"II*\0" + b"\0" * 200, "map.tif", "truncated or corrupt"),
        (b"<VRTDataset rasterXSize='2' rasterYSize='2'/>", "map.vrt", "not a heightmap"),
        (b"/etc/passwd", "map.asc", "not what its name says"),
    ],
)
def test_what_is_no_heightmap_is_refused(data: bytes, name: str, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(data, filename=name)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(HeightmapError, match=r"nowhere\.tif"):
        read_heightmap(tmp_path / "nowhere.tif")
    with pytest.raises(HeightmapError, match="there is no file"):
        read_heightmap("/vsicurl/http://localhost/map.tif")
