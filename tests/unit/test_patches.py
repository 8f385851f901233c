"""Patches as the paper cuts them, and squares for the dense network."""

import math

import numpy as np
import pytest

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame, heading_vector
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches, cut_squares

FRAME = GridFrame(west_m=500_000.0, north_m=4_000_008.0, resolution_m=0.1, rows=80, cols=80)  # 8 x 8 m, as in UTM
MIDDLE = (500_004.0, 4_000_004.0)


def tilted(slope_deg: float, uphill_deg: float, frame: GridFrame = FRAME, base_m: float = 0.0) -> Heightmap:
    x, y = frame.centres()
    dx, dy = heading_vector(math.radians(uphill_deg))
    along = (x - frame.west_m)[None, :] * dx + (y - frame.north_m)[:, None] * dy
    return Heightmap((base_m + math.tan(math.radians(slope_deg)) * along).astype(np.float32), frame)


def rough(seed: int = 3, rows: int = 80, cols: int = 80) -> Heightmap:
    heights = np.random.default_rng(seed).normal(0.0, 0.1, (rows, cols))
    return Heightmap(heights, GridFrame(500_000.0, 4_000_008.0, 0.1, rows, cols))


@pytest.mark.parametrize("size", [16, 32, 256])
@pytest.mark.parametrize("slope_deg", [0.0, 5.0, 30.0])
def test_tilted_plane_for_every_heading(size: int, slope_deg: float) -> None:
    """Closed form: along the motion the plane climbs tan(slope) cos(d) per metre, to its right tan(slope) sin(d),
    with d from the heading to the uphill direction."""
    uphill_deg = 40.0
    headings = np.deg2rad(np.arange(0.0, 360.0, 7.5))
    patches = cut_patches(tilted(slope_deg, uphill_deg), *MIDDLE, headings, size=size)
    assert patches.shape == (48, size, size)
    assert patches.dtype == np.float32
    along = np.linspace(1.0, 0.0, size)[:, None]
    right = np.linspace(-0.5, 0.5, size)[None, :]
    for heading, patch in zip(headings, patches, strict=True):
        off = math.radians(uphill_deg) - heading
        exact = math.tan(math.radians(slope_deg)) * (along * math.cos(off) + right * math.sin(off))
        np.testing.assert_allclose(patch, exact - exact.min(), atol=2e-6)
        grade = (patch[0].mean() - patch[-1].mean()) / 1.0  # q's edge less p's edge, 1 m apart
        assert grade == pytest.approx(math.tan(math.radians(slope_deg)) * math.cos(off), abs=2e-6)


def test_a_ridge_that_only_the_left_wheel_meets() -> None:
    """A ridge 0.3 m west of a northward motion: left of centre going north, right of centre coming back south."""
    x, _ = FRAME.centres()
    ridge = np.where(np.abs(x - (MIDDLE[0] - 0.3)) < 0.11, 0.1, 0.0)
    heightmap = Heightmap(np.broadcast_to(ridge, FRAME.shape), FRAME)
    north, south = cut_patches(
        heightmap, MIDDLE[0], [MIDDLE[1], MIDDLE[1] + 1.0], [0.0, math.pi], size=33
    )  # the same metre, there and back
    assert north[:, :16].max() == pytest.approx(0.1)
    assert north[:, 16:].max() == 0.0
    assert south[:, :17].max() == 0.0
    assert south[:, 17:].max() == pytest.approx(0.1)
    np.testing.assert_allclose(south, north[::-1, ::-1], atol=1e-6)


def test_every_sample_is_the_height_where_the_paper_puts_it() -> None:
    heightmap, heading, size = rough(), math.radians(287.3), 9
    patch = cut_patches(heightmap, *MIDDLE, heading, size=size)[0]
    dx, dy = heading_vector(heading)
    expected = np.empty((size, size))
    for i, along in enumerate(np.linspace(1.0, 0.0, size)):
        for j, right in enumerate(np.linspace(-0.5, 0.5, size)):
            expected[i, j] = heightmap.sample(MIDDLE[0] + along * dx + right * dy, MIDDLE[1] + along * dy - right * dx)
    np.testing.assert_allclose(patch, expected - expected.min(), atol=1e-6)


def test_rotating_the_map_and_the_heading_changes_nothing() -> None:
    """np.rot90 turns the map 90 degrees to the left: a heading h becomes h - 90, and (x, y) becomes (-y, x)."""
    heightmap = rough()
    centre = np.array(MIDDLE)
    turned = Heightmap(np.rot90(heightmap.heights), FRAME)
    rng = np.random.default_rng(0)
    offsets, headings = rng.uniform(-1.5, 1.5, (20, 2)), rng.uniform(0, math.tau, 20)
    before = cut_patches(heightmap, *(centre + offsets).T, headings)
    moved = np.stack([-offsets[:, 1], offsets[:, 0]], axis=1)
    after = cut_patches(turned, *(centre + moved).T, headings - math.pi / 2)
    np.testing.assert_allclose(after, before, atol=1e-6)


def test_unknown_ground_makes_the_whole_patch_unknown() -> None:
    heights = rough().heights.copy()
    heights[35, 40] = np.nan  # 0.4-0.5 m north of the middle
    heightmap = Heightmap(heights, FRAME)
    north, south = cut_patches(heightmap, *MIDDLE, [0.0, math.pi])
    assert np.isnan(north).all()
    assert not np.isnan(south).any()
    west, _, _, top = FRAME.bounds
    outside = cut_patches(heightmap, [west + 0.4, west + 3.0, math.nan], [top - 3.0, top - 0.9, top - 3.0], 0.0)
    assert np.isnan(outside).all()


@pytest.mark.parametrize("options", [{"size": 1}, {"side_m": 0.0}, {"side_m": math.nan}])
def test_impossible_patches_are_refused(options: dict) -> None:
    with pytest.raises(InputError):
        cut_patches(rough(), *MIDDLE, 0.0, **options)


def test_squares_are_north_up_and_relative_to_their_centre() -> None:
    slope = math.tan(math.radians(12.0))
    square = cut_squares(tilted(12.0, 90.0), *MIDDLE, size=6, pixel_m=0.25)[0]  # climbs to the east
    across = (np.arange(6) - 2.5) * 0.25
    np.testing.assert_allclose(square, np.broadcast_to(slope * across, (6, 6)), atol=2e-6)
    square = cut_squares(tilted(12.0, 0.0), *MIDDLE, size=5, pixel_m=0.25)[0]  # climbs to the north
    np.testing.assert_allclose(square[:, 0], slope * (2 - np.arange(5)) * 0.25, atol=2e-6)


def test_squares_over_the_edge_continue_by_odd_reflection() -> None:
    heightmap = rough(rows=20, cols=20)
    padded = np.pad(heightmap.heights.astype(np.float64), 6, mode="reflect", reflect_type="odd")
    x, y = heightmap.frame.centres()
    for row, col in ((0, 0), (19, 19), (0, 10), (7, 18)):
        square = cut_squares(heightmap, x[col], y[row], size=13, pixel_m=0.1, pad_m=0.61)[0]
        expected = padded[row : row + 13, col : col + 13] - heightmap.heights[row, col]
        np.testing.assert_allclose(square, expected, atol=1e-6)
    assert np.isnan(cut_squares(heightmap, x[0], y[0], size=13, pixel_m=0.1)).all()
    assert np.isnan(cut_squares(heightmap, x[0], y[0], size=13, pixel_m=0.1, pad_m=0.3)).all()


def test_squares_meeting_unknown_ground_are_unknown() -> None:
    heights = rough().heights.copy()
    heights[30, 30] = np.nan
    x, y = FRAME.centres()
    squares = cut_squares(Heightmap(heights, FRAME), x[[34, 50, 30]], y[[30, 50, 30]], size=11, pixel_m=0.1)
    assert np.isnan(squares).all(axis=(1, 2)).tolist() == [True, False, True]
    with pytest.raises(InputError, match="pad_m"):
        cut_squares(rough(), *MIDDLE, size=8, pixel_m=0.1, pad_m=-1.0)
