"""Cost maps that are planned on from disk: the answers of the map in memory, refusals in words, progress that may stop."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import InputError, TooLargeError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.cli import app

START, GOAL = (4.3, 5.2), (92.1, 61.7)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    y, x = np.mgrid[0:70, 0:100].astype(float)
    heights = 2.5 * np.sin(x / 9.0) * np.cos(y / 11.0) + 0.02 * x
    heights[30:34, 20:80] += 2.0  # a wall to drive around
    ground = Heightmap(heights.astype(np.float32), GridFrame(0.0, 70.0, 1.0, 70, 100))
    return jm.costmap(ground, model="physics").save(tmp_path_factory.mktemp("stored") / "map.zarr")


def test_a_route_from_disk_is_that_of_the_map_in_memory(folder):
    whole, stored = jm.open_costmap(folder), jm.open_costmap(folder, memory_gb=0.5)
    ours, theirs = stored.plan(START, GOAL), whole.plan(START, GOAL)
    assert ours.energy_j == pytest.approx(theirs.energy_j, rel=1e-3)
    assert ours.shortest.length_m == pytest.approx(theirs.shortest.length_m, rel=1e-3)
    details = ours.found.details
    assert details["grid_bound_j"] <= details["grid_energy_j"] <= details["grid_bound_j"] * (1 + 1e-4) + 0.1
    assert ours.energy_j <= details["grid_energy_j"] + 1e-6
    again = jm.planner.route.price_route(whole.lattice, ours.points)
    assert again.energy_j == pytest.approx(ours.energy_j, rel=1e-9)
    assert stored.at(50.0, 20.0).energy_per_m == pytest.approx(whole.at(50.0, 20.0).energy_per_m, nan_ok=True)


def test_a_verdict_from_disk(folder):
    whole, stored = jm.open_costmap(folder), jm.open_costmap(folder, memory_gb=0.5)
    path = [START, (50.0, 10.0), (90.0, 12.0)]
    assert stored.feasibility(path).energy_j == pytest.approx(whole.feasibility(path).energy_j)
    there_and_back = stored.feasibility(stored.plan(START, GOAL), round_trip=True)
    assert there_and_back.route_back is not None


@pytest.mark.parametrize("what", ["plot", "to_xarray", "summary"])
def test_what_needs_all_cells_is_refused(folder, what):
    with pytest.raises(InputError, match="memory_gb"):
        getattr(jm.open_costmap(folder, memory_gb=0.5), what)()


def test_other_planners_and_too_little_memory_are_refused(folder):
    stored = jm.open_costmap(folder, memory_gb=0.5)
    with pytest.raises(InputError, match="bitstar"):
        stored.plan(START, GOAL, planner="bitstar")
    with pytest.raises(InputError, match="alternatives"):
        stored.plan(START, GOAL, alternatives=2)
    with pytest.raises(TooLargeError, match="memory"):
        jm.open_costmap(folder, memory_gb=1e-6).plan(START, GOAL)
    with pytest.raises(InputError, match="memory_gb"):
        jm.open_costmap(folder, memory_gb=0.0)


def test_progress_goes_up_and_may_stop_the_search(folder):
    shares = []
    jm.open_costmap(folder, memory_gb=0.5).plan(START, GOAL, progress=shares.append)
    assert shares
    assert all(0.0 <= share <= 1.0 for share in shares)

    class Stopped(Exception):
        pass

    def stop(_share):
        raise Stopped

    with pytest.raises(Stopped):
        jm.open_costmap(folder, memory_gb=0.5).plan(START, GOAL, progress=stop)


def test_the_command_plans_within_a_memory(folder, tmp_path):
    def told(*more):
        out = tmp_path / "path.json"
        command = ["path", str(folder), "--start", "4.3,5.2", "--goal", "92.1,61.7", "--json", str(out), *more]
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 0, result.output
        return json.loads(out.read_text())

    assert told("--memory", "0.5")["energy_j"] == pytest.approx(told()["energy_j"], rel=1e-3)
