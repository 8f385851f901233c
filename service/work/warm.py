"""Loads kernels and models in a worker as soon as it is there. Dask takes half a second to load."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin

from joulemap.service.work.warm_up import warm_up_models


class Warm(WorkerPlugin):
    """Loads kernels and models in every worker, those that come later among them."""

    name = "joulemap"

    def __init__(self, models: Sequence[str], models_dir: Path, *, nice: int) -> None:
        self._models, self._models_dir, self._nice = tuple(models), models_dir, nice

    async def setup(self, worker: Any) -> None:
        """Begin to load; the worker takes tasks meanwhile."""
        os.nice(self._nice)
        worker.joulemap_warm = asyncio.create_task(asyncio.to_thread(self._load))

    def _load(self) -> None:
        warm_up_models(self._models, models_dir=self._models_dir)
