"""What several tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("JOULEMAP_ALLOWED_HOSTS", "testserver")  # how Starlette's TestClient calls a service

LONGEST = (
    "browser/test_page.py",
    "service/test_calibrate.py",
    "service/test_restart.py",
    "browser/test_flows.py",
    "service/test_calibrate_without_map.py",
    "docs/test_code_blocks.py",
    "browser/test_question_before.py",
    "service/test_contract.py",
    "service/test_hostile_files.py",
)
"""Files that take long, the longest first: what begins last is waited for by processes that have nothing to do."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take long; the rest keeps its order."""
    order = {Path(__file__).parent / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path, len(order)))


@pytest.fixture(scope="session", autouse=True)
def own_template() -> Iterator[Callable[..., Any]]:
    """Services and commands of this process read files in forks of one template, because it takes seconds to load.

    What is yielded gives each its own again, and so does another working directory.
    """
    from joulemap.service.intake.limits import ReadLimits
    from joulemap.service.intake.readers import Readers

    shared, own, here = Readers(processes=1, queue=1, limits=ReadLimits(1.0, 1.0)), Readers._current, Path.cwd()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Readers, "_current", lambda self, broken=None: own(shared if Path.cwd() == here else self, broken)
        )
        yield own
    shared.close()


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; the test is skipped where it is absent."""
    named = os.environ.get("JOULEMAP_REAL_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "real"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: set JOULEMAP_REAL_DATA to their folder to run this test")
    return folder
