"""A curve that is found against baseline runs, over HTTP: the job, its report, its page and its segments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fastapi.testclient import TestClient

from tests.loop.reports import case_of


def sent(client: TestClient, folder: Path, ground: str) -> str:
    files = [("file", (path.name, path.read_bytes())) for path in sorted(folder.glob("*.csv"))]
    answer = client.post("/v1/runs", files=files, params={"heightmap_id": ground})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def test_a_curve_against_baseline_runs_is_found_and_drawn(client: TestClient, tmp_path: Path) -> None:
    case = case_of("low_mud:1:990298:3:60")
    case.write(tmp_path)
    ground = client.post("/v1/heightmaps", content=(tmp_path / "dem.tif").read_bytes()).json()["id"]
    robot = {key: value for key, value in case.declared.as_dict().items() if value is not None}
    asked: dict[str, Any] = {"heightmap_id": ground, "model": "physics", "robot": robot, "quick": True}
    asked |= {
        "runs": [sent(client, tmp_path / "new", ground)],
        "baseline_runs": [sent(client, tmp_path / "base", ground)],
    }
    answer = client.post("/v1/calibrations", json=asked, headers={"Prefer": "wait=200"})
    assert answer.status_code == 201, answer.text
    made = answer.json()
    curves = [effect for effect in made["report"]["effects"] if effect["form"] == "curve"]
    assert made["report"]["baseline_runs"]
    assert curves
    for curve in curves:
        assert not curve["settings"]["centred"]
        assert len(curve["coefficients"]) == len(curve["settings"]["knots"])
    page = client.get(made["links"]["page"])
    assert page.status_code == 200
    assert "Zero is what the baseline runs show" in page.text
    segments = client.get(f"/v1/calibrations/{made['id']}/segments").json()
    assert len(segments["runs"]) == 3
