"""A service in this process on a fresh data directory, and a small map with a hill, a wall and a hole in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.app import create_app
from tests.service.clusters import shared_scheduler

WEST, NORTH = 500_000.0, 4_000_030.0
START, GOAL = [WEST + 3.5, NORTH - 15.5], [WEST + 36.5, NORTH - 14.5]
IN_HOLE = [WEST + 34.5, NORTH - 25.5]


def hill() -> Heightmap:
    """30 x 40 cells of 1 m: a hill in the middle, a wall in the north, a hole of unknown heights in the south-east."""
    row, col = np.mgrid[0:30, 0:40]
    heights = 2.5 * np.exp(-((row - 15.0) ** 2 + (col - 20.0) ** 2) / 50.0)
    heights[2:5, 8:14] += 2.0
    heights[24:27, 33:37] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(WEST, NORTH, 1.0, 30, 40, "EPSG:32630"))


def settings_for(folder: Path, **values: object) -> Settings:
    """Settings of a service whose jobs are done by the workers that all tests share, unless `values` say otherwise."""
    if "workers" not in values:
        values.setdefault("scheduler", shared_scheduler())
    return Settings(data_dir=folder, warm_models=("physics",), **values)  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def hill_tif() -> bytes:
    data = write_geotiff(None, hill())
    assert data is not None
    return data


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    settings = settings_for(tmp_path_factory.mktemp("data"), max_upload_mb=2.0, max_cells=1_000_000)
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def heightmap_id(client: TestClient, hill_tif: bytes) -> str:
    answer = client.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif)})
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


@pytest.fixture(scope="module")
def costmap_id(client: TestClient, heightmap_id: str) -> str:
    answer = client.post(
        "/v1/costmaps", json={"heightmap_id": heightmap_id, "model": "physics"}, headers={"Prefer": "wait=60"}
    )
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


@pytest.fixture(scope="module")
def service(client: TestClient) -> jm.Client:
    """The package's client, joined to the service without a network."""

    def _answer(request: httpx.Request) -> httpx.Response:
        answer = client.request(
            request.method, str(request.url), content=request.content, headers=dict(request.headers)
        )
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    return jm.Client("http://testserver", transport=httpx.MockTransport(_answer))
