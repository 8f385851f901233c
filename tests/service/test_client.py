"""The client: the same answers and the same errors as the library, over HTTP; and the commands that use it."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model import errors
from joulemap.model.errors import InputError
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.loading import load_lattice
from joulemap.service.cli import app
from joulemap.service.client import service as client_of_a_service
from joulemap.service.client.connection import Connection, error_of, tree_of
from joulemap.service.client.costmap import ServedCostMap
from joulemap.service.commands.remote import unpack
from joulemap.service.http.app import create_app
from joulemap.service.problems import exit_code, problem_of
from joulemap.service.storage.owners import add_key
from tests.service.conftest import GOAL, IN_HOLE, START, hill, settings_for
from tests.service.test_calibrations import ROBOT, hills, run_csv
from tests.service.test_contract import served


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, dict[str, str]]]:
    """A service with keys: its address, and the keys of two owners."""
    service_app = create_app(settings_for(tmp_path_factory.mktemp("data")))
    with served(service_app) as url:
        sessions = service_app.state.service.store.sessions
        yield url, {name: add_key(sessions, name) for name in ("anna", "bert")}


@pytest.fixture(scope="module")
def client(running: tuple[str, dict[str, str]]) -> Iterator[jm.Client]:
    url, keys = running
    with jm.Client(url + "/", key=keys["anna"]) as found:
        yield found


@pytest.fixture(scope="module")
def costmap(client: jm.Client) -> Any:
    shares: list[float] = []
    made = client.costmap(hill(), robot={"mass_kg": 50.0}, model="physics", progress=shares.append, timeout_s=120.0)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return made


@pytest.fixture(scope="module")
def local() -> jm.CostMap:
    return jm.costmap(hill(), robot={"mass_kg": 50.0}, model="physics")


def test_answers_are_those_of_the_library(costmap: Any, local: jm.CostMap) -> None:
    route, here = (of.plan(START, GOAL, alternatives=1, bound=True) for of in (costmap, local))
    assert len(str(route)) < 2000  # without the points of the path
    assert route.energy_j == pytest.approx(here.energy_j, rel=1e-9)
    assert route.bound_j == pytest.approx(here.found.bound_j, rel=1e-9)
    assert route.shortest.length_m == pytest.approx(here.shortest.length_m, rel=1e-9)
    shares: list[float] = []
    assert costmap.plan(START, GOAL, alternatives=1, progress=shares.append).path == route.path
    assert shares == sorted(shares)
    for how in ({"charge": 0.6}, {"round_trip": True}, {"round_trip": True, "capacity_wh": 0.5}):
        verdict, mine = costmap.feasibility(route, **how), local.feasibility(here, **how)
        assert (verdict.energy_j, verdict.feasible) == (pytest.approx(mine.verdict.energy_j, rel=1e-9), bool(mine)), how
    assert costmap.feasibility(start=START, goal=GOAL).energy_j == pytest.approx(here.energy_j, rel=1e-9)
    stops = [START, GOAL, [START[0] + 10.0, START[1] - 8.0]]
    assert costmap.tour(stops).energy_j == pytest.approx(local.tour(stops).energy_j, rel=1e-9)
    assert len(costmap.at(START).energy_per_m) == 16
    assert costmap.data("npz")[:2] == b"PK"
    assert costmap.about.robot.mass_kg == 50.0


def test_errors_are_those_of_the_library(client: jm.Client, costmap: Any, local: jm.CostMap, tmp_path: Path) -> None:
    far = [START[0] + 1e5, START[1]]
    for ask in (
        lambda m: m.plan(START, IN_HOLE),
        lambda m: m.plan(far, GOAL),
        lambda m: m.feasibility([START, IN_HOLE]),
        lambda m: m.tour([START, IN_HOLE, GOAL]),
    ):
        with pytest.raises(jm.JoulemapError) as here:
            ask(local)
        with pytest.raises(jm.JoulemapError) as there:
            ask(costmap)
        assert (type(there.value), there.value.message) == (type(here.value), here.value.message)
        assert there.value.context["request_id"]
    with pytest.raises(errors.BlockedError):
        costmap.plan(START, IN_HOLE, progress=lambda _: None)
    with pytest.raises(errors.NotFoundError):
        client.open_costmap("cm-000000000000")
    with pytest.raises(errors.InputError, match="no id"):
        client.open_costmap("../heightmaps")
    with pytest.raises(errors.InputError, match="planner"):
        costmap.plan(START, GOAL, planner="fastest")
    (tmp_path / "no.tif").write_text("no heightmap")
    with pytest.raises(errors.HeightmapError):
        client.costmap(tmp_path / "no.tif")
    with pytest.raises(errors.ModelError):
        client.costmap(hill(), model="cal-000000000000")


def test_keys(running: tuple[str, dict[str, str]], costmap: Any) -> None:
    url, keys = running
    with jm.Client(url) as nobody, pytest.raises(errors.UnauthorizedError):
        nobody.open_costmap(costmap.id)
    with jm.Client(url, key=keys["bert"]) as other, pytest.raises(errors.NotFoundError):
        other.open_costmap(costmap.id)
    with pytest.raises(errors.InputError):
        jm.Client(url, key="schlüssel")


def test_no_service() -> None:
    with jm.Client("http://127.0.0.1:9") as nobody, pytest.raises(errors.BusyError, match="does not answer"):
        nobody.open_costmap("cm-000000000000")


def test_a_job_that_fails_raises_why(client: jm.Client, tmp_path: Path) -> None:
    (tmp_path / "run_01.csv").write_bytes(run_csv(0, metres=30.0))
    sent = client.runs(tmp_path / "run_01.csv")
    with pytest.raises(errors.RunsError, match="segments"):
        client.calibrate(hills(), sent, model="physics", robot=ROBOT, quick=True, timeout_s=200.0)
    with pytest.raises(errors.ConflictError):
        client.delete(sent)


def test_a_calibration(client: jm.Client, tmp_path: Path) -> None:
    files = [tmp_path / f"run_0{k}.csv" for k in (1, 2)]
    for k, file in enumerate(files):
        file.write_bytes(run_csv(k, metres=60.0))
    ground = client.heightmap(hills(), name="hills")
    sent = client.runs(files, heightmap=ground)
    assert [run.name for run in sent.runs] == [file.name for file in files]
    found = client.calibrate(ground, sent, model="physics", robot=ROBOT, quick=True, timeout_s=300.0)
    assert found.calibrated_model == found.id
    assert found.report
    for thing in (found, sent, ground):
        client.delete(thing)


@pytest.mark.parametrize("cls", list(tree_of(errors.JoulemapError)))
def test_every_error_comes_back_as_itself(cls: type[errors.JoulemapError]) -> None:
    if cls.__module__ != "joulemap.model.errors":
        pytest.skip("an error inside joulemap")
    error = error_of(json.loads(json.dumps(problem_of(cls("words", limit=3), "abc"))))
    assert (type(error), error.message) == (cls, "words")
    assert error.context == {"limit": 3, "request_id": "abc"}


@pytest.mark.parametrize(
    ("status", "body", "kind", "code"),
    [
        (302, b"", errors.InputError, 3),
        (400, b"", errors.InputError, 3),
        (401, b"", errors.UnauthorizedError, 9),
        (403, b"<html>Forbidden</html>", errors.ForbiddenError, 10),
        (404, b"[]", errors.NotFoundError, 5),
        (409, b"", errors.ConflictError, 6),
        (413, b"", errors.TooLargeError, 7),
        (413, b"<html>Request Entity Too Large</html>", errors.TooLargeError, 7),
        (422, b'{"code": "invalid_request", "detail": "x"}', errors.InputError, 3),
        (429, b'{"message": "slow down", "context": []}', errors.RateError, 11),
        (500, b"", errors.JoulemapError, 1),
        (500, b'{"code": "internal_error", "detail": "x", "context": {"message": "y"}}', errors.JoulemapError, 1),
        (502, b"<html>Bad Gateway</html>", errors.BusyError, 8),
        (503, b"", errors.BusyError, 8),
        (504, b"", errors.BusyError, 8),
        (507, b"", errors.StorageFullError, 12),
        (599, b"", errors.JoulemapError, 1),
    ],
)
def test_answers_that_are_no_problem_of_a_service(
    status: int, body: bytes, kind: type[errors.JoulemapError], code: int
) -> None:
    """Those of a proxy: the exit code is the table's for the status."""
    headers = {"Retry-After": "7", "Location": "https://login.example/sso"}
    transport = httpx.MockTransport(lambda _: httpx.Response(status, content=body, headers=headers))
    with jm.Client("http://proxy", transport=transport) as client, pytest.raises(kind) as found:
        client.open_costmap("cm-1")
    assert (type(found.value), exit_code(found.value)) == (kind, code)
    if status == 302:
        assert "sends requests on to https://login.example/sso" in found.value.message
    else:
        assert found.value.context["retry_after_s"] == 7.0
    if b"code" not in body and status not in (302, 599):
        assert f"http://proxy/v1/costmaps/cm-1 answered {status}" in found.value.message


@pytest.mark.parametrize(
    ("body", "media", "words"),
    [
        (b"<html>log in</html>", "text/html; charset=utf-8", "a web page"),
        (b"ok", "text/plain", "text/plain and no JSON"),
        (b"\xff\xfe", "application/json", "no JSON"),
        (b"[" * 100_000, "application/json", "no JSON"),
        (b'{"user": "anna"}', "application/json", "id: Field required"),
        (b"[]", "application/json", "the document: "),
    ],
)
def test_a_success_that_is_no_answer_of_a_service(body: bytes, media: str, words: str) -> None:
    answer = httpx.Response(200, content=body, headers={"Content-Type": media})
    with jm.Client("http://proxy", transport=httpx.MockTransport(lambda _: answer)) as client:
        with pytest.raises(errors.InputError, match="no answer of a joulemap service") as found:
            client.open_costmap("cm-1")
        assert words in found.value.message


def test_a_web_page_in_place_of_events_or_of_a_file(costmap: Any) -> None:
    page = httpx.Response(200, content=b"<html>log in</html>", headers={"Content-Type": "text/html"})
    text = httpx.Response(200, content=b"ok", headers={"Content-Type": "text/plain"})
    broken = httpx.Response(200, content=b"event: answer\ndata: {\n\n", headers={"Content-Type": "text/event-stream"})
    for answers, words in ((page, "a web page"), (text, "no events"), (broken, "an event that is no JSON")):
        connection = Connection("http://proxy", key=None, timeout_s=9.0, transport=transport_of(answers))
        with pytest.raises(errors.InputError, match=words):
            ServedCostMap(connection, costmap.about).plan(START, GOAL, progress=lambda _: None)
    served_map = ServedCostMap(
        Connection("http://proxy", key=None, timeout_s=9.0, transport=transport_of(page)), costmap.about
    )
    with pytest.raises(errors.InputError, match="a web page"):
        served_map.plan_file(START, GOAL, format="gpx")
    served_map = ServedCostMap(
        Connection("http://proxy", key=None, timeout_s=9.0, transport=transport_of(text)), costmap.about
    )
    with pytest.raises(errors.InputError, match="no GeoJSON"):
        served_map.plan_geojson(START, GOAL)


def transport_of(answer: httpx.Response) -> httpx.MockTransport:
    return httpx.MockTransport(lambda _: answer)


@pytest.mark.parametrize("url", ["http://[::1", "localhost:8000", "ftp://x", "nonsense", ""])
def test_an_address_that_is_none_is_said(url: str) -> None:
    with pytest.raises(errors.InputError, match=r"cannot be asked|is no address"), jm.Client(url) as client:
        client.open_costmap("cm-1")


def test_an_answer_that_cannot_be_decoded_is_no_traceback() -> None:
    answer = httpx.Response(200, headers={"Content-Encoding": "gzip"}, stream=httpx.ByteStream(b"no gzip"))
    with jm.Client("http://x", transport=transport_of(answer)) as client, pytest.raises(errors.BusyError):
        client.open_costmap("cm-1")


@pytest.mark.parametrize("status", [429, 502, None])
def test_a_job_whose_service_stays_away_is_given_up(
    costmap: Any, monkeypatch: pytest.MonkeyPatch, status: int | None
) -> None:
    """Behind a proxy that answers 502, or with no service any more: after a minute, here a quarter of a second."""
    monkeypatch.setattr(client_of_a_service, "_ABSENT_S", 0.25)
    waiting = costmap.about.model_copy(update={"status": "running", "progress": 0.5}).model_dump(mode="json")
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.method)
        if len(asked) == 1:
            return httpx.Response(202, json=waiting)
        if status is None:
            raise httpx.ConnectError("refused")
        return httpx.Response(status)

    kind = errors.RateError if status == 429 else errors.BusyError
    with (
        jm.Client("http://x", transport=httpx.MockTransport(answer)) as client,
        pytest.raises(kind, match=r"said nothing of cm-[0-9a-f]+ for 0 s; the job may go on") as found,
    ):
        client.costmap("hm-5f0c2a9d41be")
    assert found.value.context["job_id"] == costmap.id
    assert len(asked) > 3


def test_waiting_goes_on_when_the_service_is_busy(costmap: Any) -> None:
    """A job is asked for again after 429 and 503, as long as the time allows."""
    waiting = costmap.about.model_copy(update={"status": "running", "progress": 0.5}).model_dump(mode="json")
    busy = problem_of(errors.BusyError("restarts", retry_after_s=0.1))
    answers = [(202, waiting), (503, busy), (200, waiting), (200, costmap.about.model_dump(mode="json"))]
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.method)
        status, body = answers[len(asked) - 1]
        return httpx.Response(status, json=body)

    with jm.Client("http://x", transport=httpx.MockTransport(answer)) as client:
        shares: list[float] = []
        assert client.costmap("hm-5f0c2a9d41be", progress=shares.append).about == costmap.about
    assert asked == ["POST", "GET", "GET", "GET"]
    assert shares == [0.5, 0.5, 0.5, 1.0]


# the command line


def command(*words: object, key: str | None = None, monkeypatch: pytest.MonkeyPatch) -> int:
    if key is not None:
        monkeypatch.setenv("JOULEMAP_KEY", key)
    with pytest.raises(SystemExit) as ended:
        app([*map(str, words)])
    return int(ended.value.code or 0)


def test_commands_ask_a_service(
    running: tuple[str, dict[str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hill_tif: bytes
) -> None:
    url, keys = running
    monkeypatch.chdir(tmp_path)
    Path("dem.tif").write_bytes(hill_tif)
    ends = ("--start", f"{START[0]},{START[1]}", "--goal", f"{GOAL[0]},{GOAL[1]}")
    how = {"key": keys["anna"], "monkeypatch": monkeypatch}
    there = ("--server", url, "--json", "there.json")
    assert command("costmap", "dem.tif", "--model", "physics", "--out", "dem.zarr", "--json", "here.json", **how) == 0
    assert command("costmap", "dem.tif", "--model", "physics", *there, **how) == 0
    made, mine = json.loads(Path("there.json").read_text()), json.loads(Path("here.json").read_text())
    costmap_id = made["costmap_id"]
    assert {key: made[key] for key in ("rows", "cols", "bounds", "energy_per_m", "blocked")} == {
        key: mine[key] for key in ("rows", "cols", "bounds", "energy_per_m", "blocked")
    }
    assert command("costmap", "dem.tif", "--model", "physics", "--out", "served.zarr", "--server", url, **how) == 0
    for name, options in (
        ("path", ends),
        ("feasibility", (*ends, "--round-trip", "--charge", "0.7")),
        ("tour", ("--stop", ends[1], ends[3], f"{START[0] + 10},{START[1] - 8}")),
    ):
        assert command(name, "dem.zarr", *options, "--json", "here.json", **how) == 0, name
        assert command(name, costmap_id, *options, *there, **how) == 0, name
        assert command(name, "served.zarr", *options, "--json", "served.json", **how) == 0, name
        found, mine, served_map = (json.loads(Path(f"{k}.json").read_text()) for k in ("there", "here", "served"))
        assert found["energy_j"] == pytest.approx(mine["energy_j"], rel=1e-9), name
        assert served_map["energy_j"] == pytest.approx(mine["energy_j"], rel=1e-9), name
        assert found.keys() == mine.keys(), name
    line = ("--path", "line.csv")
    Path("line.csv").write_text(f"x,y\n{START[0]},{START[1]}\n{START[0] + 2},{START[1]}\n")
    assert command("feasibility", costmap_id, *line, *there, **how) == 0
    assert command("feasibility", "dem.zarr", *line, "--json", "here.json", **how) == 0
    found, mine = (json.loads(Path(f"{k}.json").read_text()) for k in ("there", "here"))
    assert found["energy_j"] == pytest.approx(mine["energy_j"], rel=1e-9)
    assert command("path", costmap_id, *ends, "--server", url, "--geojson", "there.geojson", **how) == 0
    assert command("path", "dem.zarr", *ends, "--geojson", "here.geojson", **how) == 0
    lines = [json.loads(Path(f"{k}.geojson").read_text())["features"] for k in ("there", "here")]
    assert [line["geometry"] for line in lines[0]] == [line["geometry"] for line in lines[1]]


def test_commands_fail_as_without_a_service(
    running: tuple[str, dict[str, str]],
    costmap: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    url, keys = running
    how = {"key": keys["anna"], "monkeypatch": monkeypatch}
    ends = ("--start", f"{START[0]},{START[1]}", "--goal", f"{IN_HOLE[0]},{IN_HOLE[1]}")
    assert command("path", costmap.id, *ends, "--server", url, **how) == 4
    assert "--snap goes there" in capsys.readouterr().err
    assert command("path", "cm-000000000000", *ends, "--server", url, **how) == 5
    assert command("path", costmap.id, *ends, "--server", url, "--key", keys["bert"], monkeypatch=monkeypatch) == 5
    assert command("path", costmap.id, *ends, "--server", url, "--key", "x", monkeypatch=monkeypatch) == 9
    assert command("path", costmap.id, *ends, "--server", "http://127.0.0.1:9", **how) == 8
    assert command("path", costmap.id, *ends, **how) == 5  # no folder is called so
    assert command("path", costmap.id, *ends, "--server", url, "--picture", "x.png", **how) == 2
    assert command("costmap", "dem.tif", **how) in (2, 5)


def zipped(**files: bytes) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return held.getvalue()


# named here: an archive holds the time it was made, and every process of a parallel run must call a test the same
@pytest.mark.parametrize(
    "sent",
    [b"<html>log in</html>", zipped(**{"m/a": b"1"})[:-9], zipped(**{"m/a": b"1", "../b": b"2"})],
    ids=["a page", "cut short", "a file outside the folder"],
)
def test_what_is_no_cost_map_replaces_none(tmp_path: Path, local: jm.CostMap, sent: bytes) -> None:
    place = local.save(tmp_path / "good.zarr")
    with pytest.raises(InputError, match="the service sent"):
        unpack(sent, place)
    assert [path.name for path in tmp_path.iterdir()] == ["good.zarr"]
    assert load_lattice(place).frame.rows == hill().frame.rows


def test_a_folder_of_something_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "text").write_text("x")
    with pytest.raises(InputError, match="will not be overwritten"):
        unpack(zipped(**{"m/zarr.json": b"{}"}), tmp_path / "thesis")
    assert [path.name for path in tmp_path.rglob("*")] == ["thesis", "text"]


def test_files_of_layers_are_sent(running: tuple[str, dict[str, str]], client: jm.Client, tmp_path: Path) -> None:
    """Mud as a raster and a deck as polygons, from Python and from the command line: the same cost map."""
    ground, legend = hill(), tmp_path / "land.toml"
    west, south, _, north = ground.frame.bounds
    land = jm.heightmap(np.full(ground.frame.shape, 2.0), resolution_m=ground.resolution_m, west_m=west, north_m=north)
    write_geotiff(tmp_path / "dem.tif", ground)
    write_geotiff(tmp_path / "land.tif", land)
    legend.write_text("[mud]\nvalue = 2\nrolling_resistance = 0.3\n")
    ring = [[west + 2, south + 2], [west + 6, south + 2], [west + 6, south + 6], [west + 2, south + 6]]
    deck = {"type": "Feature", "properties": {"height": 3.5}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    (tmp_path / "deck.geojson").write_text(json.dumps(deck))
    layers = {"kinds": tmp_path / "land.tif", "height": tmp_path / "deck.geojson"}
    made = client.costmap(tmp_path / "dem.tif", model="physics", layers=layers, legend=legend)
    there = unpack_to(made.data("zarr"), tmp_path / "there.zarr")
    assert there.elevation_m[there.frame.rows - 5, 4] == pytest.approx(3.5)
    assert [layer["role"] for layer in there.provenance["layers"]] == ["kinds", "height"]
    url, keys = running
    mine = client.heightmap(tmp_path / "land.tif", layer=True)
    with jm.Client(url, key=keys["bert"]) as other, pytest.raises(errors.NotFoundError):
        other.costmap(tmp_path / "dem.tif", model="physics", layers={"factor": mine})
    words = ["costmap", str(tmp_path / "dem.tif"), "--model", "physics", "--legend", str(legend), "--server", url]
    words += [word for role, file in layers.items() for word in ("--layer", f"{role}={file}")]
    done = CliRunner().invoke(app, [*words, "--key", keys["anna"], "--out", str(tmp_path / "here.zarr")])
    assert done.exit_code == 0, done.output
    assert np.array_equal(load_lattice(tmp_path / "here.zarr").traction_per_m, there.traction_per_m, equal_nan=True)


def unpack_to(zipped: bytes, folder: Path) -> Any:
    unpack(zipped, folder)
    return load_lattice(folder)
