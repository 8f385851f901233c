"""Heightmaps from files of any format: what contradicts itself, is too large, or is no heightmap is refused."""

import inspect
import io
import re
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from rasterio.crs import CRS

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.formats import FORMATS, formats_in_words
from joulemap.model.terrain.formats.contract import FormatModule
from joulemap.service.library.heightmaps import read_heightmap
from tests.reference.heightmap_files import (
    ASC,
    HEIGHTS,
    geotiff,
    huge_geotiff,
    huge_npz,
    npy,
    npy_header,
    npz,
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


WEB_MERCATOR = (
    "EPSG:3857",
    "EPSG:3395",
    "ESRI:102100",
    CRS.from_epsg(3857).to_wkt(),
    CRS.from_epsg(3857).to_wkt(version="WKT2_2019"),
)


@pytest.mark.parametrize("crs", WEB_MERCATOR, ids=lambda crs: crs[:12])
def test_mercator_metres_are_refused_with_their_stretch_and_the_utm_zone(crs: str) -> None:
    """y = 4,064,000 m is 34.26 degrees north on the sphere (34.4 on the ellipsoid): 1 / cos = 1.21."""
    place = {"resolution_m": 1.0, "west_m": -500_000.0, "north_m": 4_064_000.0}
    words = r"Mercator.*1/cos\(latitude\); here, at 34\.\d degrees north, by 2[01]\.\d %.*UTM zone 30N.*EPSG:32630"
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(npy(HEIGHTS), crs=crs, **place)
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(npz(heights=HEIGHTS, crs=crs, resolution_m=1.0, west_m=-500_000.0, north_m=4_064_000.0))
    with pytest.raises(
        HeightmapError, match=r"1/cos\(latitude\): give `reproject` as auto, or reproject it to its UTM"
    ):
        read_heightmap(npy(HEIGHTS), crs=crs, resolution_m=1.0)


def test_other_mercators_measure_true_metres() -> None:
    """Transverse and oblique Mercator (UTM; Swiss LV95) stretch by less than 0.1 %."""
    for crs in ("EPSG:32630", "EPSG:2056"):
        assert read_heightmap(npy(HEIGHTS), resolution_m=1.0, crs=crs).frame.crs == crs


def test_feet_and_places_south_of_the_equator_get_their_utm_zone() -> None:
    with pytest.raises(HeightmapError, match=r"foot.*UTM zone 11N.*EPSG:32611"):
        read_heightmap(npy(HEIGHTS), resolution_m=1.0, crs="EPSG:2229", west_m=6.5e6, north_m=1.8e6)
    with pytest.raises(HeightmapError, match=r"34\.0 degrees south, by 20\.6 %.*UTM zone 32S.*EPSG:32732"):
        read_heightmap(npy(HEIGHTS), resolution_m=1.0, crs="EPSG:3395", west_m=1e6, north_m=-4e6)


def test_a_reference_system_in_no_known_place_is_refused_without_a_zone() -> None:
    with pytest.raises(HeightmapError, match=r"degrees.*EPSG:326xx"):
        read_heightmap(npy(HEIGHTS), resolution_m=1.0, crs="EPSG:4326", west_m=5e5, north_m=4e6)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({}, "resolution_m"),
        ({"resolution_m": -1.0}, "resolution_m"),
        ({"resolution_m": 1.0, "scale_m": 0.0}, "scale_m"),
        ({"resolution_m": 1.0, "offset_m": float("inf")}, "offset_m"),
        ({"resolution_m": 1.0, "nodata": 5.0, "scale_m": 1e9}, "scale_m"),
    ],
)
def test_parameters_stand_in_backticks_alone(options: dict, name: str) -> None:
    """So that the command line and the service can put the name of their own option in their place."""
    with pytest.raises(HeightmapError) as caught:
        read_heightmap(npy(HEIGHTS), **options)
    assert f"`{name}`" in caught.value.message
    assert not re.search(rf"(?<!`)\b{name}\b|\b{name}\b(?!`)", caught.value.message)


def test_every_format_of_the_registry_keeps_the_contract() -> None:
    for each in FORMATS:
        for function in ("recognise", "decode"):
            if function == "decode" and hasattr(each.code, "open_windows"):
                continue
            wanted = list(inspect.signature(getattr(FormatModule, function)).parameters)[1:]
            assert list(inspect.signature(getattr(each.code, function)).parameters) == wanted
        assert f"{each.name} ({', '.join(each.suffixes[:3])}" in formats_in_words()


def test_the_list_of_formats_loads_neither_numpy_nor_gdal() -> None:
    """The help of the command line shows it."""
    code = (
        "import sys; from joulemap.model.terrain.formats import formats_in_words; formats_in_words(); "
        "sys.exit(any(name in sys.modules for name in ('numpy', 'rasterio')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("suspect", [-9999.0, -32768.0])
def test_an_undeclared_nodata_value_is_refused_and_can_be_named(suspect: float) -> None:
    heights = HEIGHTS.copy()
    heights[0, 0] = suspect
    for source in (geotiff(heights), npy(heights)):
        options = {} if source[:2] == b"II" else {"resolution_m": 1.0}
        with pytest.raises(HeightmapError, match=f"give `nodata` as {suspect:g}"):
            read_heightmap(source, **options)
        assert np.isnan(read_heightmap(source, nodata=suspect, **options).heights[0, 0])
    heights[0, 0] = -3.4028235e38  # of ArcGIS, and no height in any unit
    assert np.isnan(read_heightmap(geotiff(heights)).heights[0, 0])
    heights[0, 0] = -1e20
    with pytest.raises(HeightmapError, match=r"-1e\+20 m.*50000 m.*`nodata`.*`scale_m`"):
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
        (b"hello, this is no map", "notes.txt", "not a heightmap: NumPy array"),
        (b"hello, this is no map", "map.tif", "not what its name says"),
        (b"\xff\xd8\xff\xe0" + b"\0" * 100, "photo.jpg", "truncated or corrupt"),
        (b"II*\0" + b"\xff" * 200, "map.tif", "truncated or corrupt"),
        (b"II*\0" + b"\0" * 200, "map.tif", "truncated or corrupt"),
        (b"<VRTDataset rasterXSize='2' rasterYSize='2'/>", "map.vrt", "names other files"),
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
