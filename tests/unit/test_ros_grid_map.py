"""Elevation maps of robots in MCAP: written with grid_map's conventions by hand, and read as a heightmap."""

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.terrain.readers import read_heightmap
from tests.fuzz.inputs import changed

KIND = "grid_map_msgs/msg/GridMap"
DEFINITION = """std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
================================================================================
MSG: grid_map_msgs/GridMapInfo
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
"""


def recording(path, heights, centre, side, start=(0, 0), layers=("elevation",)):
    """heights(x, y) of grid_map: index (r, c) lies at centre + length / 2 - (index + 0.5) * side, rows along x."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register({k: v for k, v in get_types_from_msg(DEFINITION, KIND).items() if k not in store.fielddefs})
    t = store.types
    rows, cols = heights.shape
    matrix = np.roll(heights, start, (0, 1)).astype(np.float32)
    dim = t["std_msgs/msg/MultiArrayDimension"]
    layout = t["std_msgs/msg/MultiArrayLayout"](
        dim=[dim("column_index", cols, rows * cols), dim("row_index", rows, rows)], data_offset=0
    )
    array = t["std_msgs/msg/Float32MultiArray"](layout=layout, data=matrix.T.ravel())
    pose = t["geometry_msgs/msg/Pose"](
        position=t["geometry_msgs/msg/Point"](*centre, 0.0), orientation=t["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    )
    header = t["std_msgs/msg/Header"](stamp=t["builtin_interfaces/msg/Time"](sec=5, nanosec=0), frame_id="map")
    info = t["grid_map_msgs/msg/GridMapInfo"](side, rows * side, cols * side, pose)
    message = t[KIND](header, info, list(layers), [], [array] * len(layers), *start)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "tests")
        schema = writer.register_schema(KIND, "ros2msg", DEFINITION.encode())
        channel = writer.register_channel("/elevation_map", "cdr", schema)
        writer.add_message(channel, 0, bytes(store.serialize_cdr(message, KIND)), 0)
        writer.finish()
    return path.read_bytes()


@pytest.fixture(scope="module")
def heights():
    r, c = np.mgrid[0:6, 0:9]
    found = 10.0 * r + c
    found[2, 3] = np.nan
    return found


@pytest.mark.parametrize("start", [(0, 0), (4, 7)])
def test_a_grid_map_is_turned_to_north_and_its_ring_buffer_unrolled(heights, start, tmp_path):
    content = recording(tmp_path / "a.mcap", heights, (100.0, 50.0), 0.5, start)
    found = read_heightmap(content, filename="a.mcap")
    assert found.frame.shape == (9, 6)
    assert found.frame.bounds == (100.0 - 1.5, 50.0 - 2.25, 100.0 + 1.5, 50.0 + 2.25)
    for r in range(6):
        for c in range(9):
            x, y = 100.0 + 1.5 - (r + 0.5) * 0.5, 50.0 + 2.25 - (c + 0.5) * 0.5
            row, col = found.frame.rowcol(x, y)
            np.testing.assert_equal(found.heights[round(float(row)), round(float(col))], np.float32(heights[r, c]))


def test_layers_and_what_is_broken(heights, tmp_path):
    several = recording(tmp_path / "a.mcap", heights, (0.0, 0.0), 0.5, layers=("variance", "colour"))
    with pytest.raises(
        HeightmapError, match="no layer `elevation`; give `band`, the number of one of variance, colour"
    ):
        read_heightmap(several, filename="a.mcap")
    assert read_heightmap(several, filename="a.mcap", band=2).frame.shape == (9, 6)
    good = recording(tmp_path / "b.mcap", heights, (0.0, 0.0), 0.5)
    with pytest.raises(TooLargeError, match="6 x 9 = 54 cells"):
        read_heightmap(good, filename="b.mcap", max_cells=20)
    rng, said = np.random.default_rng(4), 0
    for k in range(50):
        content = good[: k * len(good) // 20] if 0 < k < 20 else changed(rng, good, text=False)
        try:
            read_heightmap(content, filename="b.mcap", max_cells=10_000)
        except (HeightmapError, TooLargeError):
            said += 1
    assert said > 30
