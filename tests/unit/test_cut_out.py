"""Windows of maps: the same cells as those of the whole map, and nothing else of the file is read."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine
from typer.testing import CliRunner

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.readers import open_ground
from joulemap.service.cli import app
from joulemap.service.library.heightmaps import read_heightmap

WEST, NORTH, SIDE = 366_000.0, 4_066_000.0, 2.0
ROWS, COLS = 600, 800


def heights_at(x, y):
    return 50.0 + 3.0 * np.sin((x - 366_000.0) / 90.0) + 4.0 * np.cos((y - 4_065_000.0) / 70.0)


@pytest.fixture(scope="module")
def utm(tmp_path_factory):
    row, col = np.mgrid[0:ROWS, 0:COLS]
    heights = heights_at(WEST + (col + 0.5) * SIDE, NORTH - (row + 0.5) * SIDE).astype(np.float32)
    place = tmp_path_factory.mktemp("maps") / "utm.tif"
    with rasterio.open(
        place,
        "w",
        driver="GTiff",
        width=COLS,
        height=ROWS,
        count=1,
        dtype="float32",
        crs="EPSG:32630",
        transform=Affine(SIDE, 0, WEST, 0, -SIDE, NORTH),
        tiled=True,
        blockxsize=128,
        blockysize=128,
        compress="deflate",
    ) as file:
        file.write(heights, 1)
    return place


@pytest.fixture(scope="module")
def degrees(tmp_path_factory):
    """A tenth of a degree around, in cells of about ten metres."""
    lon, lat = -4.55 + (np.arange(1000) + 0.5) * 1e-4, 36.77 - (np.arange(1000) + 0.5) * 1e-4
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32630", always_xy=True).transform(*np.meshgrid(lon, lat))
    place = tmp_path_factory.mktemp("maps") / "degrees.tif"
    options = {"driver": "GTiff", "width": 1000, "height": 1000, "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    with rasterio.open(place, "w", **options, transform=Affine(1e-4, 0, -4.55, 0, -1e-4, 36.77), tiled=True) as file:
        file.write(heights_at(x / 10, y / 10).astype(np.float32), 1)
    return place


WINDOW = (366_200.0, 4_065_400.0, 366_500.0, 4_065_700.0)


@pytest.mark.parametrize("how", ["path", "bytes", "ground", "text", "corners"])
def test_a_window_has_the_cells_of_the_whole_map(utm, how):
    whole = read_heightmap(utm)
    window = {"text": ",".join(map(str, WINDOW)), "corners": (WINDOW[2], WINDOW[1], WINDOW[0], WINDOW[3])}.get(
        how, WINDOW
    )
    if how == "ground":
        ground = open_ground(utm, window=window)
        found = ground.window(0, *ground.frame.shape[:1], 0, ground.frame.cols)
        assert ground.data_hash == read_heightmap(utm, window=window).data_hash
        assert "a window of the file was read" in ground.notes[0]
    else:
        found = read_heightmap(utm.read_bytes() if how == "bytes" else utm, filename="utm.tif", window=window)
        assert found.notes[0] == "a window of the file was read: x 366200.00..366500.00, y 4065400.00..4065700.00"
    assert found.frame.bounds == (366_200.0, 4_065_400.0, 366_500.0, 4_065_700.0)
    np.testing.assert_array_equal(found.heights, whole.heights[150:300, 100:250])


def test_corners_may_be_latitude_and_longitude(utm):
    (west, east), (south, north) = WINDOW[::2], WINDOW[1::2]
    lon, lat = Transformer.from_crs("EPSG:32630", "EPSG:4326", always_xy=True).transform([west, east], [south, north])
    found = read_heightmap(utm, window=(lat[0], lon[0], lat[1], lon[1]))
    assert found.frame.west_m == pytest.approx(west, abs=8 * SIDE)  # a box in degrees is a little turned
    assert found.frame.north_m == pytest.approx(north, abs=8 * SIDE)
    assert found.frame.west_m <= west
    assert found.frame.bounds[2] >= east


def test_nothing_but_the_window_is_read(utm, tmp_path):
    broken = tmp_path / "broken.tif"
    content = bytearray(utm.read_bytes())
    with rasterio.open(utm) as file:
        at, size = (int(file.get_tag_item(f"BLOCK_{what}_6_4", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    content[at : at + size] = bytes(size)
    broken.write_bytes(content)
    np.testing.assert_array_equal(
        read_heightmap(broken, window=WINDOW).heights, read_heightmap(utm, window=WINDOW).heights
    )
    with pytest.raises(HeightmapError, match="truncated or corrupt"):
        read_heightmap(broken)


def test_a_window_of_a_map_in_degrees_is_reprojected_alone(degrees):
    whole = read_heightmap(degrees, reproject="auto")
    part = read_heightmap(degrees, reproject="auto", window="36.71,-4.50,36.72,-4.49", resolution_m=whole.resolution_m)
    assert part.frame.crs == "EPSG:32630"
    assert 80 < part.frame.cols < 120
    assert part.heights.size < 0.02 * whole.heights.size
    row, col = np.mgrid[5 : part.frame.rows - 5, 5 : part.frame.cols - 5]
    x, y = part.frame.xy(row, col)
    known = ~np.isnan(part.heights[5:-5, 5:-5])
    wrong = np.abs(part.heights[5:-5, 5:-5] - heights_at(x / 10, y / 10))[known]
    assert known.mean() > 0.95
    assert wrong.max() < 0.02
    assert part.notes[0].startswith("a window of the file was reprojected from EPSG:4326 to EPSG:32630")


def test_what_is_no_window_is_refused_in_words(utm):
    with pytest.raises(HeightmapError, match=r"give two opposite corners, such as 366990"):
        read_heightmap(utm, window="here")
    with pytest.raises(HeightmapError, match=r"holds no 2 x 2 cells of the map, which spans x 366000\.\.367600, y"):
        read_heightmap(utm, window=(0.0, 0.0, 1.0, 1.0))
    with pytest.raises(TooLargeError, match=r"the window of utm\.tif declares 150 x 150"):
        read_heightmap(utm, window=WINDOW, max_cells=1_000)
    with pytest.raises(
        HeightmapError, match=r"is a URL: joulemap reads files.*curl -L -o dem\.tif 'https://a\.org/x\.tif'"
    ):
        read_heightmap("https://a.org/x.tif")
    with pytest.raises(HeightmapError, match="is a URL"):
        read_heightmap(Path("s3://bucket/x.tif"))


def test_commands_take_a_window(utm, tmp_path):
    out = tmp_path / "part.zarr"
    window = ",".join(map(str, WINDOW))
    command = ["costmap", str(utm), "--window", window, "--model", "physics", "--spacing", "10", "--out", str(out)]
    said = CliRunner().invoke(app, command)
    assert said.exit_code == 0, said.output
    assert "a window of the file was read" in " ".join(said.output.split())
    refused = CliRunner().invoke(app, [*command[:3], "1,2,3,4", *command[4:-1], str(tmp_path / "other.zarr")])
    assert refused.exit_code == 3
    assert "holds no 2 x 2 cells" in " ".join(refused.output.split())
