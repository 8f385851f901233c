"""Conventions of world, cells and headings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from joulemap.model.errors import HeightmapError, PointError
from joulemap.model.frames import GridFrame, heading_bins, heading_of, heading_vector, wrap_angle

finite = st.floats(-1e6, 1e6)
headings = st.floats(-20.0, 20.0)
frames = st.builds(
    GridFrame,
    west_m=finite,
    north_m=finite,
    resolution_m=st.floats(0.01, 100.0),
    rows=st.integers(2, 2000),
    cols=st.integers(2, 2000),
)


def test_compass_points_move_as_on_a_map() -> None:
    dx, dy = heading_vector(np.deg2rad([0, 90, 180, 270]))
    np.testing.assert_allclose(dx, [0, 1, 0, -1], atol=1e-15)
    np.testing.assert_allclose(dy, [1, 0, -1, 0], atol=1e-15)


def test_bins_start_north_and_go_clockwise() -> None:
    np.testing.assert_allclose(np.rad2deg(heading_bins(8)), [0, 45, 90, 135, 180, 225, 270, 315])


@given(headings)
def test_heading_survives_the_round_trip_through_a_step(heading: float) -> None:
    back = heading_of(*heading_vector(heading))
    assert 0.0 <= back <= math.tau
    assert abs(wrap_angle(back - heading)) < 1e-9


@given(headings)
def test_wrap_keeps_the_direction_within_half_a_turn(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -math.pi <= wrapped < math.pi + 1e-12
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@given(frames, st.floats(-0.5, 3000.0), st.floats(-0.5, 3000.0))
def test_cells_survive_the_round_trip_through_the_world(frame: GridFrame, row: float, col: float) -> None:
    again = frame.rowcol(*frame.xy(row, col))
    np.testing.assert_allclose(again, (row, col), atol=1e-9 * 1e6 / frame.resolution_m + 1e-9)


@given(frames, st.data())
def test_a_window_holds_the_same_places(frame: GridFrame, data: st.DataObject) -> None:
    row0 = data.draw(st.integers(0, frame.rows - 1))
    col0 = data.draw(st.integers(0, frame.cols - 1))
    window = frame.window(row0, frame.rows, col0)
    assert window.shape == (frame.rows - row0, frame.cols - col0)
    np.testing.assert_allclose(window.xy(0, 0), frame.xy(row0, col0), rtol=1e-12, atol=1e-6)


def test_row_0_is_north_and_centres_are_half_a_cell_in() -> None:
    frame = GridFrame(west_m=100.0, north_m=500.0, resolution_m=2.0, rows=3, cols=4)
    assert frame.bounds == (100.0, 494.0, 108.0, 500.0)
    x, y = frame.centres()
    assert list(x) == [101.0, 103.0, 105.0, 107.0]
    assert list(y) == [499.0, 497.0, 495.0]


@pytest.mark.parametrize(
    ("x", "y", "cell"),
    [(100.0, 500.0, (0, 0)), (108.0, 494.0, (2, 3)), (103.9, 496.1, (1, 1)), (104.1, 495.9, (2, 2))],
)
def test_the_cell_of_a_point(x: float, y: float, cell: tuple[int, int]) -> None:
    assert GridFrame(100.0, 500.0, 2.0, 3, 4).cell_of(x, y) == cell


@pytest.mark.parametrize(("x", "y"), [(99.9, 497.0), (101.0, 500.1), (math.nan, 497.0), (101.0, math.inf)])
def test_a_point_off_the_map_is_named(x: float, y: float) -> None:
    with pytest.raises(PointError, match=r"^goal"):
        GridFrame(100.0, 500.0, 2.0, 3, 4).cell_of(x, y, name="goal")


def test_rounding_puts_no_point_off_the_map() -> None:
    frame = GridFrame(0.0, 40.0, 1.0, 40, 50)
    assert frame.cell_of(50.0 + 1e-9, -1e-9, name="start") == (39, 49)
    assert frame.cell_of(-1e-9, 40.0 + 1e-9, name="start") == (0, 0)


@pytest.mark.parametrize(
    ("x", "y", "hint"),
    [
        (4064300.0, 367000.0, "; with x and y exchanged it would lie inside"),
        (36.72, -4.49, "; this looks like latitude and longitude in degrees; the map is in metres of EPSG:32630"),
        (-4.49, 36.72, "; this looks like latitude and longitude in degrees; the map is in metres of EPSG:32630"),
        (367300.0, 4064300.0, "..4064491.00"),
        (120.0, 95.0, "..4064491.00"),
    ],
)
def test_a_point_outside_says_what_may_be_mixed_up(x: float, y: float, hint: str) -> None:
    with pytest.raises(PointError) as caught:
        GridFrame(366966.0, 4064491.0, 1.0, 200, 200, "EPSG:32630").cell_of(x, y, name="start")
    assert caught.value.message.endswith(hint)


def test_small_numbers_are_metres_near_the_origin() -> None:
    for crs in (None, "EPSG:32630"):
        with pytest.raises(PointError) as caught:
            GridFrame(0.0, 50.0, 1.0, 50, 50, crs).cell_of(60.0, 20.0)
        assert "degrees" not in caught.value.message


def test_respacing_keeps_the_corner_and_stays_inside() -> None:
    coarse = GridFrame(10.0, 20.0, 0.3, 100, 50).respaced(1.0)
    assert (coarse.west_m, coarse.north_m, coarse.shape) == (10.0, 20.0, (30, 15))
    assert GridFrame(0.0, 60.0, 0.1, 600, 600).respaced(1.0).shape == (60, 60)  # 600 x 0.1 is not quite 60 in binary
    with pytest.raises(HeightmapError, match="too small"):
        GridFrame(0.0, 0.0, 0.1, 12, 12).respaced(1.0)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_impossible_resolutions_are_refused(bad: float) -> None:
    with pytest.raises(HeightmapError, match="resolution"):
        GridFrame(0.0, 0.0, bad, 2, 2)
    with pytest.raises(HeightmapError, match="spacing"):
        GridFrame(0.0, 0.0, 1.0, 20, 20).respaced(bad)
