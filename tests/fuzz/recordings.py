"""Logs of messages and point clouds: small valid ones of every kind, which are then changed."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS

from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.mapping import read_mapping
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.table import TableLimits
from tests.fuzz.files import Rng
from tests.reference import log_files, ros_maps
from tests.reference.log_files import Drive

LIMITS = TableLimits(rows=1_000_000, columns=2_000, cells=20_000_000, text_mb=200.0)
_MAPPINGS = (
    ["t=timestamp_ms:ms,lat=latitude:deg,lon=longitude:deg,current=batt_current_mA:mA,voltage=batt_voltage_V:V"],
    ["t=minutes:min,x=east_ft:ft,y=north_ft:ft,power=draw_kW:kW"],
    ["current=-batt_current_mA:mA"],
    ["current=/pack.amps:A"],
)
WRITERS: dict[str, Callable[[Path, Drive], Path]] = {
    "bag": log_files.write_bag,
    "db3": log_files.write_db3,
    "mcap": log_files.write_mcap,
    "bin": log_files.write_dataflash,
    "tlog": log_files.write_tlog,
    "ulg": log_files.write_ulog,
    "fit": log_files.write_fit,
}


@cache
def logs(kind: str) -> list[bytes]:
    """A drive of some seconds as a log of a kind; MCAP with each of its compressions."""
    with tempfile.TemporaryDirectory() as folder:
        place, drive = Path(folder) / f"drive.{kind}", log_files.drive(6.0)
        found = [WRITERS[kind](place, drive).read_bytes()]
        if kind == "mcap":
            for compression in ("LZ4", "NONE"):
                found.append(log_files.write_mcap(place, drive, compression=compression).read_bytes())
        return found


@cache
def odd_tables() -> list[bytes]:
    """CSV texts of other programs."""
    with tempfile.TemporaryDirectory() as folder:
        return [path.read_bytes() for path in log_files.write_csvs(Path(folder), log_files.drive(12.0))]


@cache
def clouds() -> list[bytes]:
    """LAS of two versions, and LAZ."""
    rng = np.random.default_rng(5)
    x, y = 40 * rng.random(3_000), 30 * rng.random(3_000)
    found = []
    for version, form, packed in (("1.2", 3, False), ("1.4", 6, False), ("1.4", 6, True), ("1.2", 1, True)):
        header = laspy.LasHeader(point_format=form, version=version)
        header.scales = [0.001] * 3
        header.add_crs(CRS.from_epsg(32630))
        cloud = laspy.LasData(header)
        cloud.x, cloud.y, cloud.z = x, y, 0.1 * x
        cloud.classification = np.full(x.size, 2)
        out = io.BytesIO()
        cloud.write(out, do_compress=packed)
        found.append(out.getvalue())
    return found


@cache
def points() -> list[bytes]:
    """XYZ texts: on a grid, and scattered with a header."""
    row, col = np.mgrid[0:12, 0:15]
    grid = "".join(f"{x} {y} {0.1 * x:.2f}\n" for x, y in zip(col.ravel(), row.ravel(), strict=True))
    rng = np.random.default_rng(6)
    scattered = "".join(f"{x:.3f},{y:.3f},{z:.2f}\n" for x, y, z in 20 * rng.random((500, 3)))
    return [grid.encode(), b"x,y,z\n" + scattered.encode()]


@cache
def grid_maps() -> list[bytes]:
    """Elevation maps of robots in MCAP, with and without an occupancy grid."""
    heights = np.arange(54.0).reshape(6, 9)
    return [
        ros_maps.recording([ros_maps.grid_map(heights, (3.0, 2.0), 0.5)]),
        ros_maps.recording(
            [ros_maps.grid_map(heights, (3.0, 2.0), 0.5), ros_maps.occupancy(np.zeros((9, 6), int), (0, 0), 0.5)]
        ),
    ]


def read_log(content: bytes, rng: Rng) -> None:
    """Read a log, now and then with a mapping."""
    mapping = read_mapping(_MAPPINGS[int(rng.integers(4))]) if rng.random() < 0.2 else None
    _cut(content, mapping)


def read_table(content: bytes, rng: Rng) -> None:
    """Read a CSV text with a mapping, whose own letters are changed now and then."""
    entries = _MAPPINGS[int(rng.integers(4))]
    if rng.random() < 0.3:
        text = bytearray(entries[0].encode())
        text[int(rng.integers(len(text)))] = int(rng.integers(32, 127))
        entries = [text.decode("ascii")]
    _cut(content, read_mapping(entries))


def _cut(content: bytes, mapping: dict[str, str] | None) -> None:
    run = parse_run(content, name="run", crs=log_files.CRS, limits=LIMITS, mapping=mapping)
    cut_segments(run, charge=not run.has_energy)
