"""Heightmaps from files: what is read, and what is refused with which words."""

import io
import struct
import tracemalloc
import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from model.errors import HeightmapError, TooLargeError
from model.frames import GridFrame
from model.terrain.heightmap import Heightmap
from model.terrain.readers import read_heightmap
from model.terrain.writers import write_bands_geotiff, write_geotiff

HEIGHTS = np.add.outer(np.arange(40) * 0.1, np.arange(60) * 0.01).astype(np.float32)  # row 0 lowest
UTM = Affine(0.5, 0.0, 366_966.5, 0.0, -0.5, 4_064_491.5)


def geotiff(values: np.ndarray = HEIGHTS, *, mask: np.ndarray | None = None, **options: object) -> bytes:
    profile = {"crs": "EPSG:32630", "transform": UTM, "dtype": values.dtype.name} | options
    bands = values if values.ndim == 3 else values[None]
    scale, offset, unit = (profile.pop(key, None) for key in ("scale", "offset", "unit"))
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=bands.shape[2], height=bands.shape[1], count=bands.shape[0], **profile
        ) as dataset:
            dataset.write(bands)
            if mask is not None:
                dataset.write_mask(mask)
            if scale is not None:
                dataset.scales, dataset.offsets = (scale,), (offset,)
            if unit is not None:
                dataset.units = (unit,)
        return bytes(memory.read())


def png(counts: np.ndarray) -> bytes:
    bands = counts if counts.ndim == 3 else counts[None]
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore")
        with memory.open(
            driver="PNG", width=bands.shape[2], height=bands.shape[1], count=bands.shape[0], dtype=counts.dtype.name
        ) as dataset:
            dataset.write(bands)
        return bytes(memory.read())


def npy(values: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


def npz(**arrays: object) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def npy_header(shape: tuple[int, ...], dtype: str = "<f4") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": dtype, "fortran_order": False, "shape": shape})
    return out.getvalue()


def png_header(cols: int, rows: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    ihdr = struct.pack(">IIBBBBB", cols, rows, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", ihdr) + chunk(b"IDAT", zlib.compress(b"\0" * 9)) + chunk(b"IEND", b"")


ASC = b"ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value -1\n1 2 3\n4 -1 6.5\n"


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
    with pytest.raises(HeightmapError, match="2 bands"):
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
        ({"crs": "EPSG:4326", "transform": Affine(1e-5, 0.0, -4.5, 0.0, -1e-5, 36.7)}, r"degrees.*-t_srs EPSG:326"),
        ({"crs": "EPSG:2229"}, r"foot.*0\.3048"),
        ({"unit": "ft"}, "heights are in ft"),
    ],
)  # fmt: skip
def test_geotiffs_off_the_metre_grid_are_refused(options: dict, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        read_heightmap(geotiff(**options))


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
        with pytest.raises(HeightmapError, match="resolution_m"):
            read_heightmap(bare)
        heightmap = read_heightmap(bare, resolution_m=0.25, crs="EPSG:32630")
    assert heightmap.frame == GridFrame(0.0, 10.0, 0.25, 40, 60, "EPSG:32630")  # south-west corner at (0, 0)
    placed = read_heightmap(bare, resolution_m=0.25, west_m=5.0, north_m=7.0)
    assert (placed.frame.west_m, placed.frame.north_m, placed.frame.crs) == (5.0, 7.0, None)


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


ROUGH = np.random.default_rng(0).normal(100.0, 5.0, (300, 280)).astype(np.float32)


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
                driver="GTiff", width=128, height=128, count=1, dtype="float32", transform=UTM, sparse_ok=True,
                tiled=True, blockxsize=64, blockysize=64, **options,
            ) as dataset:  # fmt: skip
                dataset.write(ROUGH[:64, :64], 1, window=rasterio.windows.Window(64, 0, 64, 64))
            return bytes(memory.read())

    with pytest.raises(HeightmapError, match="3 of the GeoTIFF's 4 blocks"):
        read_heightmap(sparse())
    assert read_heightmap(sparse(nodata=-9999.0)).known_share == 0.25


def test_files_beside_the_geotiff_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "map.tif"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path.write_bytes(geotiff(crs=None, transform=Affine.identity()))
    (tmp_path / "map.tfw").write_text("3\n0\n0\n-3\n0\n0\n")
    (tmp_path / "map.tif.aux.xml").write_text(
        "<PAMDataset><GeoTransform>0,3,0,0,0,-3</GeoTransform></PAMDataset>", encoding="utf-8"
    )
    with pytest.raises(HeightmapError, match="resolution_m"):
        read_heightmap(path)


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
        ((b"cellsize 2", b"cellsize two"), "not a number"),
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


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_counts_become_metres(dtype: type) -> None:
    counts = (np.arange(48).reshape(6, 8) * 5).astype(dtype)
    heightmap = read_heightmap(png(counts), resolution_m=0.5, scale_m=0.02, offset_m=100.0)
    np.testing.assert_allclose(heightmap.heights, counts * 0.02 + 100.0, rtol=1e-6)
    assert heightmap.frame.bounds == (0.0, 0.0, 4.0, 3.0)


def test_png_needs_scale_and_resolution_and_one_channel() -> None:
    data = png(np.ones((6, 8), dtype=np.uint16))
    with pytest.raises(HeightmapError, match="scale_m"):
        read_heightmap(data, resolution_m=1.0)
    with pytest.raises(HeightmapError, match="resolution_m"):
        read_heightmap(data, scale_m=0.1)
    with pytest.raises(HeightmapError, match="scale_m must be"):
        read_heightmap(data, resolution_m=1.0, scale_m=-0.1)
    with pytest.raises(HeightmapError, match="colour"):
        read_heightmap(png(np.zeros((3, 6, 8), dtype=np.uint8)), resolution_m=1.0, scale_m=0.1)


def test_truncated_pngs_are_refused() -> None:
    whole = png((ROUGH * 100).astype(np.uint16))
    for length in (12, 30, 60, len(whole) // 2, len(whole) - 40):
        with pytest.raises(HeightmapError):
            read_heightmap(whole[:length], resolution_m=1.0, scale_m=0.01)


def huge_geotiff() -> bytes:
    """A GeoTIFF of 40,000 x 30,000 cells in which nothing was written: a few kilobytes."""
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=40_000, height=30_000, count=1, dtype="float32", transform=UTM, sparse_ok=True,
            tiled=True, blockxsize=4096, blockysize=4096, nodata=-1.0,
        ):  # fmt: skip
            pass
        return bytes(memory.read())


def huge_npz() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("heights.npy", npy_header((40_000, 30_000)) + b"\0" * 1_000_000)
    return out.getvalue()


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
