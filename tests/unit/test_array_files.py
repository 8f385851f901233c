"""Heightmaps from ESRI ASCII, .npy and .npz: what is read, and what is refused with which words."""

import numpy as np
import pytest
from rasterio.io import MemoryFile

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.service.library.heightmaps import read_heightmap
from tests.reference.heightmap_files import ASC, HEIGHTS, npy, npy_header, npz


def test_ascii_grid_by_corner_and_by_centre() -> None:
    expected = np.array([[1, 2, 3], [4, np.nan, 6.5]], dtype=np.float32)
    by_corner = read_heightmap(ASC, filename="a.asc", crs="EPSG:32630")
    np.testing.assert_array_equal(by_corner.heights, expected)
    assert by_corner.frame == GridFrame(10.0, 24.0, 2.0, 2, 3, "EPSG:32630")
    centred = ASC.replace(b"xllcorner 10", b"XLLCENTER 11").replace(b"yllcorner 20", b"yllcenter 21")
    assert read_heightmap(centred).frame == GridFrame(10.0, 24.0, 2.0, 2, 3)
    mixed = ASC.replace(b"yllcorner 20", b"yllcenter 21").replace(b"\n", b"\r\n")
    assert read_heightmap(mixed).frame == GridFrame(10.0, 24.0, 2.0, 2, 3)
    default = ASC.replace(b"NODATA_value -1\n", b"").replace(b"-1", b"-9999")  # -9999 is the format's own default
    np.testing.assert_array_equal(read_heightmap(default).heights, expected)


def test_ascii_grid_agrees_with_gdal() -> None:
    rows = "\n".join(" ".join(f"{v:.3f}" for v in row) for row in HEIGHTS)
    text = f"ncols 60\nnrows 40\nxllcorner 7\nyllcorner 8\ncellsize 0.5\nNODATA_value -1\n{rows}\n".encode()
    with MemoryFile(text) as memory, memory.open(driver="AAIGrid") as dataset:
        np.testing.assert_allclose(read_heightmap(text).heights, dataset.read(1), atol=1e-6)
        assert read_heightmap(text).frame.bounds == tuple(dataset.bounds)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((b"4 -1 6.5", b"4 -1"), "truncated"),
        ((b"6.5", b"6.5 7"), "6 heights declared, 7 there"),
        ((b"6.5", b"abc"), "not a number"),
        ((b"6.5", b"1e99"), "beyond"),
        ((b"cellsize 2", b"dx 2\ndy 3"), "2 x 3"),
        ((b"cellsize 2", b"cellsize two"), "cellsize is 'two', not a number"),
        ((b"cellsize 2", b"cellsize 2,0"), "cellsize is '2,0', not a number; decimals need a point"),
        ((b"cellsize 2", b"cellsize 0"), "resolution"),
        ((b"ncols 3", b"ncols 2.5"), "whole number"),
        ((b"ncols 3\n", b""), "whole number"),
        ((b"nrows 2", b"nrows 0"), "nothing in it"),
        ((b"xllcorner 10", b"xllcorner nan"), "finite"),
    ],
)
def test_broken_ascii_grids_are_refused(change: tuple[bytes, bytes], words: str) -> None:
    assert change[0] in ASC
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(ASC.replace(*change))


def test_npy_of_any_real_type_and_order() -> None:
    for values in (HEIGHTS.astype(np.float64), np.asfortranarray(HEIGHTS), HEIGHTS.astype(">f4")):
        heightmap = read_heightmap(npy(values), resolution_m=0.5)
        np.testing.assert_array_equal(heightmap.heights, HEIGHTS)
        assert heightmap.frame.bounds == (0.0, 0.0, 30.0, 20.0)
    counts = np.arange(12, dtype=np.uint16).reshape(3, 4)
    scaled = read_heightmap(npy(counts), resolution_m=1.0, scale_m=0.01, offset_m=5.0, nodata=3)
    assert scaled.heights[2, 3] == pytest.approx(5.11)
    assert np.isnan(scaled.heights[0, 3])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (npy(HEIGHTS)[:-1], "truncated"),
        (npy(HEIGHTS)[:40], "truncated"),
        (npy(HEIGHTS)[:9], "header"),
        (npy(HEIGHTS[0]), "2-D"),
        (npy(HEIGHTS.astype(complex)), "real numbers"),
        (npy(HEIGHTS > 1), "real numbers"),
        (npy_header((2, 2), "|O") + b"cos\nsystem\n(S'echo'\ntR.", "real numbers"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + b" " * 50, "header"),
    ],
)
def test_broken_npy_files_are_refused(data: bytes, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(data, resolution_m=1.0)


def test_npz_brings_its_own_place() -> None:
    data = npz(heights=HEIGHTS, resolution_m=0.5, west_m=10, north_m=np.float32(70.0), crs="EPSG:32630")
    assert read_heightmap(data).frame == GridFrame(10.0, 70.0, 0.5, 40, 60, "EPSG:32630")
    assert read_heightmap(npz(heights=HEIGHTS), resolution_m=2.0).frame.bounds == (0.0, 0.0, 120.0, 80.0)


PLACED = {  # 40 rows and 60 columns of 0.5 m, with the south-western corner at (10, 50)
    "bounds": {"bounds": [10.0, 50.0, 40.0, 70.0]},
    "extent of matplotlib": {"extent": [10.0, 40.0, 50.0, 70.0], "resolution": 0.5},
    "bounds of the outer centres": {"bounds": [10.25, 50.25, 39.75, 69.75], "resolution": 0.5},
    "transform of rasterio": {"transform": [[0.5, 0.0, 10.0], [0.0, -0.5, 70.0], [0.0, 0.0, 1.0]]},
    "transform of GDAL": {"geotransform": [10.0, 0.5, 0.0, 70.0, 0.0, -0.5]},
    "edges": {"west": 10, "north": 70, "cellsize": 0.5},
    "four edges": {"left": 10, "bottom": 50, "right": 40, "top": 70},
    "ends": {"x_min": 10.0, "x_max": 40.0, "y_min": 50.0, "y_max": 70.0, "resolution_m": 0.5},
    "corner of ESRI": {"xllcorner": 10.0, "yllcorner": 50.0, "cellsize": 0.5},
    "centres beside a resolution": {
        "x": 10.25 + 0.5 * np.arange(60),
        "y": 69.75 - 0.5 * np.arange(40),
        "resolution": 0.5,
    },
}


@pytest.mark.parametrize("kind", PLACED)
def test_npz_lies_where_its_arrays_say(kind: str) -> None:
    heightmap = read_heightmap(npz(elevation=HEIGHTS, crs="EPSG:32630", **PLACED[kind]))
    assert heightmap.frame == GridFrame(10.0, 70.0, 0.5, 40, 60, "EPSG:32630")
    np.testing.assert_array_equal(heightmap.heights, HEIGHTS)
    assert not heightmap.notes


def test_npz_is_turned_where_its_transform_begins_in_the_south() -> None:
    heightmap = read_heightmap(npz(elevation=HEIGHTS[::-1], transform=[0.5, 0.0, 10.0, 0.0, 0.5, 50.0]))
    assert heightmap.frame.bounds == (10.0, 50.0, 40.0, 70.0)
    np.testing.assert_array_equal(heightmap.heights, HEIGHTS)


@pytest.mark.parametrize(
    "place",
    [
        {"origin": [10.0, 50.0]},
        {"x0": 10.0, "y0": 50.0},
        {"bounds": [10.0, 50.0, 99.0, 70.0]},
        {"transform": [0.5, 0.1, 10.0, 0.1, -0.5, 70.0]},
        {"x_min": 10.0, "y_min": 50.0},
        {"transform": [np.nan] * 6},
    ],
)
def test_an_array_of_npz_that_does_not_say_clearly_where_it_lies_is_named(place: dict[str, object]) -> None:
    with pytest.warns(UserWarning, match=next(iter(place))):
        heightmap = read_heightmap(npz(elevation=HEIGHTS, resolution=0.5, crs="EPSG:32630", **place))
    assert heightmap.frame.bounds == (0.0, 0.0, 30.0, 20.0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (npz(h=HEIGHTS), "no array `heights`; it has h"),
        (npz(heights=HEIGHTS), "resolution_m"),
        (npz(heights=HEIGHTS, resolution_m=[1.0, 2.0]), "single number"),
        (npz(heights=HEIGHTS, resolution_m="wide"), "finite number"),
        (npz(heights=HEIGHTS, resolution_m=np.nan), "finite number"),
        (npz(heights=HEIGHTS, resolution_m=0.0), "resolution"),
        (npz(heights=HEIGHTS, resolution_m=1.0)[:500], "truncated or corrupt"),
        (b"PK\x03\x04" + b"\0" * 100, "truncated or corrupt"),
    ],
)
def test_broken_npz_files_are_refused(data: bytes, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(data)
