"""docs/how-to/add-a-log-format.md: its example is run and registered, and a log is read with it."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pytest

from joulemap.model.errors import RunsError
from joulemap.model.runs import formats
from joulemap.model.runs.reader import parse_run
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


def test_the_log_of_the_page_is_read(page: Machine) -> None:
    """Places every 0.1 s in steps of 0.05 m; 24.1 V and 2 A all the time."""
    (run,) = page.names["runs"].runs
    np.testing.assert_allclose(np.diff(run.x), 0.5 * np.diff(run.t), atol=1e-9)
    np.testing.assert_allclose(run.drawn(), 48.2)


def test_what_is_broken_is_refused_with_its_place(page: Machine) -> None:
    lines = (page.folder / "drive.jsonl").read_bytes().splitlines(keepends=True)
    with pytest.raises(RunsError, match="after 20 lines"):
        parse_run(b"".join(lines[:20]) + b'{"topic": "place", "t": ', name="broken.jsonl")
