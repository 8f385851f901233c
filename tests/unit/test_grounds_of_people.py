"""Heightmaps in the kinds in which people have them: each kind drawn here, small, with a known answer."""

import gzip
import io
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.io import MemoryFile
from rasterio.transform import Affine

import joulemap as jm
from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.robot import Robot
from joulemap.model.terrain.formats import zipped
from joulemap.model.terrain.formats.colours import ENCODINGS
from joulemap.model.terrain.formats.pcd import lzf
from joulemap.model.terrain.plausible import heightmap_warnings
from joulemap.model.terrain.readers import open_ground, read_sent
from joulemap.service.library.heightmaps import read_heightmap
from tests.reference.heightmap_files import ASC, geotiff, npy, npz, png, points_file

ROW, COL = np.mgrid[0:40, 0:50]
HILL = (100.0 + 6.0 * np.exp(-((ROW - 20.0) ** 2 + (COL - 25.0) ** 2) / 90.0) + 0.02 * COL).astype(np.float32)
PLACE = Affine(1.0, 0.0, 500_000.0, 0.0, -1.0, 4_000_040.0)


def folder_of(tmp_path: Path, driver: str, name: str) -> Path:
    """A folder with the hill in a format of GDAL, and its side files."""
    (tmp_path / "made").mkdir()
    plain = tmp_path / "plain.tif"
    plain.write_bytes(geotiff(HILL, transform=PLACE))
    rasterio.shutil.copy(plain, tmp_path / "made" / name, driver=driver)
    return tmp_path / "made"


def zip_of(*files: tuple[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files:
            archive.writestr(name, content)
    return out.getvalue()


KINDS = [
    ("AAIGrid", "hill.asc", 1e-3),
    ("HFA", "hill.img", 0.0),
    ("netCDF", "hill.nc", 0.0),
    ("GSBG", "hill.grd", 0.0),
    ("GSAG", "hill_ascii.grd", 1e-3),
    ("GS7BG", "hill7.grd", 0.0),
    ("SAGA", "hill.sdat", 0.0),
    ("EHdr", "hill.bil", 0.0),
    ("ENVI", "hill.dat", 0.0),
    ("BT", "hill.bt", 0.0),
    ("RRASTER", "hill.grd", 0.0),
    ("RST", "hill.rst", 0.0),
]


@pytest.mark.parametrize(("driver", "name", "off_m"), KINDS, ids=[kind[0] for kind in KINDS])
def test_a_raster_is_read_beside_its_files_and_from_one_zip(
    tmp_path: Path, driver: str, name: str, off_m: float
) -> None:
    folder = folder_of(tmp_path, driver, name)
    packed = zip_of(*((f"data/{each.name}", each.read_bytes()) for each in sorted(folder.iterdir())))
    for source in (folder / name, packed):
        found = read_sent(source, alone=isinstance(source, bytes), filename=None if source is not packed else "a.zip")
        np.testing.assert_allclose(found.heights, HILL, atol=off_m)
        assert found.frame.bounds == (500_000.0, 4_000_000.0, 500_050.0, 4_000_040.0)
    assert open_ground(folder / name).data_hash == read_sent(folder / name, alone=False).data_hash


def test_one_file_in_a_gzip_or_a_zip_with_papers() -> None:
    papers = ("readme.txt", b"hello"), ("meta.xml", b"<a/>"), ("preview.png", png(np.ones((9, 9), np.uint8)))
    for packed, name in ((gzip.compress(ASC), "a.asc.gz"), (zip_of(("x/a.asc", ASC), *papers), "a.zip")):
        assert read_sent(packed, filename=name).frame.shape == (2, 3)
    with pytest.raises(HeightmapError, match=r"must hold one heightmap, and holds 2 \(it has a.asc, b.asc\)"):
        read_sent(zip_of(("a.asc", ASC), ("b.asc", ASC)))
    with pytest.raises(HeightmapError, match="no array `heights`"):
        read_sent(zip_of(("other.npy", npy(HILL))))


def test_what_unpacks_to_too_much_stays_packed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zipped, "MAX_UNPACKED_BYTES", 100_000)
    for bomb in (zip_of(("a.asc", bytes(200_000))), gzip.compress(bytes(200_000))):
        with pytest.raises(TooLargeError, match="unpacks to more than 100,000 bytes"):
            read_sent(bomb, filename="bomb")


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda each: each.name)
def test_colours_that_are_heights_are_read_and_said(encoding) -> None:
    counts = np.round((HILL.astype(float) - encoding.offset_m) / encoding.weights[2]).astype(int)
    tile = np.stack([counts // 65_536, counts // 256 % 256, counts % 256]).astype(np.uint8)
    for content in (png(tile), png(np.concatenate([tile, np.full((1, 40, 50), 255, np.uint8)]))):
        found = read_sent(content, resolution_m=2.0, filename="tile.png")
        np.testing.assert_allclose(found.heights, HILL, atol=encoding.weights[2])
        assert encoding.name in found.notes[0]
        moved = read_sent(content, resolution_m=2.0, crs="EPSG:32630", west_m=5e5, north_m=4e6, reproject="EPSG:25830")
        assert encoding.name in " ".join(moved.notes)
        np.testing.assert_allclose(np.nanmax(moved.heights), HILL.max(), atol=0.5)
    with pytest.raises(HeightmapError, match="leave `scale_m` out"):
        read_sent(png(tile), resolution_m=1.0, scale_m=0.1)


def test_pictures_are_no_heights() -> None:
    photo = np.random.default_rng(1).integers(0, 255, (3, 40, 50)).astype(np.uint8)
    grey = np.round((HILL - 100) * 20).astype(np.uint8)
    for picture in (png(photo), geotiff(photo, photometric="RGB"), geotiff(np.stack([grey, grey // 2, grey // 3]))):
        with pytest.raises(HeightmapError, match=r"in colours which are no heights|has 3 bands"):
            read_sent(picture, resolution_m=0.5)
    (note,) = read_sent(geotiff(grey)).notes
    assert "as a picture does" in note
    for content in (png(np.stack([grey] * 3)), png(grey)):
        with pytest.raises(HeightmapError, match="scale_m"):
            read_sent(content, resolution_m=1.0)
        np.testing.assert_allclose(
            read_sent(content, resolution_m=1.0, scale_m=0.05, offset_m=100).heights, HILL, atol=0.03
        )


@pytest.mark.parametrize("kind", ["P5", "P2"])
def test_a_pgm_is_read_as_the_png_of_the_same_picture(kind: str) -> None:
    """Row 0 of both is the north, as in Gazebo's heightmaps and the maps of Nav2, whose origin is the lower left."""
    grey = np.round((HILL + 0.05 * (40 - ROW) - 100) * 20).astype(np.uint8)
    text = grey.tobytes() if kind == "P5" else " ".join(map(str, grey.ravel())).encode()
    pgm = b"%s\n# a comment\n50 40\n255\n" % kind.encode() + text
    said = {"resolution_m": 0.5, "scale_m": 0.05, "offset_m": 100.0}
    wanted = read_sent(png(grey), **said)
    assert wanted.heights[0, 0] == pytest.approx(102.0, abs=0.03)  # 0.05 m a row higher in the north
    for _ in range(20):  # GDAL says no place of a PGM; memory that rasterio did not fill is none
        found = read_sent(pgm, filename="map.pgm", **said)
        np.testing.assert_array_equal(found.heights, wanted.heights)
        assert found.frame.bounds == (0.0, 0.0, 25.0, 20.0)
    with pytest.raises(HeightmapError, match="truncated or corrupt"):
        read_sent(pgm[:-300], filename="map.pgm", **said)


CLOUDS = ["pcd ascii", "pcd binary", "pcd binary_compressed", "ply ascii", "ply little", "ply big"]


@pytest.mark.parametrize("kind", CLOUDS)
def test_points_on_a_grid_are_its_cells(kind: str) -> None:
    x, y = 500_000.5 + COL.ravel(), 4_000_039.5 - ROW.ravel()
    whole = points_file(kind, x, y, HILL.ravel().astype(float))
    found = read_sent(whole, crs="EPSG:32630")
    np.testing.assert_allclose(found.heights, HILL, atol=1e-4)
    assert found.frame.bounds == (500_000.0, 4_000_000.0, 500_050.0, 4_000_040.0)
    for length in (30, 150, len(whole) // 2, len(whole) - 40):
        with pytest.raises(HeightmapError, match=r"truncated|corrupt|no point|no vertices"):
            read_sent(whole[:length], crs="EPSG:32630", filename="a.ply")


def test_lzf_copies_what_came_before_and_stops_at_its_end() -> None:
    """The letters a, b; then six bytes from two back: (6 - 2) << 5, and an offset of 2 - 1. What is longer than eight
    bytes has 7 there, and the rest of its length in the next byte.
    """
    packed = np.frombuffer(b"\x01ab" + bytes([4 << 5, 1]), np.uint8)
    assert bytes(lzf(packed, 8)[0]) == b"abababab"
    assert [lzf(packed, size)[1] for size in (8, 7)] == [8, 2]
    assert lzf(np.frombuffer(bytes([4 << 5, 1]), np.uint8), 8)[1] == 0
    assert bytes(lzf(np.frombuffer(bytes([0, 97, 7 << 5, 91, 0]), np.uint8), 101)[0]) == 101 * b"a"


def test_texts_of_points_as_people_write_them() -> None:
    lines = [(500_000.5 + c, 4_000_009.5 - r, 10 + 0.5 * r + 0.25 * c) for r in range(10) for c in range(10)]
    plain = "".join(f"{x:.2f} {y:.2f} {z:.2f}\n" for x, y, z in lines)
    texts = {
        "a.xyz": plain,
        "b.txt": "# made up\n//X,Y,Z\n" + plain.replace(" ", ","),
        "c.csv": "Easting;Northing;Height\n" + plain.replace(" ", ";").replace(".", ","),
        "d.asc": plain.replace(" ", "\t"),
        "e.xyz": plain.replace(".", ","),
    }
    for name, text in texts.items():
        found = read_sent(text.encode(), filename=name, crs="EPSG:32630")
        assert found.frame.bounds == (500_000.0, 4_000_000.0, 500_010.0, 4_000_010.0), name
        assert float(found.heights[9, 9]) == 16.75


def test_columns_of_points_are_found_by_their_names_and_tables_by_their_axes() -> None:
    x, y = 500_000.5 + COL, 4_000_039.5 - ROW
    lines = list(zip(x.ravel(), y.ravel(), HILL.ravel(), strict=True))
    texts = {
        "rtk.txt": "Name;Easting;Northing;Elevation;Code\n" + "".join(f"P;{a};{b};{z};GND\n" for a, b, z in lines),
        "yxz.csv": '"northing","easting","height [m]"\n' + "".join(f"{b},{a},{z}\n" for a, b, z in lines),
        "pivot.csv": "y\\x," + ",".join(map(str, x[0])) + "\n"
        + "".join(f"{y[k, 0]}," + ",".join(map(str, HILL[k])) + "\n" for k in range(40)),
    }  # fmt: skip
    heads = [
        "Rechtswert;Hochwert;Höhe_NHN",
        "X_UTM;Y_UTM;Z [m]",
        "Este;Norte;Cota",
        "est;nord;quota",
        "x;y;Altezza (m)",
    ]
    for k, head in enumerate(heads):
        rows = "".join(f"{a};{b};{z}\n" for a, b, z in lines[::-1])
        texts[f"{k}.csv"] = f"{head}\n{rows.replace('.', ',')}"
    contents = {name: text.encode() for name, text in texts.items()}
    contents["a.npz"] = npz(elevation=HILL[::-1], x=x[0], y=y[::-1, 0])
    contents["a.npy"] = npy(np.array(lines))
    for name, content in contents.items():
        found = read_sent(content, filename=name, crs="EPSG:32630")
        np.testing.assert_allclose(found.heights, HILL, atol=1e-4, err_msg=name)
        assert found.frame.bounds == (500_000.0, 4_000_000.0, 500_050.0, 4_000_040.0), name
    with pytest.raises(HeightmapError, match="line 4: 'P;1;x;3;GND' is no point"):
        read_sent(b"Name;E;N;Z;Code\nP;1;2;3;GND\nP;2;2;3;GND\nP;1;x;3;GND\n", filename="rtk.txt")
    with pytest.raises(HeightmapError, match=r"'Punkt;Links;Oben', .*z by z, h, height, elevation.* Rename"):
        read_sent(b"Punkt;Links;Oben\n1,5;2;3\n2,5;2;3\n", filename="dgm.csv")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.e57", b"ASTM-E57" + bytes(100), "save it as LAS or PLY"),
        ("a.bt", b"# Octomap OcTree binary file\nid OcTree\n", "save its ground as points"),
        ("a.obj", b"v 1 2 3\nv 1 2 4\n", "sample points of it"),
        ("a.raw", bytes(5000), "save it as .npy"),
    ],
)
def test_what_is_not_read_is_refused_with_the_way_to_a_map(name: str, content: bytes, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        read_sent(content, filename=name)


def test_rows_of_heights_are_no_points_and_archives_name_their_array() -> None:
    text = "\n".join(",".join(f"{value:.8f}" for value in row) for row in HILL).encode()
    found = read_sent(text, filename="heights.csv", resolution_m=1.0)
    np.testing.assert_allclose(found.heights, HILL, atol=1e-3)
    assert "rows of heights" in found.notes[0]
    np.testing.assert_array_equal(read_sent(npz(elevation=HILL, dx=0.5), resolution_m=1.0).heights, HILL)
    with pytest.raises(HeightmapError, match="it has elevation, z"):
        read_sent(npz(elevation=HILL, z=HILL), resolution_m=1.0)


def test_a_compound_crs_gives_its_plane_and_the_unit_of_its_heights() -> None:
    plain = read_sent(geotiff(HILL, crs="EPSG:25832+7837", transform=PLACE))
    assert (plain.frame.crs, plain.notes) == ("EPSG:25832", ())
    feet = read_sent(geotiff(HILL, crs="EPSG:26918+6360", transform=PLACE))
    assert feet.frame.crs == "EPSG:26918"
    np.testing.assert_allclose(feet.heights, HILL * 1200 / 3937, rtol=1e-6)
    assert "us survey foot" in feet.notes[0]


def test_variables_and_bands_are_found_by_their_names(tmp_path: Path) -> None:
    with rasterio.open(
        tmp_path / "two.tif", "w", driver="GTiff", width=50, height=40, count=2, dtype="float32", crs="EPSG:32630",
        transform=PLACE,
    ) as file:  # fmt: skip
        file.write(np.stack([0 * HILL, HILL]))
        file.set_band_description(1, "uncertainty")
        file.set_band_description(2, "elevation")
    np.testing.assert_array_equal(read_sent(tmp_path / "two.tif").heights, HILL)


def test_numbers_that_contradict_their_unit_are_said() -> None:
    def said(heights: np.ndarray, **options: object) -> str:
        return " ".join(heightmap_warnings(read_sent(geotiff(heights, **({"transform": PLACE} | options)))))

    assert said(HILL) == ""
    assert "Earth lies between" in said(HILL + 20_000)
    assert said(HILL - 95) == ""
    hollow = HILL.copy()
    hollow[5:9, 6:12] = 0
    assert "24 cells are exactly 0 m" in said(hollow)
    assert "24 cells" not in said(
        hollow - 90 * (hollow > 0), transform=PLACE @ Affine.scale(10)
    )  # a shore, 10 m beside
    degrees = Affine(1 / 120, 0, -4.5, 0, -1 / 120, 36.7)
    assert "are its coordinates degrees" in said(HILL * 10, crs=None, transform=degrees)
    with pytest.raises(HeightmapError, match="are they degrees"):
        said(HILL, crs=None, transform=degrees @ Affine.scale(0.1))
    with pytest.warns(UserWarning, match="exactly 0 m"):
        read_heightmap(geotiff(hollow, transform=PLACE))


MOON = "+proj=stere +lat_0=-90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"


def test_the_moon_has_maps_and_a_sixth_of_the_weight() -> None:
    moon = rasterio.crs.CRS.from_string(MOON)
    plane = geotiff(HILL, crs=moon, transform=Affine(1.0, 0.0, 1000.0, 0.0, -1.0, 2000.0))
    found = read_sent(plane)
    np.testing.assert_array_equal(found.heights, HILL)
    (said,) = heightmap_warnings(found)
    assert "`gravity_mps2` of the robot must be that of its body" in said
    assert read_sent(geotiff(HILL + 20_000, crs=moon, transform=PLACE)).heights.max() > 20_000  # Olympus Mons: 21 km
    degrees = geotiff(HILL, crs="IAU_2015:49900", transform=Affine(1e-4, 0, 77.0, 0, -1e-4, 18.5))
    with pytest.raises(HeightmapError, match="degrees"):
        read_sent(degrees)
    moved = read_sent(degrees, reproject="auto")
    assert moved.resolution_m == pytest.approx(
        1e-4 * 59_274 * np.sqrt(np.cos(np.radians(18.5))), rel=2e-3
    )  # R = 3396.19 km
    costs = []
    for gravity_mps2 in (1.62, 9.80665):
        robot = Robot(gravity_mps2=gravity_mps2, idle_power_w=0.0)
        costmap = jm.costmap(found, robot=robot, model="physics", spacing_m=2.0, headings=8)
        costs.append(np.nanmean(costmap.lattice.energy_per_m))
    assert costs[0] / costs[1] == pytest.approx(1.62 / 9.80665, rel=1e-5)
    assert Robot(gravity_mps2=1.62).weight_n == pytest.approx(Robot().weight_n * 1.62 / 9.80665)


VRT = """<VRTDataset rasterXSize="50" rasterYSize="40"><GeoTransform>500000, 1, 0, 4000040, 0, -1</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="1">{}</SourceFilename>
<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""


@pytest.mark.parametrize(
    "name",
    [
        "/vsicurl/http://127.0.0.1:9/a.tif",
        "http://127.0.0.1:9/a.tif",
        "&#47;vsimem/a",
        "nowhere.tif",
        "wms.xml",
        "self.vrt",
    ],
)
def test_a_vrt_names_files_of_this_machine_or_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "wms.xml").write_text("<GDAL_WMS><Service name='TMS'/></GDAL_WMS>")
    (tmp_path / "self.vrt").write_text(VRT.format(name))
    with pytest.raises(HeightmapError, match="VRT"):
        read_heightmap(tmp_path / "self.vrt")


def test_one_file_is_read_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was sent stands alone, whatever lies beside it, whatever it names, and whatever the environment says."""
    monkeypatch.setenv("GDAL_DISABLE_READDIR_ON_OPEN", "FALSE")
    monkeypatch.setenv("GDAL_PAM_ENABLED", "YES")
    (tmp_path / "plain.tif").write_bytes(geotiff(HILL, transform=PLACE))
    (tmp_path / "a.vrt").write_text(VRT.format("plain.tif"))
    np.testing.assert_array_equal(read_sent(tmp_path / "a.vrt", alone=False).heights, HILL)
    bare = zip_of(("a.vrt", (tmp_path / "a.vrt").read_bytes()))
    for source in (tmp_path / "a.vrt", (tmp_path / "a.vrt").read_bytes(), bare):
        with pytest.raises(HeightmapError, match="names other files"):
            read_sent(source)
    for head in (b"\x89HDF\r\n\x1a\n" + bytes(600), b'{"type": "STACTA"}', b"<GDAL_WMS></GDAL_WMS>"):
        with pytest.raises(HeightmapError):
            read_sent(head, filename="a.tif")
    envi = folder_of(tmp_path, "ENVI", "hill.dat")
    assert read_sent(envi / "hill.dat", alone=False).frame.shape == (40, 50)
    with pytest.raises(HeightmapError, match="header"):
        read_sent(envi / "hill.dat")
    rasterio.shutil.copy(tmp_path / "plain.tif", tmp_path / "spilt.img", driver="HFA", USE_SPILL="YES")
    np.testing.assert_array_equal(read_sent(tmp_path / "spilt.img", alone=False).heights, HILL)
    with pytest.raises(HeightmapError, match="truncated or corrupt"):
        read_sent(tmp_path / "spilt.img")
    for address in ("/vsicurl/http://127.0.0.1:9/a.tif", "http://127.0.0.1:9/a.tif", "/vsizip/a.zip"):
        with pytest.raises(HeightmapError, match=r"URL|no file"):
            read_heightmap(address)


def test_a_name_cannot_lead_gdal_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "b.tif").write_bytes(geotiff(HILL, transform=PLACE))
    content = (tmp_path / "b.tif").read_bytes()
    for name in (
        "../../etc/passwd",
        "/vsicurl/http://x/a.tif",
        "a/../../b.tif",
        "",
        "..",
        "\0",
        "x" * 5000,
        "é?#[1].tif",
    ):
        with MemoryFile(), warnings.catch_warnings():
            np.testing.assert_array_equal(read_sent(content, filename=name or None).heights, HILL)
            assert read_sent(tmp_path / "b.tif", filename=name or None).frame.shape == (40, 50)
