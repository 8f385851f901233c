"""docs/how-to/add-an-effect.md: its form is registered as the page says, tested, found in runs and read back."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from joulemap.model.loop import _design as design
from joulemap.model.loop import forms
from joulemap.model.loop.forms import FORMS, form_from_dict
from joulemap.model.loop.forms.base import Form
from joulemap.service.models import load_model
from tests.docs.code_blocks import Block, Machine, blocks_of
from tests.reference.drives import ROBOT, even

PAGE = "docs/how-to/add-an-effect.md"
WEIGHT_N = 40.0 * 9.80665  # of the robot of the test's line


def block_with(word: str) -> Block:
    return next(block for block in blocks_of(PAGE) if block.language == "text" and word in block.text)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, Any]]]:
    """A folder and the names that the page's blocks leave; its form is in the registry while these tests run."""
    folder = tmp_path_factory.mktemp("page")
    with pytest.MonkeyPatch.context() as patch, Machine(folder) as machine:
        for block in blocks_of(PAGE):
            machine.run(block)
            if block.title == "snow.py":  # what the two lines of the registry do
                form = machine.names["Snow"]
                patch.setitem(FORMS, form.key, form)
                for module in (forms, design):
                    patch.setattr(module, "NAMED", (*forms.NAMED, form))
        yield folder, machine.names


@pytest.mark.slow
def test_the_page_names_the_lines_of_the_registry(page: tuple[Path, dict[str, Any]]) -> None:
    lines = block_with("NAMED").text
    assert "from joulemap.model.loop.forms.snow import Snow\n" in lines
    assert "    Snow,\n" in lines
    registry = Path(forms.__file__).read_text(encoding="utf-8")
    assert "NAMED: tuple[type[Form], ...] = (\n" in lines
    assert "NAMED: tuple[type[Form], ...] = (\n" in registry


@pytest.mark.slow
def test_the_line_of_the_test_holds(page: tuple[Path, dict[str, Any]]) -> None:
    known = {"Snow": page[1]["Snow"], "even": even, "np": np, "W": WEIGHT_N}
    assert pytest.approx(ROBOT.weight_n) == WEIGHT_N
    ((form, rows, expected),) = eval("{" + block_with('"snow": (').text + "}", known).values()
    np.testing.assert_allclose(form.columns(rows), [expected], rtol=1e-9)
    assert form_from_dict(json.loads(json.dumps(form.as_dict()))) == form


@pytest.mark.slow
def test_without_its_column_it_is_no_candidate(page: tuple[Path, dict[str, Any]]) -> None:
    snow = page[1]["Snow"]
    assert list(snow.variants(even())) == []
    assert list(snow.variants(even(columns={"snow_depth": np.array([0.1])}))) == [snow()]


@pytest.mark.slow
def test_it_is_found_first_with_the_hidden_coefficient_in_its_interval(page: tuple[Path, dict[str, Any]]) -> None:
    first = page[1]["found"].effects[0]
    assert first["name"] == "snow"
    low, high = first["coefficients"][0]["ci95"]
    assert low < 0.8 < high


@pytest.mark.slow
def test_the_calibrated_model_has_it(page: tuple[Path, dict[str, Any]]) -> None:
    model = load_model(page[0] / "found" / "model")
    assert "snow" in [term["name"] for term in model.provenance()["effects"]]


def test_every_attribute_of_a_form_is_in_the_table_of_the_page() -> None:
    text = (Path(__file__).resolve().parents[2] / PAGE).read_text(encoding="utf-8")
    declared = list(Form.__annotations__)
    assert set(declared) >= {"key", "label", "unit", "low", "planned"}
    assert [name for name in declared if f"`{name}`" not in text] == []
