"""Cost maps that are kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sqlalchemy import select

from joulemap.planner.lattice import CostLattice, checksums
from joulemap.planner.lattice.io import LatticeFolder, load_lattice
from joulemap.service.storage.jobs import KeptJobs, new_job
from joulemap.service.storage.tables import (
    COSTMAP,
    DONE,
    CostmapRow,
)


class KeptCostmaps(KeptJobs):
    """Rows of cost maps, and a lattice of each that is done."""

    def add_costmap(self, heightmap_id: str, request: dict[str, Any], *, most_bytes: int = 0) -> CostmapRow:
        """Add a cost map to the queue. Raises NotFoundError if the heightmap was deleted."""
        return self._add(CostmapRow(**new_job(COSTMAP, heightmap_id, request)), most_bytes)

    def costmap(self, costmap_id: str) -> CostmapRow:
        """Return the row of a cost map. Raises NotFoundError if there is none."""
        return self._row(CostmapRow, "is no cost map", costmap_id=costmap_id)

    def costmaps(self, *, limit: int, offset: int) -> tuple[list[CostmapRow], int]:
        """Return one page of the cost maps, newest first.

        Returns `rows`: those of the page; `total`: how many there are in all.
        """
        return self._page(CostmapRow, limit, offset)

    def alike(self, row: CostmapRow) -> list[str]:
        """Return the newest finished cost map of every other model that differs from one in nothing but the model."""

        def _but_model(request: dict[str, Any]) -> dict[str, Any]:
            return {key: value for key, value in request.items() if key != "model"}

        newest: dict[str, str] = {}
        with self._sessions() as session:
            query = select(CostmapRow).where(CostmapRow.heightmap_id == row.heightmap_id, CostmapRow.status == DONE)
            for made in session.scalars(query.order_by(CostmapRow.created_at)):
                if _but_model(made.request) == _but_model(row.request):
                    newest[made.request["model"]] = made.id
        newest.pop(row.request["model"], None)
        return list(newest.values())

    def load_lattice(self, costmap_id: str) -> CostLattice:
        """Load the lattice of a cost map."""
        return load_lattice(self.lattice_folder(costmap_id))

    def lattice_folder(self, costmap_id: str) -> Path:
        """Return the folder of a cost map for reading.

        One of an older version has no checksums of its own: it is compared with those of its row, once.

        Raises DamagedError if it is not what was kept.
        """
        place = self.here(self.lattice_path(costmap_id))
        if place.exists() and not (place / checksums.FILE).exists():
            for part in self.unlike(CostmapRow, costmap_id, place):
                raise checksums.damaged(f"{place.name}/{part.name}", "its content is not what was kept")
        return place

    def delete_costmap(self, costmap_id: str) -> None:
        """Delete a cost map: the row first, so that a job that still makes it stops.

        Raises NotFoundError if there is none.
        """
        row = self.costmap(costmap_id)
        self._delete(lambda session: session.delete(row))
        LatticeFolder(self.lattice_path(costmap_id)).discard()
        self._remove_all(costmap_id)
