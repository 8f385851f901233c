"""Elevation maps of robots in MCAP: written with grid_map's conventions by hand, and read as a heightmap."""

import numpy as np
import pytest
from rosbags.rosbag2 import Writer

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.service.library.heightmaps import read_heightmap
from tests.fuzz.inputs import changed
from tests.reference import ros_maps


def recording(heights, centre, side, start=(0, 0), layers=("elevation",)):
    return ros_maps.recording([ros_maps.grid_map(heights, centre, side, start, layers)])


@pytest.fixture(scope="module")
def heights():
    r, c = np.mgrid[0:6, 0:9]
    found = 10.0 * r + c
    found[2, 3] = np.nan
    return found


@pytest.mark.parametrize("start", [(0, 0), (4, 7)])
def test_a_grid_map_is_turned_to_north_and_its_ring_buffer_unrolled(heights, start):
    content = recording(heights, (100.0, 50.0), 0.5, start)
    found = read_heightmap(content, filename="a.mcap")
    assert found.frame.shape == (9, 6)
    assert found.frame.bounds == (100.0 - 1.5, 50.0 - 2.25, 100.0 + 1.5, 50.0 + 2.25)
    for r in range(6):
        for c in range(9):
            x, y = 100.0 + 1.5 - (r + 0.5) * 0.5, 50.0 + 2.25 - (c + 0.5) * 0.5
            row, col = found.frame.rowcol(x, y)
            np.testing.assert_equal(found.heights[round(float(row)), round(float(col))], np.float32(heights[r, c]))


def test_layers_and_what_is_broken(heights):
    several = recording(heights, (0.0, 0.0), 0.5, layers=("variance", "colour"))
    with pytest.raises(
        HeightmapError, match="no layer `elevation`; give `band`, the number of one of variance, colour"
    ):
        read_heightmap(several, filename="a.mcap")
    assert read_heightmap(several, filename="a.mcap", band=2).frame.shape == (9, 6)
    good = recording(heights, (0.0, 0.0), 0.5)
    with pytest.raises(TooLargeError, match="6 x 9 = 54 cells"):
        read_heightmap(good, filename="b.mcap", max_cells=20)
    rng, said = np.random.default_rng(4), 0
    for k in range(50):
        content = good[: k * len(good) // 20] if 0 < k < 20 else changed(rng, good, text=False)
        try:
            read_heightmap(content, filename="b.mcap", max_cells=10_000)
        except (HeightmapError, TooLargeError):
            said += 1
    assert said >= 30  # a changed index changes no message


@pytest.mark.parametrize("cell", [0.1, 0.5, 1.7])
def test_what_the_occupancy_grid_says_is_occupied_is_a_hole(heights, cell):
    """A wall from (100, 48.25) to (101, 49.75), in cells that are finer, as fine and coarser than the map's."""
    shape = round(6 / cell), round(6 / cell)
    south, west = 46.75, 97.0
    y, x = south + (np.arange(shape[0]) + 0.5) * cell, west + (np.arange(shape[1]) + 0.5) * cell
    wall = ((x > 100.0) & (x < 101.0))[None, :] & ((y > 48.25) & (y < 49.75))[:, None]
    values = np.where(wall, 100, 0)
    values[0, 0] = -1
    messages = [ros_maps.grid_map(heights, (100.0, 50.0), 0.5), ros_maps.occupancy(values, (west, south), cell)]
    found = read_heightmap(ros_maps.recording(messages), filename="a.mcap")
    plain = read_heightmap(ros_maps.recording(messages[:1]), filename="a.mcap")
    holes = np.isnan(found.heights) & ~np.isnan(plain.heights)
    np.testing.assert_array_equal(found.heights[~holes], plain.heights[~holes])
    row, col = np.mgrid[0 : holes.shape[0], 0 : holes.shape[1]]
    px, py = plain.frame.xy(row, col)
    if cell < 1:
        inside = (px > 100.0) & (px < 101.0) & (py > 48.25) & (py < 49.75)
        np.testing.assert_array_equal(holes, inside & ~np.isnan(plain.heights))
    else:
        nearest = np.floor((py - south) / cell).astype(int), np.floor((px - west) / cell).astype(int)
        np.testing.assert_array_equal(holes, wall[nearest] & ~np.isnan(plain.heights))
    assert "cells are holes, because the occupancy grid" in found.notes[0]


def test_an_occupancy_grid_in_another_frame_is_left_out_and_one_alone_has_no_heights(heights):
    grid = ros_maps.occupancy(np.arange(12).reshape(3, 4) - 1, (10.0, 20.0), 0.5, frame="odom")
    both = read_heightmap(ros_maps.recording([ros_maps.grid_map(heights, (10.0, 20.0), 0.5), grid]), filename="a.mcap")
    assert both.notes == ("the occupancy grid was left out: it is in the frame 'odom', the grid map in 'map'",)
    with pytest.raises(HeightmapError, match=r"occupancy is no height.*give `scale_m` \(--scale\), the metres of one"):
        read_heightmap(ros_maps.recording([grid]), filename="a.mcap")
    found = read_heightmap(ros_maps.recording([grid]), filename="a.mcap", scale_m=0.1)
    assert found.frame.bounds == (10.0, 20.0, 12.0, 21.5)
    np.testing.assert_allclose(found.heights[::-1].ravel(), [np.nan, *(0.1 * np.arange(11))], rtol=1e-6)


def test_maps_in_bags_of_ros_2_are_read_too(heights, tmp_path):
    with Writer(tmp_path / "bag", version=9) as bag:
        topic, kind, message = ros_maps.occupancy(np.full((3, 4), 7), (0.0, 0.0), 1.0)
        connection = bag.add_connection(topic, kind, typestore=ros_maps.STORE)
        bag.write(connection, 1, ros_maps.STORE.serialize_cdr(message, kind))
    found = read_heightmap(next((tmp_path / "bag").glob("*.db3")), scale_m=2.0)
    assert (found.heights == 14.0).all()
