"""A cost map of a calibrated model reuses one of its base model: bit by bit the same, without computing it."""

from pathlib import Path

import pytest

from joulemap.model.energy.architectures.compact.dense import CompactPredictor
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.loop.calibration_file import save_calibrated
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms.structure import Curve
from joulemap.model.loop.terms import Term
from joulemap.model.robot import Robot
from joulemap.service.hosting.settings import Settings
from joulemap.service.storage.store import Store
from tests.service.workers import fingerprint, made_here, rolling

FURROWS = Term(Curve("heading", (0.0, 1.57, 3.14, 4.71)), (7.0, 3.0, 7.0))


@pytest.fixture
def service(tmp_path: Path, monkeypatch):
    """(its store, a function that makes a cost map, what the network was asked: a count per tile)."""
    settings = Settings(data_dir=tmp_path)
    version = load_predictor("default").provenance()["version"]
    save_calibrated(
        settings.resolved_models_dir / "furrows",
        Correction((FURROWS,), (FURROWS,)),
        {"name": "default", "version": version},
    )
    asked: list[int] = []
    answer = CompactPredictor.traction_and_std

    def counted(self, heightmap, robot, frame, headings):
        asked.append(frame.rows * frame.cols)
        return answer(self, heightmap, robot, frame, headings)

    monkeypatch.setattr(CompactPredictor, "traction_and_std", counted)
    monkeypatch.setattr("joulemap.planner.lattice.tiles.TILE_CELLS", 64)
    store = Store(tmp_path, settings.resolved_database_url)
    store.open()
    heightmap_id = store.add_heightmap(rolling(80), name="rolling", stats={}).id

    def make(model: str, **robot: float) -> str:
        asked.clear()
        request = {"robot": Robot(**robot).as_dict(), "model": model, "spacing_m": 1.0, "headings": 8}
        costmap_id = store.add_costmap(heightmap_id, request).id
        made_here(store, costmap_id, settings.resolved_models_dir)
        return costmap_id

    yield store, make, asked
    store.close()


def test_a_calibrated_map_reuses_the_stored_map_of_its_base(service) -> None:
    store, make, asked = service
    afresh = fingerprint(store.lattice_path(make("furrows")))
    assert sum(asked) > 80 * 80
    base = make("default")
    reusing = make("furrows")
    assert sum(asked) < 64  # but for the question whether the network knows its spread
    assert fingerprint(store.lattice_path(reusing)) == afresh
    assert store.costmap(reusing).summary["provenance"]["model"]["kind"] == "calibrated"
    make("furrows", mass_kg=50.0)
    assert sum(asked) > 80 * 80  # another robot
    store.delete_costmap(base)
    make("furrows")
    assert sum(asked) > 80 * 80


def test_a_worker_is_told_of_one_map_for_every_other_model(service) -> None:
    """A service that made thousands of maps of one heightmap would send all of them with every tile."""
    store, make, _ = service
    old, new = make("physics"), make("physics")
    default = make("default")
    assert store.alike(store.costmap(make("furrows"))) == [new, default]
    assert store.alike(store.costmap(old))[0] == default
