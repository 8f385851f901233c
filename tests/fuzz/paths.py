"""Files of paths: valid ones in every format that is read, and what reads a changed one."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.commands.path_files import read_areas, read_path
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from tests.fuzz.files import Rng

_FRAME = GridFrame(370_000.0, 4_064_020.0, 1.0, 20, 20, "EPSG:32630")
_ENDS = ((370_003.0, 4_064_003.0), (370_016.0, 4_064_015.0))


@cache
def costmap() -> jm.CostMap:
    """Level ground with a hole in it."""
    heights = np.zeros(_FRAME.shape, dtype=np.float32)
    heights[8:12, 7:12] = np.nan
    return jm.costmap(Heightmap(heights, _FRAME), model="physics", headings=8)


@cache
def paths() -> list[bytes]:
    """A route in every format, the JSON of an answer, and areas."""
    route = costmap().plan(*_ENDS)
    found = [RouteFile(kind).written(route.track) for kind in ROUTE_FORMATS.values() if kind.name != "mcap"]
    points = route.points.tolist()
    corners = [[370_002.0, 4_064_002.0], [370_006.0, 4_064_002.0], [370_006.0, 4_064_006.0], [370_002.0, 4_064_002.0]]
    area = {"type": "Polygon", "coordinates": [corners]}
    plain = "x,y\n" + "".join(f"{x},{y}\n" for x, y, _ in points)
    return [*found, json.dumps({"path": points}).encode(), json.dumps(area).encode(), plain.encode()]


def read(content: bytes, rng: Rng) -> None:
    """Read a file as a path and as areas, and price what it holds; or an error in words."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "path"
        place.write_bytes(content)
        frame = _FRAME if rng.random() < 0.8 else GridFrame(0.0, 20.0, 1.0, 20, 20)
        reader = read_areas if b"Polygon" in content else read_path
        found, notes = reader(place, frame)
    assert isinstance(notes, list)
    if reader is read_path and frame is _FRAME:
        price_given_path(costmap().lattice, np.array(found, dtype=np.float64))
