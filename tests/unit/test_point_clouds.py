"""Point clouds and XYZ texts as heightmaps: means of cells by hand, holes kept, broken files refused."""

import io

import laspy
import numpy as np
import pytest
from pyproj import CRS

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.service.library.heightmaps import read_heightmap
from tests.fuzz.inputs import changed


def cloud(x, y, z, classes=None, *, laz=False, crs="EPSG:32630"):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [x.min(), y.min(), 0.0], [0.001] * 3
    if crs:
        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = x, y, z
    las.classification = np.full(x.size, 2) if classes is None else classes
    out = io.BytesIO()
    las.write(out, do_compress=laz)
    return out.getvalue()


@pytest.fixture(scope="module")
def points():
    rng = np.random.default_rng(3)
    x, y = 367_000 + 40 * rng.random(20_000), 4_064_000 + 30 * rng.random(20_000)
    keep = ~((x > 367_010) & (x < 367_014) & (y > 4_064_010) & (y < 4_064_015))  # a pond
    x, y = x[keep], y[keep]
    return x, y, 50 + 0.1 * (x - 367_000) + 0.05 * (y - 4_064_000)


@pytest.mark.parametrize("laz", [False, True])
def test_ground_points_make_the_map_and_holes_are_kept(points, laz):
    x, y, z = points
    trees = np.arange(x.size) % 5 == 0
    content = cloud(x, y, np.where(trees, z + 8, z), np.where(trees, 5, 2), laz=laz)
    found = read_heightmap(content, filename="site.laz", resolution_m=1.0)
    assert found.frame.crs == "EPSG:32630"
    assert found.frame.shape == (30, 40)
    row, col = np.mgrid[0:30, 0:40]
    true = 50 + 0.1 * (col + 0.5) + 0.05 * (30 - row - 0.5)
    wrong = np.abs(found.heights - true)
    assert np.nanmax(wrong) < 0.06  # half a cell of slope
    assert np.isnan(found.heights[15:20, 10:14]).all()
    assert np.isnan(found.heights).sum() == 20
    own = read_heightmap(content, filename="site.las")  # nine points a cell
    assert own.resolution_m == pytest.approx(0.74, abs=0.02)


def test_a_cloud_in_degrees_is_reprojected():
    rng = np.random.default_rng(4)
    x, y = -4.5 + 0.001 * rng.random(20_000), 36.7 + 0.001 * rng.random(20_000)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [-4.5, 36.7, 0.0], [1e-8, 1e-8, 1e-3]
    header.add_crs(CRS.from_epsg(4326))
    las = laspy.LasData(header)
    las.x, las.y, las.z = x, y, np.full(x.size, 7.0)
    las.classification = np.full(x.size, 2)
    out = io.BytesIO()
    las.write(out)
    with pytest.raises(HeightmapError, match="degrees"):
        read_heightmap(out.getvalue(), filename="a.las")
    found = read_heightmap(out.getvalue(), filename="a.las", reproject="auto")
    assert found.frame.crs == "EPSG:32630"
    assert np.nanmax(np.abs(found.heights - 7.0)) < 1e-3


def test_xyz_of_a_grid_is_that_grid_and_others_are_averaged(points):
    row, col = np.mgrid[0:12, 0:9]
    lines = [
        f"{500_000 + 2 * c} {4_000_000 - 2 * r} {r + 0.5 * c}" for r, c in zip(row.ravel(), col.ravel(), strict=True)
    ]
    del lines[40]
    found = read_heightmap("\n".join(lines).encode(), filename="a.xyz", crs="EPSG:32630")
    assert found.frame.shape == (12, 9)
    assert (found.frame.west_m, found.frame.north_m, found.resolution_m) == (499_999.0, 4_000_001.0, 2.0)
    expected = (row + 0.5 * col).astype(float)
    expected.ravel()[40] = np.nan
    np.testing.assert_array_equal(found.heights, expected)
    x, y, z = points
    text = "x;y;z\r\n" + "".join(f"{a:.3f};{b:.3f};{c:.4f}\r\n" for a, b, c in zip(x, y, z, strict=True))
    scattered = read_heightmap(text.encode(), filename="b.xyz", resolution_m=1.0)
    las = read_heightmap(cloud(np.round(x, 3), np.round(y, 3), z), filename="b.las", resolution_m=1.0)
    np.testing.assert_allclose(scattered.heights, las.heights, atol=2e-3)


@pytest.mark.parametrize("places", [1, 2, 3, 4])
def test_the_cell_of_scattered_points_is_not_what_they_are_rounded_to(points, places):
    x, y, z = (np.round(values, places) for values in points)
    lines = (f"{a:.{places}f} {b:.{places}f} {c:.4f}\n" for a, b, c in zip(x, y, z, strict=True))
    found = read_heightmap("".join(lines).encode(), filename="b.xyz", crs="EPSG:32630")
    assert found.resolution_m == pytest.approx(0.73, abs=0.02)


def test_points_of_a_grid_along_a_road_are_its_cells():
    along = np.arange(3000)
    x, y = np.repeat(along, 3), (np.repeat(along // 3, 3) + np.tile([0, 1, 2], along.size)).astype(float)
    lines = (f"{a} {b} {0.01 * a}\n" for a, b in zip(x, y, strict=True))
    found = read_heightmap("".join(lines).encode(), filename="b.xyz", crs="EPSG:32630")
    assert (found.resolution_m, found.frame.shape) == (1.0, (1002, 3000))


@pytest.mark.parametrize("kind", ["las", "laz", "xyz"])
def test_broken_clouds_are_read_or_refused_in_words(kind, points):
    x, y, z = (values[:3000] for values in points)
    if kind == "xyz":
        good = "\n".join(f"{a:.3f} {b:.3f} {c:.4f}" for a, b, c in zip(x, y, z, strict=True)).encode()
    else:
        good = cloud(x, y, z, laz=kind == "laz")
    rng = np.random.default_rng(8)
    inputs = [good[: int(len(good) * (k + 0.5) / 15)] for k in range(15)]
    inputs += [changed(rng, good, text=kind == "xyz") for _ in range(35)]
    said = []
    for content in inputs:
        try:
            read_heightmap(content, filename=f"a.{kind}", resolution_m=1.0, max_cells=2_000_000)
        except (HeightmapError, TooLargeError) as error:
            said.append(error.message)
    assert len(said) > 5
    assert kind == "xyz" or any("points" in words for words in said)


def test_too_many_cells_are_refused_before_memory_is_taken(points):
    with pytest.raises(TooLargeError, match=r"in cells of 0\.001 m"):
        read_heightmap(cloud(*points), filename="a.las", resolution_m=0.001)
    with pytest.raises(HeightmapError, match="line 2: 'b c' is no point of 3 numbers"):
        read_heightmap(b"1 2 3\nb c\n4 5 6\n7 8 9\n", filename="a.xyz")


@pytest.mark.parametrize("far", ["1e308", "-1e308", "3e9"])
def test_points_beyond_all_coordinates_are_refused_with_their_place(far):
    lines = [b"0 0 1", b"1 0.3 2", b"0.2 1 3", b"7.1 3.3 1", f"{far} 4 2".encode()]
    with pytest.raises(HeightmapError, match="coordinates must be"):
        read_heightmap(b"\n".join(lines), filename="points.xyz")


def test_points_of_a_grid_that_no_number_counts_are_refused():
    """The distance of the last one, in the smallest step between others, is larger than any number."""
    lines = [b"0 0 1", b"2e-6 2e-6 2", b"0 2e-6 1", b"1e308 0 2"]
    with pytest.raises(HeightmapError, match="coordinates must be"):
        read_heightmap(b"\n".join(lines), filename="points.xyz")
