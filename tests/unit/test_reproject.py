"""Heightmaps in any CRS: against PROJ on a surface that is known everywhere, against GDAL's warp, and by true sizes."""

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.plausible import heightmap_warnings
from joulemap.model.terrain.readers import open_ground
from joulemap.service.library.heightmaps import read_heightmap
from tests.reference.dems import CASES, COLS, ROWS, SECOND, beside_gdal, judged, made


@pytest.mark.parametrize("name", CASES)
def test_heights_and_sizes_are_true(name):
    one = judged(name)
    target = CASES[name][3]
    if target is not None:
        assert one.found.frame.crs == target
    assert one.inner_m < one.bound_m
    assert one.worst_m < 0.05 * one.found.resolution_m  # the outer half cell continues the nearest height
    assert one.covered == pytest.approx(0.0, abs=0.02)  # of pixels
    assert one.length == pytest.approx(0.0, abs=0.001)
    assert one.area == pytest.approx(0.0, abs=0.001)
    assert one.found.notes[0].startswith("reprojected from")


@pytest.mark.parametrize("name", CASES)
def test_gdals_own_warp_gives_the_same(name):
    away_m, apart = beside_gdal(name, read_heightmap(made(*CASES[name][:2], **CASES[name][2])[0], reproject="auto"))
    assert away_m < 0.01
    assert apart < 0.005


def test_by_windows_it_is_the_same_as_whole(tmp_path):
    content, _, _ = made(*CASES["degrees, south"][:2], hole=True)
    (tmp_path / "dem.tif").write_bytes(content)
    whole = read_heightmap(tmp_path / "dem.tif", reproject="auto", resolution_m=12.5)
    assert whole.resolution_m == 12.5
    ground = open_ground(tmp_path / "dem.tif", reproject="auto", resolution_m=12.5)
    assert ground.frame == whole.frame
    assert ground.data_hash == whole.data_hash
    np.testing.assert_array_equal(ground.window(31, 70, 11, 90).heights, whole.heights[31:70, 11:90])


def test_integers_are_interpolated_and_text_grids_in_degrees_are_read():
    content, _, _ = made("EPSG:4326", Affine(SECOND, 0, -4.5, 0, -SECOND, 36.74), dtype="int16", hole=True)
    found = read_heightmap(content, filename="dem.tif", reproject="EPSG:25830")
    assert found.frame.crs == "EPSG:25830"
    known = found.heights[~np.isnan(found.heights)]
    assert (known % 1 != 0).mean() > 0.3
    text = "ncols 4\nnrows 3\nxllcorner -4.5\nyllcorner 36.7\ncellsize 0.0003\nNODATA_value -1\n" + "5 6 7 8\n" * 3
    found = read_heightmap(text.encode(), filename="a.asc", crs="EPSG:4326", reproject="auto")
    assert found.frame.crs == "EPSG:32630"
    assert found.resolution_m == pytest.approx(29.8, rel=0.02)
    with pytest.raises(HeightmapError, match="degrees"):
        read_heightmap(text.encode(), filename="a.asc", crs="EPSG:4326")


def test_what_cannot_be_reprojected_is_said():
    plain, _, _ = made("EPSG:4326", Affine(SECOND, 0, -4.5, 0, -SECOND, 36.74))
    with pytest.raises(HeightmapError, match="Mercator"):
        read_heightmap(plain, filename="dem.tif", reproject="EPSG:3857")
    with pytest.raises(HeightmapError, match="not known"):
        read_heightmap(plain, filename="dem.tif", reproject="north")
    with pytest.raises(TooLargeError, match=r"reprojected to cells of 0\.01 m.*more than the limit"):
        read_heightmap(plain, filename="dem.tif", reproject="auto", resolution_m=0.01)
    wide, _, _ = made("EPSG:4326", Affine(0.4, 0, -20, 0, -0.4, 60))
    with pytest.raises(HeightmapError, match="too large for one CRS"):
        read_heightmap(wide, filename="dem.tif", reproject="auto")
    nowhere, _, _ = made("EPSG:4326", Affine(SECOND, 0, -4.5, 0, -SECOND, 36.74))
    with rasterio.MemoryFile(nowhere) as memory, memory.open() as dataset:
        heights = dataset.read(1)
    heights[3, 3] = -9999
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=COLS,
            height=ROWS,
            count=1,
            dtype="float32",
            crs="EPSG:4326",
            transform=Affine(SECOND, 0, -4.5, 0, -SECOND, 36.74),
        ) as dataset:
            dataset.write(heights, 1)
        undeclared = bytes(memory.getbuffer())
    with pytest.raises(HeightmapError, match="-9999, the usual mark"):
        read_heightmap(undeclared, filename="dem.tif", reproject="auto")
    assert np.isnan(read_heightmap(undeclared, filename="d.tif", reproject="auto", nodata=-9999).heights).any()


def plane(heights, **frame):
    from joulemap.model.frames import GridFrame
    from joulemap.model.terrain.heightmap import Heightmap

    rows, cols = heights.shape
    return Heightmap(
        heights.astype(np.float32),
        GridFrame(**({"west_m": 0.0, "north_m": 90.0, "resolution_m": 1.0} | frame), rows=rows, cols=cols),
    )


def test_maps_that_are_hardly_what_they_are_taken_for():
    row, col = np.mgrid[0:90, 0:80]
    ground = 0.1 * row + 0.07 * col + np.sin(row / 9.0)
    assert heightmap_warnings(plane(ground)) == []
    assert "whole metre" in heightmap_warnings(plane(np.round(ground)))[0]
    (said,) = heightmap_warnings(plane(np.round(100 * ground)))
    assert "are its heights in centimetres: then `scale_m` is 0.01?" in said
    (said,) = heightmap_warnings(plane(ground, west_m=367_000.0, north_m=4_064_000.0))
    assert "names no coordinate reference system" in said
    (said,) = heightmap_warnings(plane(ground, west_m=350_000.0, north_m=-200_000.0, crs="EPSG:3413"))
    assert "% too short here: `reproject` as auto" in said
    assert heightmap_warnings(plane(ground, west_m=367_000.0, north_m=4_064_000.0, crs="EPSG:32630")) == []


def test_where_a_zone_stretches_more_than_usual_it_is_said():
    edge = read_heightmap(made("EPSG:4326", Affine(SECOND, 0, 5.97, 0, -SECOND, 0.1))[0], reproject="auto")
    assert "(UTM zone 31N, which stretches lengths by 0.10 % here)" in edge.notes[0]
    middle = read_heightmap(made("EPSG:4326", Affine(SECOND, 0, 3.0, 0, -SECOND, 0.1))[0], reproject="auto")
    assert "(UTM zone 31N)" in middle.notes[0]


def test_a_map_in_feet_that_does_not_say_the_unit_of_its_heights_says_so():
    content = made("EPSG:2263", Affine(3.28, 0, 980_000, 0, -3.28, 200_000))[0]
    said = read_heightmap(content, filename="dem.tif", reproject="auto").notes[1]
    assert "does not say the unit of its heights, which were taken for metres: give `scale_m` as 0.3048" in said
    for scale_m in (1.0, 0.3048):
        (said,) = read_heightmap(content, filename="dem.tif", reproject="auto", scale_m=scale_m).notes
        assert "unit of its heights" not in said
