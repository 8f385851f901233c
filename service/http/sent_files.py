"""Keeps the heightmaps and runs that are sent, once another process has read and checked them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import anyio

from joulemap.model.errors import InputError
from joulemap.model.runs.files import same_content
from joulemap.service.hosting.settings import Settings
from joulemap.service.intake.limits import RunLimits, RunReading
from joulemap.service.intake.readers import Readers
from joulemap.service.intake.runs import check_together
from joulemap.service.storage.sent import safe_name
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import HeightmapRow, RunsRow


class SentFiles:
    """What a service does with files that are sent."""

    settings: Settings
    store: Store
    readers: Readers

    async def keep_heightmap(self, path: Path, *, name: str, **options: Any) -> HeightmapRow:
        """Read, check and keep a heightmap that was sent."""
        made = path.with_name(f"{path.name}.tif")
        most = self.settings.max_cells
        try:
            stats = await self.readers.read(
                "heightmap",
                owner=self.store.owner,
                path=str(path),
                out=str(made),
                name=name,
                max_cells=most,
                options=options,
            )

            def _keep() -> HeightmapRow:
                return self.store.add_heightmap(made, name=name, stats=stats)

            return await anyio.to_thread.run_sync(_keep)
        finally:
            for left in path.parent.glob(f"*{made.name}*"):  # the map, or what a process that was killed had written
                left.unlink(missing_ok=True)

    async def keep_runs(
        self,
        files: Sequence[tuple[str, Path]],
        *,
        reading: RunReading,
        heightmap_id: str | None = None,
    ) -> RunsRow:
        """Read, check and keep runs that were sent together.

        Result: runs in other formats, columns or units are kept in joulemap's, as CSV. Raises NotFoundError if there is
        no such heightmap.
        """
        copies = await anyio.to_thread.run_sync(same_content, [path for _, path in files])
        called = {path: name for name, path in files}
        again = {called[first]: [called[copy] for copy in copies if copies[copy] == first] for first in copies.values()}
        files = [(name, path) for name, path in files if path not in copies]
        names = _distinct([safe_name(name) for name, _ in files])
        ground = None
        if heightmap_id is not None:
            ground = (await anyio.to_thread.run_sync(self.store.heightmap, heightmap_id)).stats
        asked: dict[str, Any] = {
            "limits_of_run": asdict(_run_limits(self.settings)),
            "owner": self.store.owner,
            "crs": ground["crs"] if ground is not None else None,
            "reading": reading.as_dict(),
        }
        made = [path.with_name(f"{path.name}.csv") for _, path in files]
        try:
            stats = [
                await self.readers.read("run", path=str(path), name=name, out=str(out), **asked)
                for name, (_, path), out in zip(names, files, made, strict=True)
            ]
            for (name, _), one in zip(files, stats, strict=True):
                if name in again:
                    one["warnings"].append(f"it was sent again as {', '.join(again[name][:3])}: it is kept once")
            check_together(stats, ground)
            kept = [
                (name, out if one.pop("written") else path)
                for (name, path), out, one in zip(files, made, stats, strict=True)
            ]
            return await anyio.to_thread.run_sync(self.store.add_runs, kept, stats)
        finally:
            for out in made:  # or what a process that was killed had written
                out.unlink(missing_ok=True)
                out.with_name(f"{out.name}.part").unlink(missing_ok=True)


def _distinct(names: list[str]) -> list[str]:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise InputError(f"two runs are called {twice[0]}: send them under different names", name=twice[0])
    return names


def _run_limits(settings: Settings) -> RunLimits:
    table = {name: getattr(settings, f"max_run_{name}") for name in ("rows", "columns", "cells", "text_mb")}
    return RunLimits(settings.max_run_mb, settings.max_run_km, table)
