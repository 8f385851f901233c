"""Writes service/http/examples.json: what was really asked and answered, by operation, for the OpenAPI document.

python -m tests.service.record_examples
"""

from __future__ import annotations

import json
import re
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.http.app import create_app
from joulemap.service.render.raster_shading import MAX_PIXELS
from tests.service.conftest import GOAL, START, hill, settings_for
from tests.service.test_calibrations import ROBOT, hills, run_csv

FILE = Path(__file__).resolve().parents[2] / "service" / "http" / "examples.json"
IDS = {
    "hm": "hm-5f0c2a9d41be",
    "cm": "cm-0d4b8f6a2c17",
    "runs": "runs-3b9d0c1e77aa",
    "cal": "cal-2f7719c0be04",
    "dr": "dr-71c2e0a95b38",
}
_PLACE = re.compile(r"/v1/(\w+)/([^/]+)")
_LONG, _KEPT = 8, 3  # items of a list


def _strip(client: TestClient) -> str:
    """The id of a cost map with more cells along a side than a picture has pixels."""
    cols = MAX_PIXELS + 200
    strip = Heightmap(np.zeros((8, cols), dtype=np.float32), GridFrame(0.0, 8.0, 1.0, 8, cols))
    ground = client.post("/v1/heightmaps", content=write_geotiff(None, strip)).json()["id"]
    wanted = {"heightmap_id": ground, "model": "physics", "headings": 4}
    return str(client.post("/v1/costmaps", json=wanted, headers={"Prefer": "wait=60"}).json()["id"])


def record(client: TestClient) -> dict[str, Any]:
    """Ask every operation once. Returns parameters, body and answers of each."""
    found: dict[str, Any] = {}

    def ask(
        name: str, method: str, path: str, *, body: Any = None, query: Any = None, prefer: str = "", **how: Any
    ) -> Any:
        headers = {"Prefer": prefer} if prefer else {}
        answer = client.request(method, path, json=body, params=query, headers=headers, **how)
        assert answer.is_success, (name, answer.text)
        ids = {
            f"{kind.removesuffix('s') if kind != 'runs' else kind}_id": value for kind, value in _PLACE.findall(path)
        }
        parameters = {**ids, **(query or {}), **({"prefer": prefer} if prefer else {})}
        entry: dict[str, Any] = found.setdefault(name, {"answers": {}})
        entry |= {"parameters": parameters} if parameters else {}
        entry |= {"body": body} if body is not None else {}
        kind = answer.headers.get("content-type", "").split(";")[0]
        document = answer.json() if answer.content and kind.endswith("json") else None
        if document is not None:
            entry["answers"].setdefault(str(answer.status_code), {})[kind] = document
        return document

    while client.get("/readyz").status_code == 503:
        time.sleep(0.1)
    tif = write_geotiff(None, hill())
    for name, path in (("healthz", "/healthz"), ("readyz", "/readyz"), ("metrics", "/metrics"), ("index", "/v1")):
        ask(name, "GET", path)
    heightmap = ask("send_heightmap", "POST", "/v1/heightmaps", content=tif, query={"name": "hill.tif"})["id"]
    asked = {
        "heightmap_id": heightmap,
        "model": "physics",
        "robot": {"mass_kg": 35.0},
        "spacing_m": 1.0,
        "headings": 16,
    }
    ask("make_costmap", "POST", "/v1/costmaps", body=asked)
    costmap = ask("make_costmap", "POST", "/v1/costmaps", body=asked, prefer="wait=120")["id"]
    driven = client.post("/v1/heightmaps", content=write_geotiff(None, hills())).json()["id"]
    sent = [("file", (f"run_0{k}.csv", run_csv(k, metres=60.0))) for k in (1, 2, 3)]
    runs = ask("send_runs", "POST", "/v1/runs", files=sent, query={"heightmap_id": driven})["id"]
    wanted = {"heightmap_id": driven, "runs": [runs], "model": "physics", "robot": ROBOT, "quick": True}
    other = ask("make_calibration", "POST", "/v1/calibrations", body=wanted)["id"]
    ask("cancel_calibration", "POST", f"/v1/calibrations/{other}/cancel")
    calibration = ask("make_calibration", "POST", "/v1/calibrations", body=wanted, prefer="wait=300")["id"]
    for name, path in (
        ("list_heightmaps", "/v1/heightmaps"),
        ("list_costmaps", "/v1/costmaps"),
        ("list_runs", "/v1/runs"),
        ("list_calibrations", "/v1/calibrations"),
    ):
        ask(name, "GET", path, query={"limit": 1, "offset": 0})
    ask("get_heightmap", "GET", f"/v1/heightmaps/{heightmap}")
    ask("get_runs", "GET", f"/v1/runs/{runs}")
    ask("get_calibration", "GET", f"/v1/calibrations/{calibration}")
    ask("get_segments", "GET", f"/v1/calibrations/{calibration}/segments")
    ask("get_next_drive", "GET", f"/v1/calibrations/{calibration}/next-drive")
    for kind in ("qgc-plan", "ros-path", "geojson"):
        ask("get_next_drive", "GET", f"/v1/calibrations/{calibration}/next-drive", query={"format": kind})
    here = f"/v1/costmaps/{costmap}"
    ask("get_costmap", "GET", here)
    ask("get_provenance", "GET", f"{here}/provenance")
    ask("get_at", "GET", f"{here}/at", query={"x": START[0], "y": START[1]})
    ask("get_image", "GET", f"{here}/image.png", query={"view": "mean"})
    ask("get_data", "GET", f"{here}/data", query={"format": "nav2-graph"})
    ask("get_data", "GET", f"{here}/data", query={"format": "geotiff"})
    ends = {"start_x": START[0], "start_y": START[1], "goal_x": GOAL[0], "goal_y": GOAL[1]}
    ask("get_ground", "GET", f"/v1/heightmaps/{heightmap}/ground.png")
    ask("get_layers", "GET", f"{here}/layers")
    ask("get_layer", "GET", f"{here}/layer.png", query={"layer": "energy", "view": "mean"})
    ask("get_piece", "GET", f"/v1/costmaps/{_strip(client)}/piece.png", query={"level": 0, "row": 0, "col": 1})
    ask("get_contours", "GET", f"{here}/contours")
    around = {"west": START[0] - 2.0, "south": START[1] - 2.0, "east": START[0] + 2.0, "north": START[1] + 2.0}
    ask("get_roses", "GET", f"{here}/roses", query={**around, "across": 2})
    ask("get_surface", "GET", f"{here}/surface")
    ask("get_field", "GET", f"{here}/field", query={**ends, "within": 5.0})
    task = {"start": START, "goal": GOAL, "battery": {"charge": 0.8, "reserve": 0.2}}
    ask("find_path", "POST", f"{here}/paths", body={**task, "alternatives": 1})
    stops = {"stops": [START, GOAL, [START[0] + 10.0, START[1] - 8.0]]}
    ask("find_tour", "POST", f"{here}/tours", body=stops)
    ask(
        "find_charging",
        "POST",
        f"{here}/charging",
        body={"start": START, "goal": GOAL, "at": [stops["stops"][2]], "power_w": 100.0},
    )
    ask("find_matrix", "POST", f"{here}/matrix", body={"starts": [START, stops["stops"][2]], "goals": [GOAL]})
    for kind in ("qgc-plan", "ros-path", "geojson"):
        ask("find_path", "POST", f"{here}/paths", body={**task, "alternatives": 1}, query={"format": kind})
        ask("find_tour", "POST", f"{here}/tours", body=stops, query={"format": kind})
        ask("ask_feasibility", "POST", f"{here}/feasibility", body={**task, "round_trip": True}, query={"format": kind})
    ask("ask_feasibility", "POST", f"{here}/feasibility", body={**task, "round_trip": True})
    way = {"position": START, "home": START, "path": [START, GOAL], "charging": [GOAL], "battery": {"charge": 0.01}}
    ask("find_point_of_no_return", "POST", f"{here}/return", body=way)
    drive = ask("begin_drive", "POST", f"{here}/drives", body={"path": [START, GOAL], "battery": {"charge": 0.8}})["id"]
    moments = [{"time_s": 2.0 * k, "position": [START[0] + k, START[1]], "power_w": 64.0} for k in range(8)]
    ask("update_drive", "POST", f"/v1/drives/{drive}/updates", body={"samples": moments})
    ask("get_drive", "GET", f"/v1/drives/{drive}")
    ask("charge_of_drive", "GET", f"/v1/drives/{drive}/charge")
    ask("better_route_of_drive", "GET", f"/v1/drives/{drive}/better-route")
    ask("list_drives", "GET", "/v1/drives", query={"limit": 1, "offset": 0})
    for name in ("watch_drive", "delete_drive"):
        found[name] = {"parameters": {"drive_id": drive}, "answers": {}}
    reached = {"start": START, "charges": [0.001, 0.002]}
    ask("find_reach", "POST", f"{here}/reach", body=reached, query={"format": "geojson"})
    ask("find_reach", "POST", f"{here}/reach", body=reached)
    learned = client.post("/v1/costmaps", json={**asked, "model": "default"}, headers={"Prefer": "wait=300"}).json()
    for query in (*({"format": kind} for kind in ("qgc-plan", "ros-path", "geojson")), None):
        place, ends = f"/v1/costmaps/{learned['id']}/speeds", {"start": START, "goal": GOAL}
        ask("find_speeds", "POST", place, body=ends, query=query)
    large = client.post("/v1/costmaps", json={**asked, "spacing_m": 0.1, "headings": 360}).json()["id"]
    ask("cancel_costmap", "POST", f"/v1/costmaps/{large}/cancel")
    for name in ("follow_costmap", "delete_costmap"):
        found[name] = {"parameters": {"costmap_id": costmap}, "answers": {}}
    found["delete_runs"] = {"parameters": {"runs_id": runs}, "answers": {}}
    found["delete_heightmap"] = {"parameters": {"heightmap_id": heightmap}, "answers": {}}
    for name in ("follow_calibration", "get_report", "delete_calibration"):
        found[name] = {"parameters": {"calibration_id": calibration}, "answers": {}}
    return shortened(found)


def shortened(value: Any) -> Any:
    """With short lists, rounded numbers, and the same ids and times at each recording."""
    if isinstance(value, dict):
        return {key: shortened(item) for key, item in value.items()}
    if isinstance(value, list):
        return [shortened(item) for item in (value if len(value) <= _LONG else value[:_KEPT])]
    if isinstance(value, float):
        return float(f"{value:.9g}")
    if isinstance(value, str):
        value = re.sub(r"\b(hm|cm|runs|cal|dr)-[0-9a-f]{12}\b", lambda match: IDS[match[1]], value)
        return re.sub(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?", "2026-11-22T09:30:00", value)
    return value


if __name__ == "__main__":
    with (
        tempfile.TemporaryDirectory() as folder,
        TestClient(create_app(settings_for(Path(folder), workers=1)), base_url="http://localhost") as app,
    ):
        recorded = record(app)
    FILE.write_text(json.dumps(recorded, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"written: {FILE}")
