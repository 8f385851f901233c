"""The UMA rescue area (EPSG:32630, 1 m) through HTTP, planned across."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from tests.reference.lattices import price_world_path


def test_uma_rescue_area(client: TestClient, real_data: Path) -> None:
    file = real_data / "cuadriga" / "uma_rescue_area_1m.tif"
    with file.open("rb") as stream:
        answer = client.post("/v1/heightmaps", files={"file": (file.name, stream)})
    assert answer.status_code == 201, answer.text
    heightmap = answer.json()
    assert (heightmap["crs"], heightmap["resolution_m"]) == ("EPSG:32630", 1.0)
    made = client.post(
        "/v1/costmaps", json={"heightmap_id": heightmap["id"], "model": "physics"}, headers={"Prefer": "wait=120"}
    ).json()
    assert made["status"] == "done"
    assert made["blocked"]["free"] > 0.3
    lattice = client.app.state.service.maps.planner(made["id"]).lattice  # type: ignore[attr-defined]
    free = np.argwhere(lattice.blocked == 0)
    rng = np.random.default_rng(1)
    answered = 0
    for _ in range(8):
        (r0, c0), (r1, c1) = free[rng.integers(len(free), size=2)]
        start, goal = ([float(v) for v in lattice.frame.xy(r, c)] for r, c in ((r0, c0), (r1, c1)))
        answer = client.post(f"/v1/costmaps/{made['id']}/paths", json={"start": start, "goal": goal})
        if answer.status_code == 422:
            assert answer.json()["code"] == "no_route"
            continue
        answered += 1
        about = answer.json()
        for route in (about, about["shortest"]):
            points = np.array(route["path"])[:, :2]
            assert route["energy_j"] == pytest.approx(price_world_path(lattice, points), rel=1e-6)
        assert about["energy_j"] <= about["shortest"]["energy_j"] * (1 + 1e-9)
        assert about["length_m"] >= about["shortest"]["length_m"] * 0.98
        forth = [point[:2] for point in about["path"]]
        both = client.post(f"/v1/costmaps/{made['id']}/feasibility", json={"path": forth, "round_trip": True}).json()
        assert both["out"]["energy_j"] == pytest.approx(about["energy_j"], rel=1e-6)
        assert both["back"]["energy_j"] == pytest.approx(price_world_path(lattice, forth[::-1]), rel=1e-6)
    assert answered >= 4
