"""Heightmaps in any CRS: against PROJ on a surface that is known everywhere, against GDAL's warp, and by true sizes."""

import math

import numpy as np
import pytest
import rasterio
from pyproj import Geod, Transformer
from rasterio import warp
from rasterio.transform import Affine
from scipy import ndimage

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.plausible import heightmap_warnings
from joulemap.model.terrain.readers import open_ground, read_heightmap

ROWS, COLS = 90, 110


def surface(lon, lat, lon0, lat0):
    """Smooth heights [m] by place on Earth; true metres east and north of a place near by."""
    east = (lon - lon0) * 111_320.0 * math.cos(math.radians(lat0))
    north = (lat - lat0) * 110_574.0
    return 300.0 + 0.03 * east - 0.02 * north + 4.0 * np.sin(east / 190.0) * np.cos(north / 230.0)


def made(crs, transform, *, dtype="float32", hole=False, unit=None, scale=1.0, flip=False):
    """A GeoTIFF of the surface on a grid of any kind, and the place about which it lies."""
    row, col = np.mgrid[0:ROWS, 0:COLS]
    x, y = transform @ (col + 0.5, row + 0.5)
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)
    lon0, lat0 = float(lon[ROWS // 2, COLS // 2]), float(lat[ROWS // 2, COLS // 2])
    heights = (surface(lon, lat, lon0, lat0) * scale).astype(dtype)
    options = {}
    if hole:
        heights[20:30, 40:50] = -9999
        options["nodata"] = -9999
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=COLS, height=ROWS, count=1, dtype=dtype, crs=crs, transform=transform, **options
        ) as dataset:
            dataset.write(heights, 1)
            if unit:
                dataset.set_band_unit(1, unit)
        return bytes(memory.getbuffer()), lon0, lat0


CURVATURE = 4.0 / 190.0**2 + 4.0 / 230.0**2
"""Most of the surface [1/m]."""

SECOND = 1 / 3600


def inner(known):
    """Cells around which all cells are known."""
    return ndimage.binary_erosion(known, np.ones((3, 3)), iterations=2)


CASES = {  # CRS, transform, what else, the CRS that "auto" takes
    "degrees": ("EPSG:4326", Affine(SECOND, 0, -4.5, 0, -SECOND, 36.74), {}, "EPSG:32630"),
    "degrees, south": ("EPSG:4326", Affine(SECOND, 0, 147.3, 0, -SECOND, -42.86), {"hole": True}, "EPSG:32755"),
    "degrees, south-up": ("EPSG:4326", Affine(SECOND, 0, 8.5, 0, SECOND, 47.2), {}, "EPSG:32632"),
    "degrees, other datum": ("EPSG:4269", Affine(SECOND, 0, -93.2, 0, -SECOND, 44.95), {}, "EPSG:32615"),
    "feet": (
        "EPSG:2227",
        Affine(10, 0, 6_050_000, 0, -10, 2_110_000),
        {"unit": "ft", "scale": 1 / 0.3048},
        "EPSG:32610",
    ),
    "Web Mercator": ("EPSG:3857", Affine(5, 0, 1_000_000, 0, -5, 6_000_000), {}, "EPSG:32632"),
    "polar, north": ("EPSG:3413", Affine(10, 0, -300_000, 0, -10, -400_000), {"hole": True}, None),
    "polar, south": ("EPSG:3031", Affine(8, 0, 350_000, 0, -8, -1_200_000), {}, "EPSG:32758"),
    "rotated": (
        "EPSG:32630",
        Affine.translation(367_000, 4_064_000) * Affine.rotation(25) * Affine.scale(2, -2),
        {},
        "EPSG:32630",
    ),
    "not square": ("EPSG:32630", Affine(2, 0, 367_000, 0, -3, 4_064_000), {"hole": True}, "EPSG:32630"),
    "LAEA": ("EPSG:3035", Affine(10, 0, 2_700_000, 0, -10, 3_600_000), {}, None),
}


@pytest.mark.parametrize("name", CASES)
def test_heights_and_sizes_are_true(name):
    crs, transform, how, target = CASES[name]
    content, lon0, lat0 = made(crs, transform, **how)
    found = read_heightmap(content, filename="dem.tif", reproject="auto")
    frame = found.frame
    if target is not None:
        assert frame.crs == target
    row, col = np.mgrid[0 : frame.rows, 0 : frame.cols]
    x = frame.west_m + (col + 0.5) * frame.resolution_m
    y = frame.north_m - (row + 0.5) * frame.resolution_m
    lon, lat = Transformer.from_crs(frame.crs, "EPSG:4326", always_xy=True).transform(x, y)
    known = ~np.isnan(found.heights)
    wrong = np.abs(found.heights - surface(lon, lat, lon0, lat0))
    # bilinear: cell^2 / 8 of both second derivatives, and as much again because GDAL widens its kernel for wider cells
    assert wrong[inner(known)].max() < 0.3 * frame.resolution_m**2 * CURVATURE + 1e-3
    assert wrong[known].max() < 0.05 * frame.resolution_m  # the outer half cell continues the nearest height
    # true size: the area of all cells of the source by the geodesic, against the number of known cells
    corner = [transform @ place for place in ((0, 0), (COLS, 0), (COLS, ROWS), (0, ROWS))]
    geographic = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    edge = np.array([geographic.transform(*place) for place in corner])
    area = abs(Geod(ellps="WGS84").polygon_area_perimeter(edge[:, 0], edge[:, 1])[0])
    cells = ROWS * COLS - (100 if how.get("hole") else 0)
    assert known.sum() * frame.resolution_m**2 == pytest.approx(area * cells / (ROWS * COLS), rel=0.02)  # of pixels
    ends = (
        geographic.transform(*transform @ (COLS * 0.1, ROWS * 0.5)),
        geographic.transform(*transform @ (COLS * 0.9, ROWS * 0.4)),
    )
    true = Geod(ellps="WGS84").inv(*ends[0], *ends[1])[2]
    there = Transformer.from_crs("EPSG:4326", frame.crs, always_xy=True)
    (x0, y0), (x1, y1) = there.transform(*ends[0]), there.transform(*ends[1])
    assert math.hypot(x1 - x0, y1 - y0) == pytest.approx(true, rel=0.001)
    x, y = np.array([there.transform(*place) for place in edge]).T
    assert abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2 == pytest.approx(area, rel=0.001)
    assert found.notes[0].startswith("reprojected from")


@pytest.mark.parametrize("name", ["degrees", "degrees, south", "Web Mercator", "rotated", "polar, south"])
def test_gdals_own_warp_gives_the_same(name):
    crs, transform, how, _ = CASES[name]
    content, _, _ = made(crs, transform, **how)
    found = read_heightmap(content, filename="dem.tif", reproject="auto")
    frame = found.frame
    grid = Affine(frame.resolution_m, 0, frame.west_m, 0, -frame.resolution_m, frame.north_m)
    with rasterio.MemoryFile(content) as memory, memory.open() as dataset:
        theirs = np.full(frame.shape, np.nan, np.float32)
        warp.reproject(
            rasterio.band(dataset, 1),
            theirs,
            dst_transform=grid,
            dst_crs=frame.crs,
            dst_nodata=math.nan,
            resampling=warp.Resampling.bilinear,
            tolerance=0.0,
            XSCALE="1",
            YSCALE="1",
        )
    both = inner(~np.isnan(theirs) & ~np.isnan(found.heights))
    assert (np.isnan(theirs) ^ np.isnan(found.heights)).mean() < 0.005
    assert np.abs(theirs - found.heights)[both].max() < 0.01


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
