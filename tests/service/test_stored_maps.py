"""Cost maps planned on from disk: the answers of the map in memory, refusals in words, progress that may stop."""

import json

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import InputError, TooLargeError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner import stored_planner
from joulemap.service.cli import app
from joulemap.service.http.app import create_app
from tests.service.conftest import GOAL as HTTP_GOAL
from tests.service.conftest import START as HTTP_START
from tests.service.conftest import settings_for

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
    assert ours.energy_j == pytest.approx(theirs.energy_j, rel=1e-9)
    assert ours.shortest.length_m == pytest.approx(theirs.shortest.length_m, rel=1e-3)
    details = ours.found.details
    assert ours.found.details["tiles"] > 0
    assert ours.energy_j <= details["grid_energy_j"] + 1e-6
    again = jm.planner.route.price_route(whole.lattice, ours.points)
    assert again.energy_j == pytest.approx(ours.energy_j, rel=1e-9)
    assert stored.at(50.0, 20.0).energy_per_m == pytest.approx(whole.at(50.0, 20.0).energy_per_m, nan_ok=True)


@pytest.mark.parametrize("seed", range(4))
def test_between_random_places_a_route_from_disk_is_that_of_the_map_in_memory(folder, seed):
    whole, stored = jm.open_costmap(folder), jm.open_costmap(folder, memory_gb=0.5)
    start, goal = np.random.default_rng(seed).uniform((3.0, 3.0), (97.0, 67.0), size=(2, 2)).tolist()
    ours, theirs = (ground.plan(start, goal, snap=True).energy_j for ground in (stored, whole))
    assert ours == pytest.approx(theirs, rel=1e-9)


def test_where_the_surroundings_are_too_large_only_the_corridor_of_the_grid_is_improved(folder, monkeypatch):
    whole, stored = jm.open_costmap(folder), jm.open_costmap(folder, memory_gb=0.5)
    monkeypatch.setattr(stored_planner, "_BYTES_PER_CELL", 1_000_000)
    ours, theirs = stored.plan(START, GOAL), whole.plan(START, GOAL)
    assert theirs.energy_j * (1.0 - 1e-3) <= ours.energy_j <= theirs.energy_j * 1.02
    assert ours.energy_j < ours.found.details["grid_energy_j"]


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
    with pytest.raises(InputError, match="bound"):
        stored.plan(START, GOAL, bound=True)
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


@pytest.fixture(scope="module")
def small_memory(tmp_path_factory, hill_tif):
    """A service that plans every route from disk, with one cost map."""
    settings = settings_for(tmp_path_factory.mktemp("data"), max_cells_in_memory=1, route_memory_gb=0.5)
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        heightmap = client.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif)}).json()["id"]
        asked = {"heightmap_id": heightmap, "model": "physics"}
        made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=60"}).json()["id"]
        client.app.state.service.maps.forget(made)  # the service keeps what it has just made
        yield client, f"/v1/costmaps/{made}"


def test_http_plans_from_disk(small_memory, client, costmap_id):
    stored, place = small_memory
    path = {"start": HTTP_START, "goal": HTTP_GOAL}
    ours = stored.post(f"{place}/paths", json=path).json()
    theirs = client.post(f"/v1/costmaps/{costmap_id}/paths", json=path).json()
    assert ours["energy_j"] == pytest.approx(theirs["energy_j"], rel=1e-3)
    verdict = stored.post(f"{place}/feasibility", json={**path, "round_trip": True}).json()
    assert verdict["out"]["energy_j"] == pytest.approx(ours["energy_j"], rel=1e-6)


def test_http_tells_the_progress_as_events(small_memory):
    stored, place = small_memory
    path = {"start": HTTP_START, "goal": HTTP_GOAL}
    answer = stored.post(f"{place}/paths", json=path, headers={"Accept": "text/event-stream"})
    names = [line[7:] for line in answer.text.splitlines() if line.startswith("event: ")]
    data = [line[6:] for line in answer.text.splitlines() if line.startswith("data: ")]
    assert set(names[:-1]) <= {"progress"}
    assert names[-1] == "answer"
    assert json.loads(data[-1])["energy_j"] > 0.0
    wrong = {**path, "goal": [0.0, 0.0]}
    answer = stored.post(f"{place}/paths", json=wrong, headers={"Accept": "text/event-stream"})
    assert "event: problem" in answer.text
    assert stored.post(f"{place}/paths", json=wrong).status_code == 422
