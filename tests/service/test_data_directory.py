"""A data directory is verified, repaired, copied while its service runs, put back, and kept within its limits."""

from __future__ import annotations

import contextlib
import datetime as dt
import io
import json
import os
import random
import re
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from joulemap.model.errors import ConflictError, InputError
from joulemap.model.robot import Robot
from joulemap.service.cli import app
from joulemap.service.http.app import create_app
from joulemap.service.storage import backup as backing_up
from joulemap.service.storage.backup import back_up, restore
from joulemap.service.storage.files import MODEL_SUMS, sums_of
from joulemap.service.storage.owners import add_key, all_keys
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import (
    DONE,
    QUEUED,
    RUNNING,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    RunsRow,
    now,
)
from tests.service.conftest import GOAL, START, settings_for
from tests.service.test_calibrations import run_csv
from tests.service.test_restart import wait_until
from tests.service.workers import fingerprint, postgres, postgres_programs

CALIBRATION = "cal-0123456789ab"


def opened(folder: Path, **how: Any) -> Store:
    store = Store(folder, f"sqlite:///{folder / 'joulemap.db'}")
    store.open(**{"as_service": False, **how})
    return store


def joulemap(*words: object) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON of a command in this process; of one that failed, what it wrote on stderr."""
    errors = io.StringIO()
    with tempfile.NamedTemporaryFile() as document:
        with pytest.raises(SystemExit) as ended, contextlib.redirect_stderr(errors):
            app([*map(str, words), "--json", document.name])
        found = Path(document.name).read_text(encoding="utf-8")
    return int(ended.value.code or 0), json.loads(found) if found else {"error": errors.getvalue()}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory, hill_tif: bytes) -> dict[str, Any]:
    """A data directory with one thing of each kind, after its service has stopped, and the ids."""
    folder = tmp_path_factory.mktemp("kept")
    with TestClient(create_app(settings_for(folder))) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        asked = {"heightmap_id": heightmap, "model": "physics"}
        answer = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=120"})
        assert answer.status_code == 201, answer.text
        runs = client.post("/v1/runs", content=run_csv(0, metres=30.0)).json()["id"]
        store = client.app.state.service.store  # type: ignore[attr-defined]
        request = {"runs": [runs], "base_runs": [], "test_runs": [], "model": "physics", "robot": Robot().as_dict()}
        row = CalibrationRow(
            id=CALIBRATION,
            created_at=dt.datetime(2026, 1, 1),
            heightmap_id=heightmap,
            request={**request, "start": None, "goal": None, "seed": 0},
            status=DONE,
            progress=1.0,
            finished_at=dt.datetime(2026, 1, 1),
            summary={"report": {}, "model": CALIBRATION},
        )
        with store.sessions.begin() as session:
            session.add(row)
        add_key(store.sessions, "anna")
    for place in (folder / "calibrations" / CALIBRATION, folder / "models" / CALIBRATION, folder / "models" / "mine"):
        place.mkdir(parents=True)
        (place / "report.json").write_text("{}")
    model = folder / "models" / CALIBRATION
    (model / "network.bin").write_bytes(bytes(range(256)))
    (folder / "calibrations" / CALIBRATION / MODEL_SUMS).write_text(json.dumps(sums_of(model)))
    (folder / "calibrations" / CALIBRATION / "report.html").write_text("<html>" + "x" * 100_000)
    return {"folder": folder, "heightmap": heightmap, "costmap": answer.json()["id"], "runs": runs}


def test_what_was_committed_reaches_the_database_without_a_commit_that_waits(tmp_path: Path) -> None:
    """SQLite's log is written to it beside the requests, long before a commit would have to."""
    store = opened(tmp_path, as_service=True)
    file = tmp_path / "joulemap.db"
    try:
        before = file.stat().st_size
        with store.sessions.begin() as session:
            session.add(HeightmapRow(id="hm-0123456789ab", created_at=now(), name="x" * 100_000, stats={}))
        wait_until(lambda: file.stat().st_size >= before + 100_000)
    finally:
        store.close()


@pytest.fixture
def copied(kept: dict[str, Any], tmp_path: Path) -> dict[str, Any]:
    """A copy of one's own."""
    shutil.copytree(kept["folder"], tmp_path / "data")
    return {**kept, "folder": tmp_path / "data"}


def test_a_whole_directory_has_no_findings(kept: dict[str, Any]) -> None:
    before = sorted(path for path in kept["folder"].rglob("*") if "costmaps" in path.parts)
    assert joulemap("check", "--data-dir", kept["folder"]) == (0, {"findings": [], "left": 0})
    assert sorted(path for path in kept["folder"].rglob("*") if "costmaps" in path.parts) == before


def sql(command: str) -> Callable[[dict[str, Any]], None]:
    def _do(kept: dict[str, Any]) -> None:
        with sqlite3.connect(kept["folder"] / "joulemap.db") as database:
            assert database.execute(command).rowcount == 1

    return _do


def chunk_of(kept: dict[str, Any]) -> Path:
    folder = kept["folder"] / "costmaps" / f"{kept['costmap']}.zarr" / "traction_per_m" / "c"
    return max((path for path in folder.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def spoil(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 3 : 2 * len(data) // 3] = b"\xff" * (2 * len(data) // 3 - len(data) // 3)
    path.write_bytes(data)


def flip(path: Path) -> None:
    """Change one bit, as a disk does that grows old: the size stays."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def run_of(kept: dict[str, Any]) -> Path:
    return next((kept["folder"] / "runs" / kept["runs"]).iterdir())


def tif(kept: dict[str, Any]) -> Path:
    return kept["folder"] / "heightmaps" / f"{kept['heightmap']}.tif"


def make(*parts: str) -> Callable[[dict[str, Any]], None]:
    def _do(kept: dict[str, Any]) -> None:
        path = kept["folder"].joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")

    return _do


DAMAGES: dict[str, tuple[str, bool, Callable[[dict[str, Any]], object]]] = {
    # what is done to the directory: kind of the finding, whether it can be repaired, the damage
    "heightmap lost": ("missing", True, lambda kept: tif(kept).unlink()),
    "heightmap cut": ("damaged", True, lambda kept: cut(tif(kept))),
    "cost map lost": ("missing", True, lambda kept: shutil.rmtree(chunk_of(kept).parents[4])),
    "chunk lost": ("damaged", True, lambda kept: chunk_of(kept).unlink()),
    "report cut": ("damaged", True, lambda kept: cut(kept["folder"] / "calibrations" / CALIBRATION / "report.json")),
    "calibration lost": ("missing", True, lambda kept: shutil.rmtree(kept["folder"] / "calibrations" / CALIBRATION)),
    "model lost": ("damaged", True, lambda kept: shutil.rmtree(kept["folder"] / "models" / CALIBRATION)),
    "bit of a model": ("damaged", True, lambda kept: flip(kept["folder"] / "models" / CALIBRATION / "network.bin")),
    "run lost": ("damaged", True, lambda kept: run_of(kept).unlink()),
    "bit of a run": ("damaged", True, lambda kept: flip(run_of(kept))),
    "bit of a chunk": ("damaged", True, lambda kept: flip(chunk_of(kept))),
    "stats no JSON": ("unreadable", True, sql("update heightmaps set stats = '{\"rows\": '")),
    "stats not finite": (
        "unreadable",
        True,
        sql("update heightmaps set stats = json_set(stats, '$.resolution_m', 'x')"),
    ),
    "summary no JSON": ("unreadable", True, sql("update costmaps set summary = '{'")),
    "request no JSON": ("unreadable", True, sql("update costmaps set request = '{'")),
    "request without robot": ("unreadable", True, sql("update costmaps set request = '{}', summary = null")),
    "time of a cost map": ("unreadable", True, sql("update costmaps set created_at = 12")),
    "runs no JSON": ("unreadable", True, sql("update runs set stats = '['")),
    "calibration no JSON": ("unreadable", True, sql("update calibrations set summary = 'x'")),
    "calibration without runs": ("unreadable", True, sql("update calibrations set request = '{}'")),
    "strange heightmap": ("orphan", True, make("heightmaps", "hm-ffffffffffff.tif")),
    "strange calibration": ("orphan", True, make("calibrations", "cal-ffffffffffff", "report.json")),
    "strange model": ("orphan", True, make("models", "cal-ffffffffffff", "config.json")),
    "upload of a killed process": ("partial", True, make("uploads", "0123", "45")),
    "half a cost map": ("partial", True, make("costmaps", "cm-ffffffffffff.zarr.partial", "zarr.json")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damage_is_found_and_repaired(copied: dict[str, Any], damage: str) -> None:
    kind, repairable, do = DAMAGES[damage]
    do(copied)
    code, found = joulemap("check", "--data-dir", copied["folder"])
    assert code == 1, found
    assert kind in {one["kind"] for one in found["findings"]}, found
    assert not any(one["repaired"] for one in found["findings"])
    assert joulemap("check", "--data-dir", copied["folder"]) == (code, found), "a look changes nothing"
    code, repaired = joulemap("check", "--repair", "--data-dir", copied["folder"])
    assert code == (0 if repairable else 1), repaired
    assert {(one["kind"], one["what"]) for one in repaired["findings"]} >= {
        (one["kind"], one["what"]) for one in found["findings"]
    }
    code, left = joulemap("check", "--data-dir", copied["folder"])
    assert (code == 0) == repairable, left
    assert (copied["folder"] / "models" / "mine").is_dir()
    with sqlite3.connect(copied["folder"] / "joulemap.db") as database:
        for table in ("heightmaps", "runs", "costmaps", "calibrations"):
            gone = database.execute(f"select count(*) from {table}").fetchone() == (0,)
            assert gone == (damage in REMOVED_ROWS.get(table, ())), table
    if kind == "orphan" or any(damage in some for some in REMOVED_ROWS.values()):
        assert any(path.is_file() for path in (copied["folder"] / "removed").rglob("*")), "moved, not deleted"


REMOVED_ROWS = {
    "costmaps": ("request no JSON", "request without robot", "time of a cost map"),
    "runs": ("runs no JSON",),
    "calibrations": ("calibration without runs",),
}


def test_a_changed_bit_is_said_with_its_place_and_what_an_older_version_kept_is_not_compared(
    copied: dict[str, Any],
) -> None:
    flip(run_of(copied))
    flip(chunk_of(copied))
    _, found = joulemap("check", "--data-dir", copied["folder"])
    said = {one["what"]: one["words"] for one in found["findings"]}
    run = f"runs/{copied['runs']}/{run_of(copied).name}"
    assert said[copied["runs"]] == f"{run}: the content is not what was kept"
    assert said[copied["costmap"]].startswith(f"costmaps/{copied['costmap']}.zarr")
    assert "traction_per_m" in said[copied["costmap"]]
    sql("update runs set sums = null")(copied)
    assert copied["runs"] not in {
        one["what"] for one in joulemap("check", "--data-dir", copied["folder"])[1]["findings"]
    }


def test_a_damaged_cost_map_is_made_again_the_same(copied: dict[str, Any]) -> None:
    place = copied["folder"] / "costmaps" / f"{copied['costmap']}.zarr"
    before = fingerprint(place)
    chunk_of(copied).unlink()
    assert joulemap("check", "--repair", "--data-dir", copied["folder"])[0] == 0
    assert not place.exists()
    settings = settings_for(copied["folder"])
    with TestClient(create_app(settings)) as client, sqlite3.connect(copied["folder"] / "joulemap.db") as database:
        database.execute("delete from keys")
        database.commit()
        kept = client.app.state.service.store  # type: ignore[attr-defined]
        wait_until(lambda: kept.status(copied["costmap"]) == DONE)
    assert fingerprint(place) == before
    assert joulemap("check", "--data-dir", copied["folder"])[0] == 0


def test_what_was_sent_and_is_damaged_is_put_away_and_said(copied: dict[str, Any]) -> None:
    """Who asks for it is told what was wrong; what was made from it is answered as before."""
    wrong = {"heightmaps": copied["heightmap"], "runs": copied["runs"]}
    flip(tif(copied))
    flip(run_of(copied))
    code, found = joulemap("check", "--repair", "--data-dir", copied["folder"])
    assert (code, {one["what"] for one in found["findings"]}) == (0, set(wrong.values())), found
    with sqlite3.connect(copied["folder"] / "joulemap.db") as database:
        database.execute("delete from keys")
    with TestClient(create_app(settings_for(copied["folder"]))) as client:
        for kind, row_id in wrong.items():
            answer = client.get(f"/v1/{kind}/{row_id}")
            assert (answer.status_code, "send it again" in answer.json()["detail"]) == (404, True), answer.text
            (listed,) = client.get(f"/v1/{kind}").json()["items"]
            assert listed["problem"]["detail"] == answer.json()["detail"]
            assert json.loads((copied["folder"] / "removed" / f"{row_id}.json").read_text())["gone"]
            assert any((copied["folder"] / "removed" / kind).iterdir())
        asked = {"heightmap_id": copied["heightmap"], "model": "physics", "headings": 8}
        assert client.post("/v1/costmaps", json=asked).status_code == 404
        place = f"/v1/costmaps/{copied['costmap']}"
        assert client.post(f"{place}/paths", json={"start": START, "goal": GOAL}).status_code == 200
        assert client.delete(place).status_code == 204
        assert client.delete(f"/v1/calibrations/{CALIBRATION}").status_code == 204
        assert [client.delete(f"/v1/{kind}/{row_id}").status_code for kind, row_id in wrong.items()] == [204, 204]


@pytest.mark.parametrize("seed", range(4))
def test_whatever_happens_to_its_files_a_check_ends_and_a_second_repair_finds_nothing_new(
    copied: dict[str, Any], seed: int
) -> None:
    draw = random.Random(seed)
    files = [p for p in copied["folder"].rglob("*") if p.is_file() and p.name not in ("joulemap.db", "lock")]
    for path in draw.sample(sorted(files), 4):
        draw.choice([Path.unlink, cut, spoil, lambda path: path.write_bytes(b"")])(path)
    code, first = joulemap("check", "--repair", "--data-dir", copied["folder"])
    assert code in (0, 1), first
    code, second = joulemap("check", "--repair", "--data-dir", copied["folder"])
    assert {one["what"] for one in second["findings"] if one["repaired"]} == set()
    assert second["left"] == first["left"]


@pytest.mark.parametrize(
    ("table", "column", "remedy"),
    [("heightmaps", "stats", "read its file again"), ("costmaps", "summary", "make it again")]
    + [(table, "sums", "take them of its files again") for table in ("heightmaps", "runs", "costmaps")],
)
def test_a_digit_of_the_database_that_changed_is_no_other_number(
    copied: dict[str, Any], table: str, column: str, remedy: str
) -> None:
    with sqlite3.connect(copied["folder"] / "joulemap.db") as database:
        (before,) = database.execute(f"select {column} from {table}").fetchone()
        at = next(found.start() for found in re.finditer(r"\d", before))
        after = f"{before[:at]}{int(before[at]) ^ 1}{before[at + 1 :]}"
        database.execute(f"update {table} set {column} = ?", [after])
    code, found = joulemap("check", "--repair", "--data-dir", copied["folder"])
    assert (code, [one["remedy"] for one in found["findings"]]) == (0, [remedy]), found
    assert "not what was written" in found["findings"][0]["words"]
    assert joulemap("check", "--data-dir", copied["folder"]) == (0, {"findings": [], "left": 0})


@pytest.mark.parametrize("what", ["heightmap", "runs"])
def test_a_damaged_file_is_no_source_of_numbers(copied: dict[str, Any], what: str) -> None:
    flip(run_of(copied) if what == "runs" else tif(copied))
    sql("delete from keys")(copied)
    with TestClient(create_app(settings_for(copied["folder"])), raise_server_exceptions=False) as client:
        asked: dict[str, Any] = {"heightmap_id": copied["heightmap"], "model": "physics"}
        asked |= {"runs": [copied["runs"]], "quick": True} if what == "runs" else {"spacing_m": 2.0}
        path = "/v1/calibrations" if what == "runs" else "/v1/costmaps"
        made = client.post(path, json=asked, headers={"Prefer": "wait=60"}).json()
        said = made.get("problem") or made
    assert (said["code"], "its content is not what was kept" in said["detail"]) == ("damaged", True), said


def test_a_repair_needs_the_directory_alone_and_a_look_does_not(copied: dict[str, Any]) -> None:
    store = opened(copied["folder"], as_service=True)
    with store.upload_file() as begun:
        begun.write_text("an upload that goes on")
        assert joulemap("check", "--data-dir", copied["folder"]) == (0, {"findings": [], "left": 0})
        code, found = joulemap("check", "--repair", "--data-dir", copied["folder"])
        assert (code, "another joulemap" in found["error"]) == (6, True), found
        assert begun.exists()
    store.close()
    assert joulemap("check", "--repair", "--data-dir", copied["folder"])[0] == 0


def test_a_database_that_is_none(copied: dict[str, Any]) -> None:
    (copied["folder"] / "joulemap.db").write_text("no database at all, " * 100)
    code, found = joulemap("check", "--data-dir", copied["folder"])
    assert code == 3
    assert "database" in found["error"]
    assert "Traceback" not in found["error"]


# copies


def rows_of(folder: Path) -> dict[str, list[Any]]:
    with sqlite3.connect(folder / "joulemap.db") as database:
        tables = ("heightmaps", "runs", "costmaps", "calibrations", "keys")
        return {table: database.execute(f"select * from {table} order by 1").fetchall() for table in tables}


def files_of(folder: Path) -> dict[str, bytes]:
    kinds = ("heightmaps", "runs", "costmaps", "calibrations", "models")
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for kind in kinds
        for path in sorted((folder / kind).rglob("*"))
        if path.is_file()
    }


def test_a_copy_of_a_running_service_is_put_back_as_it_was(copied: dict[str, Any], tmp_path: Path) -> None:
    store = opened(copied["folder"], as_service=True)
    with store.sessions.begin() as session:
        session.add(
            CostmapRow(
                id="cm-0a0a0a0a0a0a",
                created_at=dt.datetime(2026, 2, 2),
                heightmap_id=copied["heightmap"],
                request=session.get(CostmapRow, copied["costmap"]).request,
                status=RUNNING,
                progress=0.4,
            )
        )
    code, made = joulemap("backup", tmp_path / "copy", "--data-dir", copied["folder"])
    assert code == 0, made
    assert made["rows"] == {"heightmaps": 1, "runs": 1, "costmaps": 2, "calibrations": 1, "drives": 0, "keys": 1}
    store.close()
    code, put_back = joulemap("restore", tmp_path / "copy", "--data-dir", tmp_path / "again")
    assert code == 0, put_back
    assert rows_of(tmp_path / "again") == rows_of(copied["folder"])
    assert files_of(tmp_path / "again") == files_of(copied["folder"])
    assert joulemap("check", "--data-dir", tmp_path / "again") == (0, {"findings": [], "left": 0})
    code, refused = joulemap("restore", tmp_path / "copy", "--data-dir", tmp_path / "again")
    assert (code, "already" in refused["error"]) == (6, True)
    code, refused = joulemap("backup", tmp_path / "copy", "--data-dir", copied["folder"])
    assert (code, "already" in refused["error"]) == (6, True)


def test_what_is_deleted_while_it_is_copied_is_not_in_the_copy(
    copied: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process deletes the cost map between two of its files, and then the calibration and the heightmap."""
    store = opened(copied["folder"])
    copy, seen = backing_up._copy, []

    def deleting(source: Path, target: Path) -> tuple[int, str]:
        found = copy(source, target)
        seen.append(copied["costmap"] in str(source))
        if seen[-1] and sum(seen) == 3:
            store.delete_costmap(copied["costmap"])
            with store.sessions.begin() as session:
                session.delete(session.get(CalibrationRow, CALIBRATION))
            shutil.rmtree(copied["folder"] / "calibrations" / CALIBRATION)
            store.delete_heightmap(copied["heightmap"])
        return found

    monkeypatch.setattr(backing_up, "_copy", deleting)
    manifest = back_up(store, tmp_path / "copy", models_dir=copied["folder"] / "models")
    store.close()
    assert manifest["rows"] == {"heightmaps": 1, "runs": 1, "costmaps": 0, "calibrations": 0, "drives": 0, "keys": 1}
    assert not any("costmaps" in place for place in manifest["files"])
    assert not (tmp_path / "copy" / "costmaps" / f"{copied['costmap']}.zarr").exists()
    again = opened(tmp_path / "again", as_service=True, alone=True)
    restore(tmp_path / "copy", again, tmp_path / "again", models_dir=tmp_path / "again" / "models")
    again.close()
    assert joulemap("check", "--data-dir", tmp_path / "again") == (0, {"findings": [], "left": 0})


def test_a_copy_that_fails_leaves_nothing(copied: dict[str, Any], tmp_path: Path) -> None:
    chunk_of(copied).unlink()
    shutil.rmtree(copied["folder"] / "runs" / copied["runs"])
    store = opened(copied["folder"])
    with pytest.raises(FileNotFoundError):
        back_up(store, tmp_path / "copy", models_dir=copied["folder"] / "models")
    store.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data"]


@pytest.mark.parametrize("where", ["file", "database", "manifest", "lost", "outside"])
def test_a_damaged_copy_is_not_put_back(copied: dict[str, Any], tmp_path: Path, where: str) -> None:
    store = opened(copied["folder"])
    back_up(store, tmp_path / "copy", models_dir=copied["folder"] / "models")
    store.close()
    copy = tmp_path / "copy"
    if where == "file":
        spoil(copy / "heightmaps" / f"{copied['heightmap']}.tif")
    elif where == "database":
        cut(copy / "joulemap.db")
    elif where == "manifest":
        cut(copy / "backup.json")
    elif where == "lost":
        next((copy / "runs" / copied["runs"]).iterdir()).unlink()
    else:
        manifest = json.loads((copy / "backup.json").read_text())
        manifest["files"]["../outside"] = [1, "0"]
        (copy / "backup.json").write_text(json.dumps(manifest))
    again = opened(tmp_path / "again", as_service=True, alone=True)
    with pytest.raises(InputError):
        restore(copy, again, tmp_path / "again", models_dir=tmp_path / "again" / "models")
    assert all_keys(again.sessions) == []
    again.close()
    assert not files_of(tmp_path / "again")


@pytest.mark.skipif(postgres_programs() is None, reason="no PostgreSQL on this machine")
def test_a_copy_goes_from_sqlite_to_postgresql_and_back(copied: dict[str, Any], tmp_path: Path) -> None:
    store = opened(copied["folder"])
    back_up(store, tmp_path / "one", models_dir=copied["folder"] / "models")
    store.close()
    with postgres(55_437) as url:
        there = Store(tmp_path / "there", url)
        there.open(as_service=True, alone=True)
        restore(tmp_path / "one", there, tmp_path / "there", models_dir=tmp_path / "there" / "models")
        with pytest.raises(ConflictError):
            restore(tmp_path / "one", there, tmp_path / "there", models_dir=tmp_path / "there" / "models")
        back_up(there, tmp_path / "two", models_dir=tmp_path / "there" / "models")
        there.close()
    again = opened(tmp_path / "again", as_service=True, alone=True)
    restore(tmp_path / "two", again, tmp_path / "again", models_dir=tmp_path / "again" / "models")
    with opened(copied["folder"]).sessions() as one, again.sessions() as two:
        for table in (HeightmapRow, RunsRow, CostmapRow, CalibrationRow):
            columns = table.__table__.columns.keys()
            first, second = (
                [{name: getattr(row, name) for name in columns} for row in session.scalars(select(table))]
                for session in (one, two)
            )
            assert first == second
    again.close()
    assert files_of(tmp_path / "again") == files_of(copied["folder"])


# what is kept how long


NOW = dt.datetime(2026, 6, 1, 12)


@pytest.fixture
def full(kept: dict[str, Any], tmp_path: Path) -> Iterator[tuple[TestClient, dict[str, str]]]:
    """A service whose cost maps were used 40, 30, 20 and 10 days ago; one more waits and one runs, both for long."""
    shutil.copytree(kept["folder"], tmp_path / "data")
    with sqlite3.connect(tmp_path / "data" / "joulemap.db") as database:
        database.execute("delete from keys")
        database.execute("delete from calibrations")
    settings = settings_for(tmp_path / "data", workers=0)
    with TestClient(create_app(settings)) as client:
        store = client.app.state.service.store  # type: ignore[attr-defined]
        with store.sessions.begin() as session:
            first = session.get(CostmapRow, kept["costmap"])
            values = {"heightmap_id": kept["heightmap"], "request": first.request, "bytes": 1000, "progress": 1.0}
            long_ago = NOW - dt.timedelta(days=400)
            for days in (40, 30, 20, 10):
                at = NOW - dt.timedelta(days=days)
                session.add(
                    CostmapRow(
                        id=f"cm-{days}", created_at=long_ago, finished_at=long_ago, used_at=at, status=DONE, **values
                    )
                )
            for status in (QUEUED, RUNNING):
                session.add(CostmapRow(id=f"cm-{status}", created_at=long_ago, status=status, **values))
            for table in (HeightmapRow, RunsRow, CostmapRow):
                session.execute(
                    update(table).where(table.id.in_(list(kept.values())[1:])).values(created_at=long_ago, used_at=None)
                )
            session.execute(update(CostmapRow).where(CostmapRow.id == kept["costmap"]).values(finished_at=long_ago))
        yield client, kept


def swept(client: TestClient, **limits: Any) -> list[str]:
    from joulemap.service.storage.retention import remove_unused

    service = client.app.state.service  # type: ignore[attr-defined]
    return remove_unused(
        service.store, service.retention._delete, now=NOW, **{"days": None, "most_bytes": None, **limits}
    )


def test_what_was_used_longest_ago_goes_first(full: tuple[TestClient, dict[str, str]]) -> None:
    client, kept = full
    store = client.app.state.service.store  # type: ignore[attr-defined]
    with store.sessions() as session:
        all_bytes = sum(sum(session.scalars(select(t.bytes))) for t in (HeightmapRow, RunsRow, CostmapRow))
    assert swept(client, most_bytes=all_bytes) == []
    first_bytes = store.costmap(kept["costmap"]).bytes
    assert swept(client, most_bytes=all_bytes - 1) == [kept["costmap"]]  # never used since it was made
    assert swept(client, most_bytes=all_bytes - first_bytes - 1001) == ["cm-40", "cm-30"]
    assert not store.lattice_path(kept["costmap"]).exists()
    assert client.get(f"/v1/costmaps/{kept['costmap']}").status_code == 404
    assert swept(client, most_bytes=1) == ["cm-20", "cm-10"]  # what was sent stays, and what is at work
    assert {row["id"] for row in client.get("/v1/costmaps").json()["items"]} == {"cm-queued", "cm-running"}
    assert client.get("/v1/heightmaps").json()["total"] == client.get("/v1/runs").json()["total"] == 1


def test_what_was_not_used_for_so_long_goes(full: tuple[TestClient, dict[str, str]]) -> None:
    client, kept = full
    assert swept(client, days=1000) == []
    assert swept(client, days=25) == [kept["costmap"], "cm-40", "cm-30", kept["runs"]]  # the heightmap is needed
    assert not (client.app.state.service.store.path(RunsRow, kept["runs"])).exists()  # type: ignore[attr-defined]
    for at_work in ("cm-queued", "cm-running"):
        assert client.delete(f"/v1/costmaps/{at_work}").status_code == 204
    assert swept(client, days=1) == ["cm-20", "cm-10", kept["heightmap"]]
    assert client.get("/v1/heightmaps").json()["total"] == 0


def test_a_question_is_a_use(full: tuple[TestClient, dict[str, str]]) -> None:
    client, kept = full
    service = client.app.state.service  # type: ignore[attr-defined]
    assert client.get(f"/v1/costmaps/{kept['costmap']}/provenance").status_code == 200
    service.retention.note()
    used = service.store.costmap(kept["costmap"]).used_at
    assert abs((used - dt.datetime.now(dt.UTC).replace(tzinfo=None)).total_seconds()) < 60
    assert kept["costmap"] not in swept(client, most_bytes=1), "just used"


def test_a_service_sweeps_by_itself(kept: dict[str, Any], tmp_path: Path) -> None:
    shutil.copytree(kept["folder"], tmp_path / "data")
    with sqlite3.connect(tmp_path / "data" / "joulemap.db") as database:
        database.execute("delete from keys")
        database.execute(
            "update costmaps set created_at = '2020-01-01 00:00:00', finished_at = '2020-01-01 00:00:00', bytes = null"
        )
    with TestClient(create_app(settings_for(tmp_path / "data", retention_gb=1e-9, workers=0))) as client:
        wait_until(lambda: not client.get("/v1/costmaps").json()["total"])
        assert client.get("/v1/calibrations").json()["total"] == 1


def test_a_copy_is_restored_into_an_object_store(
    kept: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which is all that is needed: the data folder has nothing but copies."""
    assert joulemap("backup", tmp_path / "copy", "--data-dir", kept["folder"])[0] == 0
    monkeypatch.setenv("JOULEMAP_STORE", f"file://{tmp_path / 'objects'}")
    folder = tmp_path / "data"
    assert joulemap("restore", tmp_path / "copy", "--data-dir", folder)[0] == 0
    for name in ("heightmaps", "costmaps", "runs", "calibrations", "models"):
        shutil.rmtree(folder / name)
    assert joulemap("check", "--data-dir", folder) == (0, {"findings": [], "left": 0})
    lattice = Path("costmaps") / f"{kept['costmap']}.zarr"
    assert fingerprint(folder / lattice) == fingerprint(kept["folder"] / lattice)
    flip(folder / "runs" / kept["runs"] / run_of(kept).name)  # of a copy, which is fetched again
    flip(chunk_of({**kept, "folder": folder}))
    code, found = joulemap("check", "--repair", "--data-dir", folder)
    assert (code, {one["what"] for one in found["findings"]}) == (0, {kept["runs"], kept["costmap"]})
    assert joulemap("check", "--data-dir", folder) == (0, {"findings": [], "left": 0})
    assert files_of(folder).items() <= files_of(kept["folder"]).items()
    shutil.rmtree(folder / "heightmaps")
    assert joulemap("backup", tmp_path / "again", "--data-dir", folder)[0] == 0
    assert (tmp_path / "again" / "heightmaps" / f"{kept['heightmap']}.tif").read_bytes() == (
        kept["folder"] / "heightmaps" / f"{kept['heightmap']}.tif"
    ).read_bytes()
    (tmp_path / "objects" / "records" / "heightmaps" / f"{kept['heightmap']}.tif.json").unlink()
    stray = tmp_path / "objects" / "runs" / "runs-999999999999" / "run.csv"
    stray.parent.mkdir(parents=True)
    stray.write_text("t,x\n")
    two_days_ago = time.time() - 2 * 86_400
    os.utime(stray, (two_days_ago, two_days_ago))
    code, found = joulemap("check", "--data-dir", folder)
    assert code == 1
    assert {(one["kind"], one["what"]) for one in found["findings"]} == {
        ("damaged", kept["heightmap"]),
        ("orphan", "object runs/runs-999999999999"),
    }


@pytest.mark.parametrize("words", [("check",), ("check", "--repair"), ("backup", "no-copy")])
def test_another_folder_is_left_as_it_is(tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "dem.tif").touch()
    assert joulemap(*words, "--data-dir", tmp_path)[0] == 5
    assert [path.name for path in tmp_path.iterdir()] == ["dem.tif"]
