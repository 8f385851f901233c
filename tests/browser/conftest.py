"""A real service on loopback and Debian's Chromium; without Chromium these tests are skipped."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser.chromium import chromium_path, launched
from tests.service.clusters import free_port


@contextlib.contextmanager
def serving(folder: Path, **values: object) -> Iterator[str]:
    """The address of a service in a thread of this process."""
    import uvicorn

    from joulemap.service.http.app import create_app
    from tests.service.conftest import settings_for

    port = free_port()
    config = uvicorn.Config(create_app(settings_for(folder, **values)), port=port, log_level="warning", loop="asyncio")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive(), "the service ended"
        time.sleep(0.05)
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join(30.0)


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
