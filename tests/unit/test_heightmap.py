"""The Heightmap value and its bilinear heights."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap


def plane(rows: int = 5, cols: int = 6, resolution_m: float = 2.0) -> Heightmap:
    frame = GridFrame(west_m=100.0, north_m=50.0, resolution_m=resolution_m, rows=rows, cols=cols)
    x, y = frame.centres()
    return Heightmap((0.25 * x[None, :] - 0.5 * y[:, None]).astype(np.float32), frame)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0, 1), st.floats(0, 1))
def test_a_plane_is_met_exactly_up_to_the_bounds(u: float, v: float) -> None:
    west, south, east, north = plane().frame.bounds
    x, y = west + u * (east - west), south + v * (north - south)
    assert plane().sample(x, y) == pytest.approx(0.25 * x - 0.5 * y, abs=1e-4)


def test_between_four_cells_the_height_is_bilinear() -> None:
    heightmap = Heightmap(np.array([[1.0, 2.0], [3.0, 8.0]]), GridFrame(0.0, 2.0, 1.0, 2, 2))
    # u = 0.25 east, v = 0.5 south: 0.5 (0.75 1 + 0.25 2) + 0.5 (0.75 3 + 0.25 8) = 2.75
    assert heightmap.sample(0.75, 1.0) == pytest.approx(2.75)


def test_outside_is_unknown() -> None:
    west, south, east, north = plane().frame.bounds
    x = [west - 0.01, east + 0.01, west, west, np.nan, np.inf]
    y = [south, south, south - 0.01, north + 0.01, south, south]
    assert np.isnan(plane().sample(x, y)).all()


def test_an_unknown_cell_spoils_its_surroundings_only() -> None:
    heights = np.zeros((5, 5), dtype=np.float32)
    heights[2, 2] = np.nan
    heightmap = Heightmap(heights, GridFrame(0.0, 5.0, 1.0, 5, 5))
    assert np.isnan(heightmap.sample([2.5, 2.6, 3.4], [2.5, 2.1, 3.4])).all()
    assert heightmap.sample([1.5, 3.5, 2.5], [2.5, 2.5, 3.5]).tolist() == [0.0, 0.0, 0.0]  # the neighbours' centres
    assert heightmap.known_share == pytest.approx(24 / 25)


def test_the_hash_is_the_one_that_is_kept_in_older_files() -> None:
    """Ourselves, regression only: cost maps, databases and models keep this identity of their heightmap."""
    heights = np.arange(6, dtype=np.float32).reshape(2, 3)
    frame = GridFrame(366_966.5, 4_064_491.5, 0.5, 2, 3, "EPSG:32630")
    assert Heightmap(heights, frame).data_hash == "e9603e72679d8af0"


def test_the_hash_distinguishes_heights_and_places() -> None:
    frame = GridFrame(0.0, 2.0, 1.0, 2, 2)
    one = Heightmap(np.zeros((2, 2)), frame)
    assert one.data_hash == Heightmap(np.zeros((2, 2)), frame, source="elsewhere").data_hash
    assert one.data_hash == Heightmap(np.zeros((2, 2)), GridFrame(-0.0, 2, 1, 2, 2)).data_hash
    assert one.data_hash != Heightmap(np.ones((2, 2)), frame).data_hash
    assert one.data_hash != Heightmap(np.zeros((2, 2)), GridFrame(1.0, 2.0, 1.0, 2, 2)).data_hash


def test_heights_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValueError, match="read-only"):
        plane().heights[0, 0] = 1.0


@pytest.mark.parametrize(
    ("heights", "words"),
    [
        (np.zeros((3, 2)), "frame"),
        (np.full((2, 2), np.nan), "unknown"),
        (np.array([[0.0, np.inf], [0.0, 0.0]]), "infinite"),
    ],
)
def test_what_is_no_heightmap_is_refused(heights: np.ndarray, words: str) -> None:
    with pytest.raises(HeightmapError, match=words):
        Heightmap(heights, GridFrame(0.0, 2.0, 1.0, 2, 2))
    with pytest.raises(HeightmapError, match="2 x 2"):
        Heightmap(np.zeros((1, 5)), GridFrame(0.0, 2.0, 1.0, 1, 5))
