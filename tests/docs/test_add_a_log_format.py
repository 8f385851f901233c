"""docs/how-to/add-a-log-format.md: its example is run and registered, and a file is read with it."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs import formats
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.table import TableLimits
from tests.docs.code_blocks import Machine, blocks_of

PAGE = "docs/how-to/add-a-log-format.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """The page after its last block; its format is known while the tests of this module run."""
    known, path = list(formats.FORMATS), list(sys.path)
    with Machine(tmp_path_factory.mktemp("page")) as machine:
        for block in blocks_of(PAGE):
            machine.run(block)
        yield machine
    formats.FORMATS[:], sys.path[:] = known, path
    sys.modules.pop("json_lines", None)


def test_the_file_of_the_page_is_read(page: Machine) -> None:
    run = page.names["runs"].runs[0]
    np.testing.assert_allclose(run.drawn(), 24.1 * 2.0)
    np.testing.assert_allclose(run.x, 0.05 * np.arange(199))  # the last position comes after the last voltage
    assert run.reading["voltage"] == "battery.v [V]"


def test_what_is_broken_or_too_large_is_refused(page: Machine) -> None:
    whole = (page.folder / "drive.jsonl").read_bytes()
    with pytest.raises(RunsError, match="truncated or corrupt after 13 lines"):
        parse_run(whole[:800], name="drive.jsonl")
    with pytest.raises(TooLargeError, match="more than 20 messages"):
        parse_run(whole, name="drive.jsonl", limits=TableLimits(rows=20))
