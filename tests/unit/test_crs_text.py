"""A text never opens a file of this machine, whoever reads it: grids of PROJ are refused; standard texts are read."""

from __future__ import annotations

import ast
import ctypes
import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.crs
from pyproj import CRS

import joulemap as jm
from joulemap.model.errors import HeightmapError, JoulemapError
from joulemap.model.runs.fixes import projected
from joulemap.model.terrain.coordinate_systems import crs_name, geographic
from joulemap.model.terrain.crs_text import known_crs
from joulemap.model.terrain.units import height_unit
from joulemap.service.places.coordinates import to_wgs84

ROOT = Path(jm.__file__).resolve().parents[1]
_OPENED = 0x20  # IN_OPEN of inotify(7)
_GEOG = (
    'GEOGCS["x",DATUM["y",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433]'
)
_PLANE = (
    'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",-3],'
    'PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]'
)


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[tuple[Path, Callable[[], bool]]]:
    """A file, and a function that says whether anything has opened it since it was asked last."""
    secret = tmp_path / "secret"
    secret.write_bytes(b"x" * 2000)
    libc = ctypes.CDLL(None)
    handle = libc.inotify_init1(os.O_NONBLOCK)
    libc.inotify_add_watch(handle, os.fsencode(secret), _OPENED)

    def opened() -> bool:
        try:
            return bool(os.read(handle, 65536))
        except BlockingIOError:
            return False

    secret.read_bytes()
    assert opened(), "the watch itself does not work"
    yield secret, opened
    os.close(handle)


def _texts(path: Path) -> dict[str, str]:
    grids = f"+proj=utm +zone=30 +ellps=WGS84 +nadgrids={path} +units=m +no_defs"
    bound = CRS.from_string(f"{grids} +type=crs")
    hidden = json.dumps(bound.to_json_dict()).replace(str(path), str(path).replace("s", "\\u0073"))
    steps = f"+proj=pipeline +step +proj=utm +zone=30 +step +proj=hgridshift +grids={path}"
    extension = f'EXTENSION["PROJ4","{grids}"]'
    method = (
        f'PROJCRS["a",BASEGEOGCRS["x",DATUM["y",ELLIPSOID["WGS 84",6378137,298.257223563]]],'
        f'CONVERSION["c",METHOD["PROJ hgridshift grids={path}"]],CS[Cartesian,2],AXIS["e",east],AXIS["n",north],'
        'LENGTHUNIT["metre",1]]'
    )
    return {
        "PROJ4 of a plane": f'PROJCS["a",{_GEOG}],{_PLANE},{extension}]',
        "PROJ4 of degrees": f'PROJCS["a",{_GEOG},EXTENSION["PROJ4","+proj=longlat +nadgrids={path}"]],{_PLANE}]',
        "small letters": f'PROJCS["a",{_GEOG}],{_PLANE},{extension.lower()}]',
        "WKT 2": bound.to_wkt(),
        "WKT 1": str(bound.to_wkt("WKT1_GDAL")),
        "PROJJSON": bound.to_json(),
        "PROJJSON, hidden": hidden,
        "PROJ": grids,
        "pipeline": steps,
        "method": method,
    }


USES: dict[str, Callable[[str], Any]] = {
    "heightmap": lambda crs: jm.heightmap(np.zeros((4, 4)), resolution_m=1.0, crs=crs),
    "name": crs_name,
    "degrees of its body": geographic,
    "unit": lambda crs: height_unit(None, crs, "a map"),
    "log": lambda crs: projected(np.array([36.7]), np.array([-4.5]), crs),
    "places": lambda crs: to_wgs84(crs, [(500_000.0, 4_000_000.0)]),
}


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("kind", list(_texts(Path("/x"))))
def test_no_text_opens_a_file(watched: tuple[Path, Callable[[], bool]], kind: str, use: str) -> None:
    secret, opened = watched
    text = _texts(secret)[kind]
    with pytest.raises(JoulemapError, match=r"names a file|not known"):
        USES[use](text)
    assert not opened()


def _zipped(tmp_path: Path, wkt: str) -> bytes:
    sent = io.BytesIO()
    with zipfile.ZipFile(sent, "w") as zipped:
        zipped.writestr("hill.asc", "ncols 4\nnrows 4\nxllcorner 0\nyllcorner 0\ncellsize 1\n" + "1 2 3 4\n" * 4)
        zipped.writestr("hill.prj", wkt)
    return sent.getvalue()


def _geotiff(tmp_path: Path, wkt: str, **how: str) -> bytes:
    path, place = tmp_path / "hill.tif", rasterio.Affine(1.0, 0.0, 5e5, 0.0, -1.0, 4e6)
    shape = {"width": 4, "height": 4, "count": 1, "dtype": "float32"}
    crs = rasterio.crs.CRS.from_string(wkt)
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=place, **shape, **how) as made:
        made.write(np.ones((1, 4, 4), np.float32))
    return path.read_bytes()


SENT: dict[str, Callable[[Path, str], bytes]] = {
    "zip with *.prj": _zipped,
    "GeoTIFF": _geotiff,
    "GeoTIFF of Esri's": lambda tmp_path, wkt: _geotiff(tmp_path, wkt, GEOTIFF_KEYS_FLAVOR="ESRI_PE"),
}


@pytest.mark.parametrize("sent", SENT)
def test_no_sent_map_opens_a_file(watched: tuple[Path, Callable[[], bool]], tmp_path: Path, sent: str) -> None:
    secret, opened = watched
    content = SENT[sent](tmp_path, _texts(secret)["WKT 1"])
    opened()  # GDAL may do so as it writes
    with pytest.raises(HeightmapError, match="names a file"):
        jm.read_heightmap(content)
    assert not opened()


@pytest.mark.parametrize(
    "text",
    [
        "EPSG:32630",
        "epsg:3857",
        "ESRI:102003",
        "IAU_2015:30100",
        "OGC:CRS84",
        "urn:ogc:def:crs:EPSG::32630",
        rasterio.crs.CRS.from_epsg(3857).to_wkt(),  # its extension says nadgrids=@null
        rasterio.crs.CRS.from_epsg(32630).to_wkt(),
        CRS.from_epsg(32630).to_wkt(),
        CRS.from_epsg(4267).to_wkt("WKT1_GDAL"),
        CRS.from_epsg(32630).to_json(),
        "+proj=utm +zone=30 +datum=WGS84 +units=m +no_defs",
        'LOCAL_CS["here",UNIT["metre",1]]',
    ],
)
def test_standard_texts_are_read(text: str) -> None:
    assert known_crs(text).to_wkt()


def test_geoids_of_las_files_are_not_needed() -> None:
    """As USGS writes it: the vertical datum names grids, and heights stay where they are."""
    plane = str(CRS.from_epsg(26913).to_wkt("WKT1_GDAL"))
    height = (
        'VERT_CS["NAVD88 height",VERT_DATUM["North American Vertical Datum 1988",2005,'
        'EXTENSION["PROJ4_GRIDS","g2012a_conus.gtx,g2012a_alaska.gtx"]],UNIT["metre",1],AXIS["Up",UP]]'
    )
    assert height_unit(None, f'COMPD_CS["both",{plane},{height}]', "a cloud").said


MAKERS = {
    "from_user_input", "from_string", "from_wkt", "from_epsg", "from_proj4", "from_authority", "from_cf", "from_crs",
    "from_pipeline", "from_json_dict", "parse_crs", "Proj",
}  # fmt: skip
ALLOWED = {
    "model/terrain/crs_text.py",
    "model/terrain/formats/las.py",  # laspy reads the text; `proj_crs` judges it
}


def test_one_module_makes_crs() -> None:
    found = set()
    for path in (one for room in ("model", "planner", "service") for one in (ROOT / room).rglob("*.py")):
        if str(path.relative_to(ROOT)) in ALLOWED:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            judged = node.args and "proj_crs(" in ast.unparse(node.args[0])
            if name in MAKERS and not judged:
                found.add(f"{path.relative_to(ROOT)}:{node.lineno} {name}")
    assert not found
