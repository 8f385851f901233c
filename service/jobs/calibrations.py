"""Sends a calibration off to a cluster."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.energy.predictor import MODEL_NAMES
from joulemap.model.robot import Robot
from joulemap.service.jobs.costmaps import Report
from joulemap.service.storage.stats import noise_of_stats
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CalibrationRow, HeightmapRow, named_test_runs
from joulemap.service.storage.vault import ObjectVault
from joulemap.service.work.calibrations import calibrate
from joulemap.service.work.vaulted import calibrate as calibrate_vaulted

if TYPE_CHECKING:  # which takes half a second to load
    from distributed import Client

_LOOK_S = 1.0  # between looks how far a calibration is


def order_of(store: Store, calibration_id: str, models_dir: Path) -> dict[str, Any]:
    """Return what a worker is told of a calibration. Result: JSON-able: files, names and settings."""

    def _files(sent: list[str]) -> list[str]:
        return [str(file.resolve()) for runs in sent for file in store.run_files(runs)]

    row, vault = store.calibration(calibration_id), store.vault
    asked, ground, usual = row.request, row.heightmap_id, Robot().as_dict()
    robot = {key: value for key, value in asked["robot"].items() if value != usual.get(key)}
    body = {"heightmap_id": ground or "HEIGHTMAP", "model": row.id} | ({"robot": robot} if robot else {})
    model = asked["model"]
    if ground and not isinstance(vault, ObjectVault):  # of which workers fetch what they use
        store.intact_heightmap(ground)
    return {
        "id": row.id,
        "folder": str(store.path(CalibrationRow, row.id).resolve()),
        "calibrated": str((models_dir / row.id).resolve()),
        "model": model if model in MODEL_NAMES else str((models_dir / model).resolve()),
        "heightmap": str(store.path(HeightmapRow, ground).resolve()) if ground else None,
        "heightmap_name": store.heightmap(ground).name if ground else None,
        "noise": noise_of_stats(store.heightmap(ground).stats) if ground else {},
        "odometry": asked.get("odometry"),
        "robot": asked["robot"],
        "runs": _files(asked["runs"]),
        "base_runs": _files(asked["base_runs"]),
        "test_runs": _files(named_test_runs(asked)),
        "task": None if asked["start"] is None else [asked["start"], asked["goal"]],
        "campaigns": asked.get("campaigns", False),  # not in requests of older versions
        "quick": asked.get("quick", False),
        "seed": asked["seed"],
        "object_store": vault.url if isinstance(vault, ObjectVault) else None,  # where workers share no file system
        "data_folder": str(store.folder.resolve()),
        "next": f"POST /v1/costmaps {json.dumps(body)}",
    }


async def make(client: Client, order: dict[str, Any], *, key: str, priority: float, report: Report) -> dict[str, Any]:
    """Calibrate on a cluster."""
    topic, share = f"{key}-progress", -1.0

    def _take(event: tuple[float, float]) -> None:
        nonlocal share
        share = event[1]

    client.subscribe_topic(topic, _take)
    work = calibrate if order["object_store"] is None else calibrate_vaulted
    task = client.submit(work, order, topic, key=key, priority=priority)
    ended = asyncio.ensure_future(task)
    try:
        while not (await asyncio.wait([ended], timeout=_LOOK_S))[0]:
            if share >= 0.0:
                await report(share)
        return await ended
    finally:
        ended.cancel()
        task.release()
        client.unsubscribe_topic(topic)
