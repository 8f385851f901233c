"""Tiles: their cells once each, and a lattice made of them equal to one made whole, in memory, in files and in time."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.errors import HeightmapError, InputError, NotFoundError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain import windows
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import open_ground
from joulemap.model.terrain.windows import HeightmapFile, overview
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.build import build_lattice, write_lattice
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.service.library.heightmaps import read_heightmap

ROOT = Path(__file__).resolve().parents[2]
ARRAYS = ("traction_per_m", "elevation_m", "gradient", "blocked", "std_j")
ROBOT = Robot(max_grade_deg=20.0, max_cross_slope_deg=15.0)


def rough(rows: int, cols: int, *, resolution_m: float, seed: int = 3, holes: int = 3, far: bool = True) -> Heightmap:
    """Waves, a kerb and noise of a centimetre, with unknown rectangles, at coordinates as large as a survey's."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols] * resolution_m
    heights = 0.4 * np.sin(0.6 * x) + 0.3 * np.cos(0.5 * y + 0.3 * x) + random.normal(0.0, 0.01, x.shape)
    heights[:, cols // 3] += 0.3
    for _ in range(holes):
        row, col = random.integers(0, rows), random.integers(0, cols)
        heights[row : row + random.integers(1, 12), col : col + random.integers(1, 12)] = np.nan
    west, north = (512_345.6, 5_412_345.7) if far else (0.0, rows * resolution_m)
    return Heightmap(heights.astype(np.float32), GridFrame(west, north, resolution_m, rows, cols, "EPSG:32632"))


def assert_equal_lattices(one, other, *, exactly: bool = False) -> None:
    """exactly : bit by bit; else to float32 rounding (a price sums terms of the robot's weight)."""
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None)
        if a is None:
            continue
        if exactly or name == "blocked":
            np.testing.assert_array_equal(a, b, err_msg=name)
        else:
            largest = float(np.nanmax(np.abs(a), initial=0.0))
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=4e-7 * largest + 1e-7, err_msg=name)


@settings(max_examples=30, deadline=None)
@given(rows=st.integers(2, 40), cols=st.integers(2, 40), side=st.integers(1, 50))
def test_every_cell_is_in_one_tile(rows: int, cols: int, side: int) -> None:
    tiling = Tiling(GridFrame(0.0, 0.0, 1.0, rows, cols), 16, side)
    seen = np.zeros((rows, cols), dtype=int)
    for place in tiling:
        seen[place] += 1
    assert (seen == 1).all()
    assert len(list(tiling)) == len(tiling)


def test_tiles_are_smaller_where_heights_are_dense() -> None:
    assert Tiling.of(GridFrame(0.0, 0.0, 0.25, 4000, 4000), spacing_m=1.0, headings=16).side == 256
    assert Tiling.of(GridFrame(0.0, 0.0, 0.01, 4000, 4000), spacing_m=1.0, headings=16).side == 64


@settings(max_examples=12, deadline=None)
@given(
    rows=st.integers(30, 90),
    cols=st.integers(30, 90),
    side=st.integers(3, 40),
    seed=st.integers(0, 1000),
    resolution_m=st.sampled_from([0.1, 0.25, 0.5, 1.0]),
    spacing_m=st.sampled_from([0.5, 1.0, 1.3]),
)
@example(rows=77, cols=30, side=3, seed=0, resolution_m=0.1, spacing_m=0.5)  # at the edge of a hole, to rounding
def test_tiles_do_not_show_in_physics(rows, cols, side, seed, resolution_m, spacing_m) -> None:
    heightmap = rough(rows, cols, resolution_m=resolution_m, seed=seed)
    if min(rows, cols) * resolution_m < 2.0 * spacing_m:
        return
    whole, tiled = (
        build_lattice(heightmap, ROBOT, PhysicsPredictor(), spacing_m=spacing_m, headings=8, tile_cells=cells)
        for cells in (10_000, side)
    )
    assert_equal_lattices(tiled, whole)


@pytest.mark.parametrize(
    ("resolution_m", "spacing_m", "side"), [(0.25, 1.0, 7), (0.1, 1.0, 9), (0.25, 0.5, 33), (0.5, 1.3, 8)]
)
def test_tiles_do_not_show_in_the_network(resolution_m: float, spacing_m: float, side: int) -> None:
    metres = 21 if spacing_m >= 1.0 else 33
    cells = round(metres / resolution_m)
    heightmap = rough(cells, cells + 5, resolution_m=resolution_m)
    network = load_predictor("default")
    whole, tiled = (
        build_lattice(heightmap, ROBOT, network, spacing_m=spacing_m, headings=8, tile_cells=cells)
        for cells in (10_000, side)
    )
    assert tiled.std_j is not None
    assert np.isfinite(tiled.std_j).any()
    assert_equal_lattices(tiled, whole)


@pytest.mark.parametrize("robot", [Robot(), Robot(length_m=3.0, width_m=2.5, wheel_radius_m=0.8)])
def test_limits_of_a_big_robot_are_seen_across_tiles(robot: Robot) -> None:
    heightmap = rough(200, 180, resolution_m=0.1)
    whole, tiled = (build_lattice(heightmap, robot, PhysicsPredictor(), tile_cells=cells) for cells in (1000, 5))
    assert_equal_lattices(tiled, whole)


def test_a_tile_of_unknown_ground_is_blocked() -> None:
    heights = np.zeros((160, 160), dtype=np.float32)
    heights[:, 60:] = np.nan
    heightmap = Heightmap(heights, GridFrame(0.0, 40.0, 0.25, 160, 160))
    whole, tiled = (build_lattice(heightmap, ROBOT, load_predictor("default"), tile_cells=n) for n in (1000, 8))
    assert_equal_lattices(tiled, whole)
    assert np.isnan(tiled.traction_per_m[:, 20:]).all()


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize("side", [16, 600])
def test_a_file_read_by_windows_is_the_file_read_whole(tmp_path, monkeypatch, side: int, kept: bool) -> None:
    monkeypatch.setattr(windows, "_KEPT_CELLS", 311 * 287 if kept else 0)
    heightmap = rough(311, 287, resolution_m=0.25)
    write_geotiff(tmp_path / "dem.tif", heightmap)
    ground, whole = open_ground(tmp_path / "dem.tif"), read_heightmap(tmp_path / "dem.tif")
    assert isinstance(ground, HeightmapFile)
    assert (ground.frame, ground.source) == (whole.frame, whole.source)
    assert ground.data_hash == whole.data_hash
    assert ground.known_share == whole.known_share
    np.testing.assert_array_equal(overview(ground).heights, whole.heights)
    tiling = Tiling.of(ground.frame, spacing_m=1.0, headings=8, side=side)
    shares: list[float] = []
    provenance = write_lattice(tmp_path / "a.zarr", ground, ROBOT, PhysicsPredictor(), tiling, progress=shares.append)
    back, direct = load_lattice(tmp_path / "a.zarr"), build_lattice(whole, ROBOT, PhysicsPredictor(), headings=8)
    assert_equal_lattices(back, direct, exactly=False)
    assert back.provenance == provenance
    assert {**provenance, "made_at": ""} == {**direct.provenance, "made_at": ""}
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_file_without_a_known_height_is_refused(tmp_path) -> None:
    empty = np.full((20, 20), np.nan, dtype=np.float32)
    write_geotiff(tmp_path / "empty.tif", Heightmap(empty, GridFrame(0.0, 20.0, 1.0, 20, 20), part=True))
    ground = open_ground(tmp_path / "empty.tif")
    with pytest.raises(HeightmapError, match="every cell"):
        _ = ground.known_share
    with pytest.raises(HeightmapError, match="no file"):
        open_ground(tmp_path / "nowhere.tif")


def test_a_large_map_is_judged_by_windows_that_do_not_touch(monkeypatch) -> None:
    monkeypatch.setattr("joulemap.model.terrain.windows._SAMPLE_CELLS", 10_000)
    heights = np.add.outer(np.zeros(400), np.where(np.arange(900) < 450, 0.0, 500.0)).astype(np.float32)
    seen = overview(Heightmap(heights, GridFrame(0.0, 400.0, 1.0, 400, 900))).heights
    assert seen.size < 30_000
    assert set(np.unique(seen[np.isfinite(seen)])) == {0.0, 500.0}
    across = np.abs(seen[:, 1:] - seen[:, :-1])
    assert np.nanmax(across) == 0.0  # the cliff lies between two windows, and no slope spans two of them


def test_tiles_may_come_again_and_what_a_killed_writer_left_goes(tmp_path) -> None:
    heightmap = rough(120, 130, resolution_m=0.5)
    lattice = build_lattice(heightmap, ROBOT, PhysicsPredictor(), headings=8)
    tiling = Tiling(lattice.frame, 8, 32)
    folder = LatticeFolder(tmp_path / "a.zarr")
    folder.lay_out(tiling, ROBOT, with_std=False)
    for place in [*tiling, tiling[1], tiling[0]]:
        folder.write(lattice.window(place[0].start, place[0].stop, place[1].start, place[1].stop), *place)
    torn = folder.partial / "blocked" / "c" / "0" / "0.7f3a.partial"
    torn.write_bytes(b"half a chunk")
    with pytest.raises(NotFoundError):
        load_lattice(tmp_path / "a.zarr")  # not before it is finished
    folder.finish({"who": "us"})
    folder.finish({"who": "us again"})  # as by a worker that believes the first one dead
    back = load_lattice(tmp_path / "a.zarr")
    assert back.provenance == {"who": "us"}
    assert_equal_lattices(back, lattice, exactly=True)
    assert not list(tmp_path.rglob("*.partial"))


def test_a_tile_that_was_never_written_is_unknown_and_not_free(tmp_path) -> None:
    lattice = build_lattice(rough(120, 120, resolution_m=0.5), ROBOT, PhysicsPredictor(), headings=8)
    folder = LatticeFolder(tmp_path / "a.zarr")
    folder.lay_out(Tiling(lattice.frame, 8, 32), ROBOT, with_std=False)
    folder.finish({})
    back = load_lattice(tmp_path / "a.zarr")
    assert (back.blocked > 0).all()
    assert np.isnan(back.traction_per_m).all()


CUT_OFF = 7
TILING = Tiling.of(GridFrame(512_345.6, 5_412_345.7, 0.5, 120, 120, "EPSG:32632"), spacing_m=1.0, headings=8, side=32)


def cut_off_writer(place: Path) -> None:
    """Write a lattice and interrupt this process after the second tile. Exits with `CUT_OFF` if all is well."""
    heightmap, source = rough(120, 120, resolution_m=0.5), PhysicsPredictor()
    seen = []

    def cut_after_the_second(part) -> None:
        seen.append((place / "a.zarr.partial").exists())
        if len(seen) == 2:
            os.kill(os.getpid(), signal.SIGINT)

    signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the process was started with
    try:
        write_lattice(place / "a.zarr", heightmap, ROBOT, source, TILING, each=cut_after_the_second)
    except KeyboardInterrupt:
        assert seen == [True, True]
        sys.exit(CUT_OFF)


def test_a_writer_that_is_cut_off_leaves_nothing_behind(tmp_path) -> None:
    """Ctrl-C after a tile: no folder, no half of one; a lattice that was there before is kept."""
    code = "import sys, pathlib; from tests.unit.test_tiles import cut_off_writer as cut; "
    code += "cut(pathlib.Path(sys.argv[1]))"
    for before in (False, True):
        done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == CUT_OFF, done.stderr
        assert [place.name for place in tmp_path.iterdir()] == (["a.zarr"] if before else [])
        write_lattice(tmp_path / "a.zarr", rough(120, 120, resolution_m=0.5), ROBOT, PhysicsPredictor(), TILING)
    assert load_lattice(tmp_path / "a.zarr").frame == TILING.frame


def test_what_is_no_lattice_is_left_alone_with_all_that_is_beside_it(tmp_path) -> None:
    for name in ("a.zarr", "a.zarr.partial"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "precious.txt").write_text("keep")
    tiling = Tiling.of(GridFrame(0.0, 20.0, 0.5, 40, 40), spacing_m=1.0, headings=8)
    with pytest.raises(InputError, match="will not be overwritten"):
        write_lattice(tmp_path / "a.zarr", rough(40, 40, resolution_m=0.5), ROBOT, PhysicsPredictor(), tiling)
    assert len(list(tmp_path.rglob("precious.txt"))) == 2
