"""Loaded by Dask workers in tests, see `disturbed`: small tiles that take a while, a disk that is full for a time."""

from __future__ import annotations

import errno
import json
import os
import time
from pathlib import Path
from typing import Any

from joulemap.planner.lattice import tiles
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.service.work import tiles as work

NAME = "JOULEMAP_TEST_WORKERS"


def disturbed(*, tile_cells: int = 256, pause_s: float = 0.0, full: Path | None = None) -> dict[str, str]:
    """Environment of a service whose workers are disturbed. full : the disk is full while this file exists."""
    how = json.dumps({"tile_cells": tile_cells, "pause_s": pause_s, "full": str(full) if full else None})
    return {NAME: how, "DASK_DISTRIBUTED__WORKER__PRELOAD": json.dumps([__name__])}


def disturb(*, tile_cells: int, pause_s: float, full: str | None) -> None:
    tiles.TILE_CELLS = tile_cells
    build, write = work.build_tile, LatticeFolder.write

    def _build(*arguments: Any) -> Any:
        time.sleep(pause_s)
        return build(*arguments)

    def _write(*arguments: Any) -> None:
        if full is not None and Path(full).exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        write(*arguments)

    work.build_tile, LatticeFolder.write = _build, _write  # type: ignore[method-assign]


def dask_setup(_worker: object) -> None:
    disturb(**json.loads(os.environ[NAME]))
