"""A new cost map is opened before its first question; where that fails, the log says why and questions still work."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from joulemap.service.http.app import create_app
from tests.service.conftest import GOAL, START, settings_for
from tests.service.test_restart import wait_until


def _made(client: TestClient, hill_tif: bytes) -> str:
    heightmap = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
    asked = {"heightmap_id": heightmap, "model": "physics"}
    return str(client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=60"}).json()["id"])


def test_a_disk_that_fails_meanwhile_is_in_the_log(
    tmp_path: Path, hill_tif: bytes, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    app = create_app(settings_for(tmp_path))
    with TestClient(app) as client, caplog.at_level(logging.INFO):
        maps: Any = app.state.service.maps

        def _fail(costmap_id: str) -> Any:
            raise OSError(5, "the disk does not answer", costmap_id)

        monkeypatch.setattr(maps, "for_routes", _fail)
        made = _made(client, hill_tif)
        words = f"cost map {made} could not be opened before its first question"
        wait_until(lambda: words in caplog.text)
        assert "the disk does not answer" in caplog.text
        monkeypatch.undo()
        answer = client.post(f"/v1/costmaps/{made}/paths", json={"start": START, "goal": GOAL})
        assert answer.status_code == 200, answer.text


def test_a_map_that_is_deleted_before_it_is_noted_as_done_does_not_stay_in_memory(
    tmp_path: Path, hill_tif: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = create_app(settings_for(tmp_path))
    forgotten: list[str] = []
    deleted = threading.Event()
    with TestClient(app) as client:
        service: Any = app.state.service
        store_type, maps = type(service.store), service.maps
        finish, forget, for_routes = store_type.finish, maps.forget, maps.for_routes

        def _deleted_first(store: Any, job_id: str, summary: dict[str, Any]) -> bool:
            service.delete_costmap(job_id)
            deleted.set()
            return bool(finish(store, job_id, summary))

        monkeypatch.setattr(store_type, "finish", _deleted_first)

        def _forget(job_id: str) -> None:
            forget(job_id)
            forgotten.append(job_id)

        monkeypatch.setattr(maps, "forget", _forget)
        monkeypatch.setattr(maps, "for_routes", lambda job_id: deleted.wait(60.0) and for_routes(job_id))
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        made = client.post("/v1/costmaps", json={"heightmap_id": heightmap, "model": "physics"}).json()["id"]
        wait_until(lambda: forgotten == [made, made])  # by the deletion, and by the opening that began
        assert len(maps) == 0
