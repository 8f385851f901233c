"""What several tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

os.environ.setdefault("JOULEMAP_ALLOWED_HOSTS", "testserver")  # how Starlette's TestClient calls a service


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; the test is skipped where it is absent."""
    named = os.environ.get("JOULEMAP_REAL_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "real"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: set JOULEMAP_REAL_DATA to their folder to run this test")
    return folder
