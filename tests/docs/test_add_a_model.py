"""docs/how-to/add-a-model.md: its architecture is trained, saved, read, asked and fine-tuned."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from joulemap.model.energy.architectures import ARCHITECTURES
from joulemap.model.energy.artifact import read_artifact
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.predictor import load_predictor
from joulemap.model.errors import ModelError
from joulemap.model.frames import heading_bins
from tests.docs.code_blocks import Machine, blocks_of
from tests.reference.one_site import evaluate_on_runs, train_on_runs
from tests.service.test_learning import ROBOT, SHIPPED, drive, waves

PAGE = "docs/how-to/add-a-model.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, Any]]]:
    """A folder and the names that the page's blocks leave; its architecture is known while these tests run."""
    known = dict(ARCHITECTURES)
    folder = tmp_path_factory.mktemp("page")
    with Machine(folder) as machine:
        for block in blocks_of(PAGE):
            machine.run(block)
        yield folder, machine.names
    ARCHITECTURES.clear()
    ARCHITECTURES.update(known)


def test_the_page_trains_and_makes_a_cost_map(page: tuple[Path, dict[str, Any]]) -> None:
    folder, names = page
    assert read_artifact(folder / "mine").architecture == "perceptron"
    assert np.isfinite(names["costmap"].lattice.energy_per_m).any()


def test_the_example_fits_on_a_screen_or_two() -> None:
    first = next(block for block in blocks_of(PAGE) if block.language == "python")
    assert first.text.count("\n") < 80


@pytest.mark.slow
def test_untrained_it_is_equation_5_and_trained_it_knows_better(
    page: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    """The runs took 1.2 times equation 5's energy."""
    files = [drive(tmp_path, f"{k}.csv", y=2.0 + k) for k in range(4)]
    train_on_runs(waves(), ROBOT, files, out=tmp_path / "mine", architecture="perceptron", epochs=120)
    mine = load_predictor(tmp_path / "mine")
    physics, learned = (
        evaluate_on_runs(model, waves(), ROBOT, files)["mean_relative_error"] for model in (PhysicsPredictor(), mine)
    )
    assert learned < 0.7 * physics
    with pytest.raises(ModelError, match="perceptron network cannot be fine-tuned"):
        train_on_runs(waves(), ROBOT, files, out=tmp_path / "x", architecture="perceptron", start_from=SHIPPED)
    tuned = {"architecture": "perceptron", "start_from": tmp_path / "mine", "epochs": 1}
    train_on_runs(waves(), ROBOT, files, out=tmp_path / "tuned", **tuned)
    assert read_artifact(tmp_path / "tuned").training["started_from"] == str(tmp_path / "mine")


def test_saved_and_read_it_answers_for_lattices_as_for_segments(page: tuple[Path, dict[str, Any]]) -> None:
    model = load_predictor(page[0] / "mine")
    frame = waves().frame.respaced(1.0).window(2, 5, 3, 8)
    headings = heading_bins(4)
    lattice = model.traction_per_m(waves(), ROBOT, frame, headings)
    x, y = frame.centres()
    places = np.broadcast_arrays(x[None, :, None], y[:, None, None], headings)
    single = model.segment_traction(waves(), ROBOT, *(p.ravel() for p in places)).reshape(lattice.shape)
    np.testing.assert_allclose(lattice, single, rtol=1e-5)
    assert np.isfinite(lattice).all()
