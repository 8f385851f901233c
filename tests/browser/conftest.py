"""A real service on loopback and Debian's Chromium; without Chromium these tests are skipped."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser.chromium import chromium_path, launched


def serving(folder: Path, **values: object) -> contextlib.AbstractContextManager[str]:
    """The address of a service in a thread of this process."""
    from joulemap.service.http.app import create_app
    from tests.service.conftest import settings_for
    from tests.service.test_contract import served

    return served(create_app(settings_for(folder, **values)))


@pytest.fixture(scope="module")  # its event loop is in the way of other tests of the process
def browser() -> Iterator[object]:
    """Chromium without a window."""
    if chromium_path() is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with launched() as found:
        yield found


@pytest.fixture(scope="module")
def address(browser: object, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Of a service that all tests of a file share."""
    with serving(tmp_path_factory.mktemp("page")) as url:
        yield url
