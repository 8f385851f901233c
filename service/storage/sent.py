"""Heightmaps and measured runs that were sent, and are kept."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import Text, cast, or_, select, update
from sqlalchemy.orm import Session

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import open_ground
from joulemap.model.terrain.windows import Ground
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.storage.kept import Kept
from joulemap.service.storage.stats import noise_of_stats
from joulemap.service.storage.tables import (
    CALIBRATION,
    COSTMAP,
    JOBS,
    WORDS,
    CalibrationRow,
    HeightmapRow,
    RunsRow,
    named_rasters,
    named_test_runs,
    now,
)

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


class KeptSent(Kept):
    """Rows of heightmaps with a GeoTIFF of each, and of runs that were sent together with a folder of each."""

    def add_heightmap(self, heightmap: Heightmap | Path, *, name: str, stats: dict[str, Any]) -> HeightmapRow:
        """Keep a heightmap, so that no row is ever without its file."""
        row = HeightmapRow(id=f"hm-{secrets.token_hex(6)}", created_at=now(), name=name, stats=stats)
        with self.upload_file() as begun:
            if isinstance(heightmap, Path):
                heightmap.replace(begun)
            else:
                write_geotiff(begun, heightmap)
            self._keep_with(row, begun, self.path(HeightmapRow, row.id))
        return row

    def heightmap(self, heightmap_id: str) -> HeightmapRow:
        """Return the row of a heightmap. Raises NotFoundError if there is none, or its file is gone."""
        return there(self._row(HeightmapRow, "is no heightmap", heightmap_id=heightmap_id))

    def open_heightmap(self, heightmap_id: str, asked: Mapping[str, Any] | None = None) -> Ground:
        """Open a heightmap to read it by windows, with the layers of the request of a cost map.

        Result: whose heights are read as they are needed. Raises NotFoundError if there is none.
        """
        row = self.heightmap(heightmap_id)
        for each in (heightmap_id, *named_rasters(asked or {}).values()):
            self.intact_heightmap(each)
        path, over = self.path(HeightmapRow, heightmap_id), self.layers_asked(asked or {})
        return open_ground(path, filename=row.name, alone=True, **noise_of_stats(row.stats), **over)

    def layers_asked(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Return the layers of the request of a cost map, as a heightmap is read with them.

        Result: polygons are bytes, and rasters that were sent are the paths of their files.
        """
        rasters = named_rasters(asked)
        sent: dict[str, Path | bytes] = {
            role: self.path(HeightmapRow, rasters[role]).resolve() if role in rasters else json.dumps(layer).encode()
            for role, layer in asked.get("layers", {}).items()
        }
        names = {role: f"{self.heightmap(raster_id).name} ({raster_id})" for role, raster_id in rasters.items()}
        return {"layers": sent, "legend": asked["legend"] or None, "layer_names": names} if sent else {}

    def delete_heightmap(self, heightmap_id: str) -> None:
        """Delete a heightmap from which nothing was made.

        Raises NotFoundError if there is none; ConflictError if cost maps or calibrations were made from it; their ids
        are in the context.
        """
        row = self._row(HeightmapRow, "is no heightmap", heightmap_id=heightmap_id)

        def _unless_used(session: Session) -> None:
            # who adds a user at the same moment waits, or has added it
            session.execute(update(HeightmapRow).where(HeightmapRow.id == heightmap_id).values(used_at=now()))
            users = {
                kind: sorted(
                    session.scalars(
                        select(table.id).where(
                            or_(
                                table.heightmap_id == heightmap_id,
                                cast(table.request, Text).contains(f'"{heightmap_id}"'),  # as a layer
                            )
                        )
                    )
                )
                for kind, table in JOBS.items()
            }
            if ids := [job_id for found in users.values() for job_id in found]:
                words = " and ".join(f"{len(found)} {WORDS[kind]}(s)" for kind, found in users.items() if found)
                raise ConflictError(
                    f"heightmap {heightmap_id} is used by {words}, {', '.join(ids[:5])}: delete them first",
                    costmap_ids=users[COSTMAP],
                    calibration_ids=users[CALIBRATION],
                )
            session.delete(row)

        self._delete(_unless_used)
        self._forget(self.path(HeightmapRow, heightmap_id))

    def intact_heightmap(self, heightmap_id: str) -> Path:
        """Return the file of a heightmap, here and as it was kept. Raises DamagedError where it is not."""
        self.heightmap(heightmap_id)
        return self.intact(HeightmapRow, heightmap_id, self.path(HeightmapRow, heightmap_id))

    def add_runs(self, files: Sequence[tuple[str, Path]], stats: list[dict[str, Any]]) -> RunsRow:
        """Keep runs that were sent together, so that no row is ever without its files."""
        row = RunsRow(id=f"runs-{secrets.token_hex(6)}", created_at=now(), stats=stats)
        begun = self._folder.uploads / row.id
        begun.mkdir()
        try:
            for name, file in files:
                shutil.copyfile(file, begun / safe_name(name))
            self._keep_with(row, begun, self.path(RunsRow, row.id))
        finally:
            shutil.rmtree(begun, ignore_errors=True)
        return row

    def runs(self, runs_id: str) -> RunsRow:
        """Return the row of runs that were sent together. Raises NotFoundError if there is none, or they are gone."""
        return there(self._row(RunsRow, "are no runs", runs_id=runs_id))

    def run_files(self, runs_id: str) -> list[Path]:
        """Return the files of runs that were sent together. Raises NotFoundError if there is none."""
        return sorted(self.intact(RunsRow, self.runs(runs_id).id, self.path(RunsRow, runs_id)).iterdir())

    def delete_runs(self, runs_id: str) -> None:
        """Delete runs that no calibration uses.

        Raises NotFoundError if there are none; ConflictError if calibrations use them; their ids are in the context.
        """
        row = self._row(RunsRow, "are no runs", runs_id=runs_id)

        def _unless_used(session: Session) -> None:
            made = session.execute(select(CalibrationRow.id, CalibrationRow.request)).all()
            users = sorted(
                job_id
                for job_id, asked in made
                if runs_id in (*asked["runs"], *asked.get("base_runs", []), *named_test_runs(asked))
            )
            if users:
                raise ConflictError(
                    f"runs {runs_id} are used by {len(users)} calibration(s), {', '.join(users[:5])}: "
                    "delete them first",
                    calibration_ids=users,
                )
            session.delete(row)

        self._delete(_unless_used)
        self._forget(self.path(RunsRow, runs_id))


def there(row: Any) -> Any:
    """Return the row of something that was sent. Raises NotFoundError if a repair put its files away."""
    if row.gone is not None:
        raise NotFoundError(
            f"the files of {row.id} were damaged ({row.gone}), and a repair put them away: send it again. What was "
            "made from it stays",
            id=row.id,
            gone=row.gone,
        )
    return row


def safe_name(name: str) -> str:
    """Return a name that a file of the data directory may have.

    Result: letters, digits, dots, hyphens and underscores; at most 100.
    """
    return _UNSAFE.sub("_", name).lstrip(".")[-100:] or "run"
