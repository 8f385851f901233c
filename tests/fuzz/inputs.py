"""Inputs generated for each reader: small valid files of all kinds, changed where it hurts."""

from __future__ import annotations

import gzip
import io
import json
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rasterio.shutil
from rasterio.transform import Affine

from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.reader import parse_run, read_run
from joulemap.model.runs.rolling import cut_travel
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.library.heightmaps import read_heightmap
from tests.fuzz import paths, recordings
from tests.fuzz.files import LOG, Rng, parquet
from tests.reference.heightmap_files import ASC, geotiff, npy, npz, png, points_file

_LIMITS = recordings.LIMITS
_WORDS = [
    b"nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"-9999",
    b"",
    b"\0",
    "é".encode(),
    b"9" * 500,
    b"\r",
    b'"',
    b",",
    b"1e-320",
]
_NUMBERS = [0, 1, 2, 7, 127, 128, 255, 65_535, 2**31 - 1, 2**31, 2**32 - 1]
_FOLDER = Path(tempfile.gettempdir())


def changed(rng: Rng, content: bytes, *, text: bool) -> bytes:
    """The content with a few changes: of bits, of fields of 2 or 4 bytes, of words, and of parts."""
    data = bytearray(content)
    for _ in range(1 if rng.random() < 0.5 else int(rng.integers(2, 5))):
        if not data:
            break
        reach = min(len(data), 400) if rng.random() < 0.6 else len(data)
        at, how = int(rng.integers(reach)), int(rng.integers(8))
        if how == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif how == 1:
            data[at] = int(rng.integers(256))
        elif how == 2 and not text:
            kind = str(rng.choice(["<H", ">H", "<I", ">I"]))
            number = int(rng.choice(_NUMBERS)) % (65_536 if kind[1] == "H" else 2**32)
            field = struct.pack(kind, number)
            data[at : at + len(field)] = field
        elif how in (2, 3):
            word = _WORDS[int(rng.integers(len(_WORDS)))]
            data[at : at + int(rng.integers(0, 8))] = word
        elif how == 4:
            del data[at : at + int(rng.integers(1, 60))]
        elif how == 5:
            part = data[at : at + int(rng.integers(1, 200))]
            data[at:at] = part * int(rng.integers(1, 5))
        elif how == 6 and rng.random() < 0.3:
            del data[at:]
        elif how == 7:
            end = min(len(data), at + int(rng.integers(1, 40)))
            data[at:end] = rng.bytes(end - at)
    return bytes(data)


@cache
def geotiffs() -> list[bytes]:
    rng = np.random.default_rng(1)
    found = []
    for dtype in ("uint8", "int16", "uint16", "int32", "float32", "float64", "int8"):
        for options in (
            {},
            {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate"},
            {"compress": "lzw", "predictor": 2 if dtype[0] != "f" else 3},
            {"compress": "zstd", "nodata": 3},
            {"crs": None, "transform": Affine(1, 0, 5, 0, 1, 5)},
            {"BIGTIFF": "YES", "crs": "EPSG:32733"},
            {"scale": 0.1, "offset": 5.0},
        ):
            found.append(geotiff((rng.random((20, 17)) * 100).astype(dtype), **options))
    found.append(geotiff((rng.random((3, 9, 9)) * 9).astype(np.float32)))
    return found


@cache
def arrays() -> list[bytes]:
    values = np.random.default_rng(2).random((9, 7)) * 100
    kinds = ("float32", "float64", "float16", "int16", ">f8", "uint8", "int64")
    return [npy(values.astype(kind)) for kind in kinds] + [npy(np.asfortranarray(values)), npy(values[0])]


@cache
def archives() -> list[bytes]:
    values = np.random.default_rng(3).random((9, 7)).astype(np.float32)
    return [
        npz(heights=values),
        npz(heights=values, resolution_m=0.5, west_m=3.0, north_m=9.0, crs="EPSG:32630"),
        npz(heights=values, resolution_m=np.nan, crs=b"x"),
        npz(other=values),
    ]


@cache
def pictures() -> list[bytes]:
    rng = np.random.default_rng(4)
    return [png(rng.integers(0, 200, (15, 12)).astype(kind)) for kind in (np.uint8, np.uint16)]


@cache
def tiles() -> list[bytes]:
    heights = 200 + 30 * np.sin(np.mgrid[0:15, 0:12].sum(axis=0) / 5)
    counts = [np.round((heights + 10_000) * 10).astype(int), np.round((heights + 32_768) * 256).astype(int)]
    return [png(np.stack([one // 65_536, one // 256 % 256, one % 256]).astype(np.uint8)) for one in counts]


@cache
def rasters() -> list[bytes]:
    found = []
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain.tif"
        plain.write_bytes(geotiff((np.random.default_rng(5).random((20, 17)) * 100).astype(np.float32)))
        for driver in ("HFA", "netCDF", "GSBG", "GS7BG", "GSAG"):
            rasterio.shutil.copy(plain, Path(folder) / "made", driver=driver)
            found.append((Path(folder) / "made").read_bytes())
    return found


@cache
def clouds_of_scanners() -> list[bytes]:
    x, y = (each.ravel().astype(float) for each in np.mgrid[0:9, 0:7])
    kinds = ("pcd ascii", "pcd binary", "pcd binary_compressed", "ply ascii", "ply little", "ply big")
    return [points_file(kind, x, y, x + y) for kind in kinds]


@cache
def packed() -> list[bytes]:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:  # stored, so that changes reach the file in it
        archive.writestr("a.asc", ASC)
        archive.writestr("a.prj", 'LOCAL_CS["quarry",UNIT["metre",1]]')
    return [out.getvalue(), gzip.compress(ASC)]


@cache
def logs() -> list[bytes]:
    rows = [line.split(",") for line in LOG.decode().splitlines()[1:120]]
    noted = "\n".join(['t,x,y,voltage,current,"note, of"', *(",".join([*row, '"a, b"']) for row in rows)])
    motors = "\n".join(["t,x,y,left_current,right_current,gps_error", *(",".join([*row, "0.01"]) for row in rows)])
    return [LOG, noted.encode(), motors.encode(), LOG.replace(b"\n", b"\r\n"), b"\xef\xbb\xbf" + LOG]


@cache
def wheel_logs() -> list[bytes]:
    rows = "".join(f"{0.1 * k:.1f},{0.5 + 0.1 * np.sin(k / 9):.3f},0.5,2.0,24\n" for k in range(200))
    return [f"t,speed_left,speed_right,current,voltage\n{rows}".encode(), f"time,velL,velR,curL,curR\n{rows}".encode()]


@cache
def parquet_logs() -> list[bytes]:
    t = np.arange(150) * 0.1
    base: dict[str, Any] = {"t": t, "x": 0.5 * t, "y": 0.0 * t, "current": 2.0 + 0.0 * t}
    more: list[Any] = [
        np.arange(150, dtype=np.int8),
        ["a", "b", None] * 50,
        pa.array(["grass", "mud"] * 75).dictionary_encode(),
        pa.array((t * 1e9).astype(np.int64)).cast(pa.timestamp("ns", "UTC")),
        pa.array([None] * 150, pa.float32()),
        pa.array([1] * 150, pa.decimal128(9, 2)),
        pa.array([0] * 150, pa.date32()),
        pa.array([True, None, False] * 50),
    ]
    found = [parquet(base | {"more": column}) for column in more]
    found += [parquet(base, compression=kind) for kind in ("none", "gzip", "zstd", "brotli")]
    return [*found, parquet(base, data_page_version="2.0", use_dictionary=False, row_group_size=20)]


@cache
def json_logs() -> list[bytes]:
    header, *rows = [line.split(",") for line in LOG.decode().splitlines()[:120]]
    records = [
        {"a": dict(zip(header[:2], map(float, row[:2]), strict=True))} | dict(zip(header, row, strict=True))
        for row in rows
    ]
    columns = {key: [float(row[k]) for row in rows] for k, key in enumerate(header)}
    whole = [records, {"log": {"points": records}}, columns, [header, *rows]]
    return ["\n".join(map(json.dumps, records)).encode(), *(json.dumps(each).encode() for each in whole)]


@cache
def yaml_logs() -> list[bytes]:
    """Messages as `ros2 topic echo` prints them, in YAML and as rows without a header, and one list of records."""
    stamps = [f"header:\n  stamp:\n    sec: {k // 10}\n    nanosec: {k % 10}00000000\n" for k in range(120)]
    place = [f"pose:\n  position: {{x: {0.1 * k:.1f}, y: 0}}\n  cov:\n  - 0.0\n  - .nan\n---\n" for k in range(120)]
    meter = "voltage: 24.5\ncurrent: -2.0\npresent: true\nlocation: ''\ncells: [3.6, 3.7]\n---\n"
    records = "".join(f"- t: {k}\n  speed_mps: 0.5\n  power_w: 40\n" for k in range(120))
    rows = "".join(f"{k},0,map,{k},0,0,0,0,0,1\n" for k in range(120))
    return [
        "".join(head + each for head in stamps for each in (meter,)).encode(),
        "".join(head + where + head + meter for head, where in zip(stamps, place, strict=True)).encode(),
        f"robot: r\nsamples:\n{records}".encode(),
        rows.encode(),
        "".join(f'12:00:{k % 60:02d} r/s {{"speed_mps": 0.5, "power_w": {k}}}\n' for k in range(120)).encode(),
        b"t,left_rpm,right_rpm,power_w\n" + "".join(f"{k},9,9,{k}\n" for k in range(120)).encode(),
    ]


@cache
def xml_tracks() -> list[bytes]:
    points = "".join(
        f'<trkpt lat="{45 + 1e-5 * k:.6f}" lon="-4.1"><ele>5</ele><time>2025-03-29T23:58:{k % 60:02d}Z</time>'
        f"<extensions><power>{90 + k}</power></extensions></trkpt>"
        for k in range(60)
    )
    return [f'<?xml version="1.0"?><gpx><trk><trkseg>{points}</trkseg></trk></gpx>'.encode()]


@cache
def robots() -> list[bytes]:
    fields = Robot().as_dict()
    lines = [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
    return ["\n".join(lines).encode(), b"[robot]\n" + "\n".join(lines).encode(), b"mass_kg = 50\n"]


def _with_checksums(rng: Rng, content: bytes) -> bytes:
    """A PNG whose header has its checksum again, so that more than the checksum is looked at."""
    if len(content) < 33 or rng.random() < 0.3:
        return content
    return content[:29] + struct.pack(">I", zlib.crc32(content[12:29])) + content[33:]


def _map(content: bytes, rng: Rng, **options: Any) -> None:
    given: dict[str, Any] = {"resolution_m": 0.5} if rng.random() < 0.8 else {}
    if rng.random() < 0.1:
        given["nodata"] = float(rng.choice([0.0, -9999.0, 1e300]))
    heightmap = read_heightmap(content, max_cells=2_000_000, **given, **options)
    assert not np.isinf(heightmap.heights).any()
    assert write_geotiff(None, heightmap)


def _run(content: bytes, rng: Rng) -> None:
    crs = "EPSG:32630" if rng.random() < 0.8 else None
    run = parse_run(content, name="run", crs=crs, limits=_LIMITS)
    _finite(cut_segments(run, charge=not run.has_energy))


def _travel(content: bytes, rng: Rng) -> None:
    place = _FOLDER / f"fuzz-{id(rng)}.csv"
    place.write_bytes(content)
    run = read_run(place, odometry=Odometry(1.0), name="run", limits=_LIMITS)
    place.unlink()
    _finite(cut_travel(run, charge=not run.has_energy))


def _finite(segments: Any) -> None:
    json.dumps({"segments": len(segments), "left_out": segments.left_out}, allow_nan=False)


def _robot(content: bytes, rng: Rng) -> None:
    place = _FOLDER / f"fuzz-{id(rng)}.toml"
    place.write_bytes(content)
    json.dumps(Robot.from_toml(place).as_dict(), allow_nan=False)


RUNS = ("csv", "parquet", "json", "gpx", "yaml", "wheel_csv", "mapped_csv", *recordings.WRITERS)
"""Readers of runs; the others read maps, robots and paths."""

READERS: dict[str, tuple[Callable[[], list[bytes]], bool, Callable[[bytes, Rng], None]]] = {
    "geotiff": (geotiffs, False, _map),
    "ascii_grid": (lambda: [ASC, ASC.replace(b"corner", b"center"), ASC * 3], True, _map),
    "npy": (arrays, False, _map),
    "npz": (archives, False, _map),
    "png": (pictures, False, lambda content, rng: _map(_with_checksums(rng, content), rng, scale_m=0.1)),
    "csv": (logs, True, _run),
    "parquet": (parquet_logs, False, _run),
    "json": (json_logs, True, _run),
    "gpx": (xml_tracks, True, _run),
    "yaml": (yaml_logs, True, _run),
    "wheel_csv": (wheel_logs, True, _travel),
    "robot": (robots, True, _robot),
    "path": (paths.paths, True, paths.read),
    **{kind: (partial(recordings.logs, kind), False, recordings.read_log) for kind in recordings.WRITERS},
    "mapped_csv": (recordings.odd_tables, True, recordings.read_table),
    "tile": (tiles, False, lambda content, rng: _map(_with_checksums(rng, content), rng)),
    "raster": (rasters, False, _map),
    "scanner": (clouds_of_scanners, False, _map),
    "packed": (packed, False, _map),
    "cloud": (recordings.clouds, False, _map),
    "xyz": (recordings.points, True, partial(_map, filename="a.xyz")),
    "grid_map": (recordings.grid_maps, False, _map),
}
"""By reader: the valid files, whether they are text, and what reads a changed one."""


def input_of(reader: str, seed: int, number: int) -> tuple[bytes, Rng]:
    """An input, which the seed and its number decide, and the generator for further choices."""
    files, text, _ = READERS[reader]
    rng = np.random.default_rng([seed, number])
    content = files()[int(rng.integers(len(files())))]
    return changed(rng, content, text=text), rng


def read_one(reader: str, seed: int, number: int) -> None:
    """Generate an input and read it."""
    READERS[reader][2](*input_of(reader, seed, number))
