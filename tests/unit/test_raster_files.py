"""Heightmaps from GeoTIFF and PNG: what is read, and what is refused with which words."""

import re
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile
from rasterio.rio.main import main_group
from rasterio.transform import Affine

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.formats.gdal import ALONE, opened
from joulemap.model.terrain.formats.raster_checks import transform_of
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import read_sent
from joulemap.model.terrain.writers import write_bands_geotiff, write_geotiff
from joulemap.service.library.heightmaps import read_heightmap
from tests.reference.heightmap_files import HEIGHTS, ROUGH, UTM, geotiff, png


def test_the_real_hillside_reads_as_published(real_data: Path) -> None:
    """200 x 200 cells of 1 m, EPSG:32630, 34.0 to 65.7 m: the README of the recordings."""
    path = real_data / "cuadriga" / "uma_rescue_area_1m.tif"
    heightmap = read_heightmap(path)
    assert heightmap.frame.shape == (200, 200)
    assert (heightmap.resolution_m, heightmap.frame.crs) == (1.0, "EPSG:32630")
    assert heightmap.heights.min() == pytest.approx(34.0, abs=0.05)
    assert heightmap.heights.max() == pytest.approx(65.7, abs=0.05)
    assert read_heightmap(path.read_bytes()).data_hash == heightmap.data_hash


@pytest.mark.parametrize("path_or_bytes", ["path", "bytes"])
def test_geotiff_keeps_place_crs_and_heights(tmp_path: Path, path_or_bytes: str) -> None:
    path = tmp_path / "map.tif"
    path.write_bytes(geotiff())
    heightmap = read_heightmap(path if path_or_bytes == "path" else path.read_bytes(), filename="map.tif")
    np.testing.assert_array_equal(heightmap.heights, HEIGHTS)
    assert heightmap.frame == GridFrame(366_966.5, 4_064_491.5, 0.5, 40, 60, "EPSG:32630")
    assert heightmap.source == "map.tif"


def test_our_own_geotiff_round_trips(tmp_path: Path) -> None:
    heights = HEIGHTS.copy()
    heights[3:9, 5:7] = np.nan
    heightmap = Heightmap(heights, GridFrame(1000.25, 2000.75, 0.1, 40, 60, "EPSG:32615"))
    assert write_geotiff(tmp_path / "out.tif", heightmap) is None
    written = write_geotiff(None, heightmap)
    assert written is not None
    for source in (tmp_path / "out.tif", written):
        assert read_heightmap(source).data_hash == heightmap.data_hash
    assert [p.name for p in tmp_path.iterdir()] == ["out.tif"]


def test_bands_keep_their_descriptions_and_tags() -> None:
    frame = GridFrame(0.0, 40.0, 1.0, 40, 60)
    written = write_bands_geotiff(None, np.stack([HEIGHTS, -HEIGHTS]), frame, descriptions=["a", "b"], tags={"K": "v"})
    assert written is not None
    with MemoryFile(written) as memory, memory.open() as dataset:
        assert dataset.descriptions == ("a", "b")
        assert dataset.tags()["K"] == "v"
        assert np.isnan(dataset.nodata)
        np.testing.assert_array_equal(dataset.read(2), -HEIGHTS)
    np.testing.assert_array_equal(read_heightmap(written, band=2).heights, -HEIGHTS)
    with pytest.raises(HeightmapError, match="2 bands: give `band`"):
        read_heightmap(written)
    with pytest.raises(HeightmapError, match="1 to 2, not 3"):
        read_heightmap(written, band=3)
    with pytest.raises(HeightmapError, match="frame"):
        write_bands_geotiff(None, HEIGHTS[None, 1:], frame)
    with pytest.raises(HeightmapError, match="descriptions"):
        write_bands_geotiff(None, HEIGHTS[None], frame, descriptions=["a", "b"])


def test_geotiff_integers_scale_and_unknowns() -> None:
    counts = np.arange(12, dtype=np.int16).reshape(3, 4)
    mask = np.full((3, 4), 255, dtype=np.uint8)
    mask[1, 1] = 0
    expected = counts * 0.1 + 100.0
    read = read_heightmap(geotiff(counts, nodata=7, scale=0.1, offset=100.0)).heights
    expected[1, 3] = np.nan
    np.testing.assert_allclose(read, expected.astype(np.float32), rtol=1e-6)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        masked = geotiff(counts, mask=mask)
    expected = counts.astype(np.float32)
    expected[1, 1] = np.nan
    np.testing.assert_array_equal(read_heightmap(masked).heights, expected)


def test_south_up_geotiff_is_turned() -> None:
    south_up = geotiff(HEIGHTS[::-1].copy(), transform=Affine(0.5, 0.0, 366_966.5, 0.0, 0.5, 4_064_471.5))
    heightmap = read_heightmap(south_up)
    np.testing.assert_array_equal(heightmap.heights, HEIGHTS)
    assert heightmap.frame == read_heightmap(geotiff()).frame


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"transform": UTM @ Affine.rotation(3.0)}, "rotated"),
        ({"transform": Affine(0.5, 0.0, 0.0, 0.0, -0.6, 0.0)}, r"0\.5 x 0\.6 m"),
        ({"transform": Affine(-0.5, 0.0, 0.0, 0.0, -0.5, 0.0)}, "mirrored"),
        (
            {"crs": "EPSG:4326", "transform": Affine(1e-5, 0.0, -4.5, 0.0, -1e-5, 36.7)},
            r"degrees.*UTM zone 30N with `rio warp IN OUT --dst-crs EPSG:32630 ",
        ),
        ({"crs": "EPSG:3857", "transform": Affine(1.0, 0.0, -5e5, 0.0, -1.0, 4.4e6)}, r"by 24\.8 %.*EPSG:32630"),
        ({"crs": "EPSG:2229"}, r"foot.*0\.3048"),
        ({"unit": "degree"}, "they are no heights"),
    ],
)
def test_geotiffs_off_the_metre_grid_are_refused(options: dict, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(geotiff(**options))


def test_the_command_in_the_refusal_makes_a_map_that_is_read(tmp_path: Path) -> None:
    """Of a constant height: the corners that the turned grid adds are unknown, not ground at 0 m."""
    flat = np.full((40, 60), 100.0, dtype=np.float32)
    places = (
        {"crs": "EPSG:4326", "transform": Affine(1e-5, 0.0, -4.5, 0.0, -1e-5, 36.7)},
        {"crs": "EPSG:3857", "transform": Affine(1.0, 0.0, -5e5, 0.0, -1.0, 4.4e6), "nodata": -1.0},
        {"transform": UTM @ Affine.rotation(3.0)},
        {"transform": Affine(0.5, 0.0, 0.0, 0.0, -0.6, 0.0)},
    )
    for number, options in enumerate(places):
        stretched, repaired = tmp_path / f"{number}.tif", tmp_path / f"{number}_utm.tif"
        stretched.write_bytes(geotiff(flat, **options))
        with pytest.raises(HeightmapError) as caught:
            read_heightmap(stretched)
        command = re.search("`rio (.*?)`", caught.value.message)
        assert command is not None
        arguments = command.group(1).replace("IN OUT", f"{stretched} {repaired}").split()
        assert CliRunner().invoke(main_group, arguments).exit_code == 0
        heightmap = read_heightmap(repaired)
        assert np.nanmin(heightmap.heights) == np.nanmax(heightmap.heights) == 100.0
        assert heightmap.known_share > 0.8


@pytest.mark.filterwarnings("always")
def test_a_warning_of_another_thread_takes_no_place_from_a_raster(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "dem.tif").write_bytes(geotiff(HEIGHTS))
    read = rasterio.DatasetReader.read_transform

    def beside_others(self):
        warnings.warn("of another thread", DeprecationWarning, stacklevel=1)
        return read(self)

    expected = read_heightmap(tmp_path / "dem.tif").frame
    monkeypatch.setattr(rasterio.DatasetReader, "read_transform", beside_others)
    assert read_heightmap(tmp_path / "dem.tif").frame == expected
    assert (expected.west_m, expected.north_m) == (UTM.c, UTM.f)


def test_a_wkt_without_a_code_is_kept() -> None:
    wkt = 'LOCAL_CS["quarry",UNIT["metre",1]]'
    heightmap = read_heightmap(geotiff(crs=rasterio.crs.CRS.from_wkt(wkt)))
    assert heightmap.frame.crs is not None
    assert "quarry" in heightmap.frame.crs


def test_a_geotiff_without_a_place_needs_a_resolution_and_warns_nobody() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            bare = geotiff(crs=None, transform=Affine.identity())
        with pytest.raises(HeightmapError, match="`resolution_m`"):
            read_heightmap(bare)
        heightmap = read_heightmap(bare, resolution_m=0.25, crs="EPSG:32630")
    assert heightmap.frame == GridFrame(0.0, 10.0, 0.25, 40, 60, "EPSG:32630")  # south-west corner at (0, 0)
    placed = read_heightmap(bare, resolution_m=0.25, west_m=5.0, north_m=7.0)
    assert (placed.frame.west_m, placed.frame.north_m, placed.frame.crs) == (5.0, 7.0, None)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compress": "deflate"},
        {"compress": "lzw", "predictor": 3},
        {"tiled": True, "blockxsize": 64, "blockysize": 64},
        {"tiled": True, "blockxsize": 128, "blockysize": 64, "compress": "deflate"},
        {"compress": "zstd", "nodata": -9999.0},
        {"bigtiff": "yes"},
    ],
    ids=str,
)
def test_truncated_geotiffs_are_refused_wherever_they_end(tmp_path: Path, options: dict) -> None:
    whole = geotiff(ROUGH, **options)
    np.testing.assert_array_equal(read_heightmap(whole).heights, ROUGH)
    path = tmp_path / "cut.tif"
    for length in [4, 8, 60, 300, *(int(len(whole) * share) for share in (0.01, 0.2, 0.5, 0.9, 0.99)), len(whole) - 1]:
        with pytest.raises(HeightmapError):
            read_heightmap(whole[:length])
        path.write_bytes(whole[:length])
        with pytest.raises(HeightmapError):
            read_heightmap(path)


def test_corrupt_compressed_blocks_are_refused() -> None:
    whole = bytearray(geotiff(ROUGH, compress="deflate"))
    whole[len(whole) // 2 : len(whole) // 2 + 200] = b"\xa5" * 200
    with pytest.raises(HeightmapError, match="corrupt"):
        read_heightmap(bytes(whole))


def test_blocks_that_were_never_written_are_no_ground_at_zero() -> None:
    def sparse(**options: object) -> bytes:
        with MemoryFile() as memory:
            with memory.open(
                driver="GTiff",
                width=128,
                height=128,
                count=1,
                dtype="float32",
                transform=UTM,
                sparse_ok=True,
                tiled=True,
                blockxsize=64,
                blockysize=64,
                **options,
            ) as dataset:
                dataset.write(ROUGH[:64, :64], 1, window=rasterio.windows.Window(64, 0, 64, 64))
            return bytes(memory.read())

    with pytest.raises(HeightmapError, match="3 of the GeoTIFF's 4 blocks"):
        read_heightmap(sparse())
    assert read_heightmap(sparse(nodata=-9999.0)).known_share == 0.25


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("dm", 0.1), ("ft", 0.3048), ("US survey foot", 1200 / 3937)]
)
def test_heights_are_converted_from_the_unit_that_the_file_names(unit: str, metres: float) -> None:
    converted = read_sent(geotiff(unit=unit))
    np.testing.assert_allclose(converted.heights, HEIGHTS * metres, rtol=1e-6)
    assert bool(converted.notes) == (unit != "m")
    np.testing.assert_allclose(
        read_sent(geotiff(unit=unit), scale_m=2.0).heights, HEIGHTS * 2.0
    )  # the user knows better


def test_files_beside_a_geotiff_are_read_where_they_are_the_users_own(tmp_path: Path) -> None:
    path = tmp_path / "map.tif"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path.write_bytes(geotiff(crs=None, transform=Affine.identity()))
    (tmp_path / "map.tfw").write_text("3\n0\n0\n-3\n0\n0\n")
    (tmp_path / "map.tif.aux.xml").write_text(
        "<PAMDataset><GeoTransform>0,3,0,0,0,-3</GeoTransform></PAMDataset>", encoding="utf-8"
    )
    assert read_heightmap(path).resolution_m == 3.0
    for source in (path, path.read_bytes()):
        with pytest.raises(HeightmapError, match="resolution_m"):
            read_sent(source)


def test_a_picture_with_a_colour_table_is_no_heightmap() -> None:
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", width=4, height=4, count=1, dtype="uint8", transform=UTM) as dataset:
            dataset.write(np.ones((1, 4, 4), dtype=np.uint8))
            dataset.write_colormap(1, {1: (255, 0, 0, 255)})
            dataset.colorinterp = [ColorInterp.palette]
        with pytest.raises(HeightmapError, match="colour table"):
            read_heightmap(bytes(memory.read()))
    with pytest.raises(HeightmapError, match="complex64"):
        read_heightmap(geotiff(HEIGHTS.astype(np.complex64)))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_counts_become_metres(dtype: type) -> None:
    counts = (np.arange(48).reshape(6, 8) * 5).astype(dtype)
    heightmap = read_heightmap(png(counts), resolution_m=0.5, scale_m=0.02, offset_m=100.0)
    np.testing.assert_allclose(heightmap.heights, counts * 0.02 + 100.0, rtol=1e-6)
    assert heightmap.frame.bounds == (0.0, 0.0, 4.0, 3.0)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, ">u2"])
def test_many_counts_become_the_same_metres_as_few(dtype: type | str) -> None:
    most = np.iinfo(dtype).max
    counts = np.random.default_rng(3).integers(0, most, (300, 300), endpoint=True).astype(dtype)
    known = counts % 7 != 0
    scaling = Scaling(scale_m=0.1, offset_m=-3.0, nodata=5.0)
    many = scaling.to_metres(counts, band_scale=0.5, band_offset=2.0, known=known)
    few = [scaling.to_metres(r, band_scale=0.5, band_offset=2.0, known=k) for r, k in zip(counts, known, strict=True)]
    np.testing.assert_array_equal(many, np.stack(few))
    expected = np.where(known & (counts != 5), 0.1 * (0.5 * counts.astype(float) + 2.0) - 3.0, np.nan)
    np.testing.assert_allclose(many, expected, rtol=1e-6, atol=1e-6)


def test_a_count_too_high_is_refused_only_where_it_is() -> None:
    counts = np.full((300, 300), 100, np.uint8)
    scaling = Scaling(scale_m=1000.0)
    with pytest.raises(HeightmapError, match="a height of 100000 m"):
        scaling.to_metres(counts)
    np.testing.assert_array_equal(scaling.to_metres(np.full((300, 300), 2, np.uint8)), 2000.0)


def test_png_needs_scale_and_resolution_and_one_channel() -> None:
    data = png(np.ones((6, 8), dtype=np.uint16))
    with pytest.raises(HeightmapError, match="scale_m"):
        read_heightmap(data, resolution_m=1.0)
    with pytest.raises(HeightmapError, match="resolution_m"):
        read_heightmap(data, scale_m=0.1)
    with pytest.raises(HeightmapError, match="`scale_m` must be"):
        read_heightmap(data, resolution_m=1.0, scale_m=-0.1)
    with pytest.raises(HeightmapError, match="in colours which are no heights"):
        read_heightmap(png(np.arange(144, dtype=np.uint8).reshape(3, 6, 8)), resolution_m=1.0, scale_m=0.1)


def test_truncated_pngs_are_refused() -> None:
    whole = png((ROUGH * 100).astype(np.uint16))
    for length in (12, 30, 60, len(whole) // 2, len(whole) - 40):
        with pytest.raises(HeightmapError):
            read_heightmap(whole[:length], resolution_m=1.0, scale_m=0.01)


def test_reading_a_raster_leaves_the_warnings_of_other_threads_alone() -> None:
    before = warnings.filters
    sent = geotiff()
    with opened(SourceFile(sent, "map.tif", sent[:64]), ALONE, what="a map"):
        assert warnings.filters is before

    class Placed:
        """A raster with a place, while another thread opens one without."""

        def read_transform(self) -> tuple[float, ...]:
            said = NotGeoreferencedWarning("Dataset has no geotransform")
            other = threading.Thread(target=warnings.warn, args=(said,))
            other.start()
            other.join()
            return UTM.to_gdal()

    assert transform_of(Placed()) == UTM
    assert warnings.filters is before
