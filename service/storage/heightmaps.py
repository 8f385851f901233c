"""Heightmaps that are kept."""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError

from joulemap.model.errors import ConflictError
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import open_ground
from joulemap.model.terrain.windows import Ground
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.storage.kept import Kept, now
from joulemap.service.storage.stats import noise_of_stats
from joulemap.service.storage.tables import (
    CALIBRATION,
    COSTMAP,
    JOBS,
    WORDS,
    HeightmapRow,
)


def layers_asked(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the layers of the request of a cost map, as a heightmap is read with them."""
    sent = {role: json.dumps(polygons).encode() for role, polygons in asked.get("layers", {}).items()}
    return {"layers": sent, "legend": asked["legend"] or None} if sent else {}


class KeptHeightmaps(Kept):
    """Rows of heightmaps, and a GeoTIFF of each."""

    def add_heightmap(self, heightmap: Heightmap | Path, *, name: str, stats: dict[str, Any]) -> HeightmapRow:
        """Keep a heightmap, so that no row is ever without its file."""
        row = HeightmapRow(id=f"hm-{secrets.token_hex(6)}", created_at=now(), name=name, stats=stats)
        with self.upload_file() as begun:
            if isinstance(heightmap, Path):
                heightmap.replace(begun)
            else:
                write_geotiff(begun, heightmap)
            self._keep_with(row, begun, self.heightmap_path(row.id))
        return row

    def heightmap(self, heightmap_id: str) -> HeightmapRow:
        """Return the row of a heightmap. Raises NotFoundError if there is none."""
        return self._row(HeightmapRow, "is no heightmap", heightmap_id=heightmap_id)

    def open_heightmap(self, heightmap_id: str, asked: Mapping[str, Any] | None = None) -> Ground:
        """Open a heightmap to read it by windows, with the layers of the request of a cost map.

        Result: whose heights are read as they are needed. Raises NotFoundError if there is none.
        """
        row = self.heightmap(heightmap_id)
        path = self.here(self.heightmap_path(heightmap_id))
        return open_ground(
            path, filename=row.name, alone=True, **noise_of_stats(row.stats), **layers_asked(asked or {})
        )

    def heightmaps(self, *, limit: int, offset: int) -> tuple[list[HeightmapRow], int]:
        """Return one page of the heightmaps, newest first.

        Returns `rows`: those of the page; `total`: how many there are in all.
        """
        return self._page(HeightmapRow, limit, offset)

    def delete_heightmap(self, heightmap_id: str) -> None:
        """Delete a heightmap from which nothing was made.

        Raises NotFoundError if there is none; ConflictError if cost maps or calibrations were made from it; their ids
        are in the context.
        """
        row = self.heightmap(heightmap_id)
        try:
            self._delete(lambda session: session.delete(row))
        except IntegrityError as error:
            with self._sessions() as session:
                users = {
                    kind: sorted(session.scalars(select(table.id).where(table.heightmap_id == heightmap_id)))
                    for kind, table in JOBS.items()
                }
            ids = [job_id for found in users.values() for job_id in found]
            words = " and ".join(f"{len(found)} {WORDS[kind]}(s)" for kind, found in users.items() if found)
            raise ConflictError(
                f"heightmap {heightmap_id} is used by {words}, {', '.join(ids[:5])}: delete them first",
                costmap_ids=users[COSTMAP],
                calibration_ids=users[CALIBRATION],
            ) from error
        self._forget(self.heightmap_path(heightmap_id))

    def heightmap_path(self, heightmap_id: str) -> Path:
        """Return the file of a heightmap."""
        return self._dir / "heightmaps" / f"{heightmap_id}.tif"
