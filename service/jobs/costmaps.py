"""What a step of a cost map does: it lays the lattice out, builds one tile, or finishes the lattice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joulemap.model.errors import NegativeCycleError
from joulemap.model.robot import Robot
from joulemap.model.terrain.windows import Ground
from joulemap.model.traction import TractionSource
from joulemap.planner.figures import figures_of, joined_figures
from joulemap.planner.lattice_build import build_tile, knows_spread, provenance_of
from joulemap.planner.lattice_io import LatticeFolder
from joulemap.planner.plan import RoutePlanner
from joulemap.planner.tiles import Tiling
from joulemap.service.jobs.steps import Step, Steps
from joulemap.service.jobs.stored_base import with_stored_base
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import LAY_OUT
from joulemap.service.workflows import prepare_build


@dataclass(frozen=True)
class _Job:
    """What all steps of a cost map share."""

    ground: Ground
    robot: Robot
    source: TractionSource
    tiling: Tiling
    folder: LatticeFolder


class Builder:
    """Does the steps of cost maps; keeps what the steps of the latest one share.

    Parameters
    ----------
    store : Store
        Open.
    models_dir : Path
        Folder of trained models.
    max_values : int
        Most values (rows * cols * headings) of a cost map.
    on_done : callable, optional
        Is given the id and the planner of every cost map that is done.
    """

    def __init__(
        self,
        store: Store,
        *,
        models_dir: Path,
        max_values: int,
        on_done: Callable[[str, RoutePlanner], None] | None = None,
    ) -> None:
        self._store = store
        self._models_dir = models_dir
        self._max_values = max_values
        self._on_done = on_done
        self._open: tuple[str, _Job] | None = None

    def do(self, step: Step, steps: Steps, report: Callable[[float], None] | None = None) -> None:
        """Do one step and mark it as done; a step that is done twice has the same result.

        Parameters
        ----------
        step : Step
            The step, taken by this worker.
        steps : Steps
            Where it is marked as done.
        report : callable, optional
            Not called: a tile takes too little time.
        """
        job = self._job(step.job_id)
        if step.number == LAY_OUT:
            job.folder.lay_out(job.tiling, job.robot, with_std=knows_spread(job.source, job.robot))
            provenance = provenance_of(job.ground, job.robot, job.source, job.tiling)
            wanted = steps.complete(step, provenance, tiles=len(job.tiling))
        elif step.last:
            wanted = self._finish(step, job, steps)
        else:
            place = job.tiling[step.number - 1]
            part = build_tile(job.ground, job.robot, job.source, job.tiling, *place)
            job.folder.write(part, *place)
            wanted = steps.complete(step, figures_of(part))
        if not wanted:  # the cost map was deleted meanwhile
            self.discard(step.job_id)

    def rest(self) -> None:
        """Let go of what was kept, because there is nothing to do."""
        self._open = None

    def discard(self, costmap_id: str) -> None:
        """Delete what was made of a cost map.

        Parameters
        ----------
        costmap_id : str
            Its id.
        """
        self._open = None
        LatticeFolder(self._store.lattice_path(costmap_id)).discard()

    def _job(self, costmap_id: str) -> _Job:
        if self._open is None or self._open[0] != costmap_id:
            self._open = None  # before the next is opened, so that never two are held
            row = self._store.costmap(costmap_id)
            ground = self._store.open_heightmap(row.heightmap_id)
            robot, source, tiling = prepare_build(
                ground,
                Robot.from_mapping(row.request["robot"]),
                model=row.request["model"],
                spacing_m=row.request["spacing_m"],
                headings=row.request["headings"],
                models_dir=self._models_dir,
                max_values=self._max_values,
            )
            source = with_stored_base(self._store, row, source, tiling)
            folder = LatticeFolder(self._store.lattice_path(costmap_id))
            self._open = costmap_id, _Job(ground, robot, source, tiling, folder)
        return self._open[1]

    def _finish(self, step: Step, job: _Job, steps: Steps) -> bool:
        provenance, *tiles = steps.results(step.job_id)
        frame = job.tiling.frame
        job.folder.finish(provenance)
        planner = RoutePlanner(self._store.load_lattice(step.job_id))
        try:
            planner.prepare()
        except NegativeCycleError as error:  # the map is good to look at, every question will say the same
            provenance["warnings"].append(error.message)
            planner.lattice.provenance["warnings"].append(error.message)
            job.folder.finish(provenance)
        summary: dict[str, Any] = {
            "robot": job.robot.as_dict(),
            "frame": {
                "rows": frame.rows,
                "cols": frame.cols,
                "spacing_m": frame.resolution_m,
                "bounds": list(frame.bounds),
                "crs": frame.crs,
            },
            "provenance": provenance,
            **joined_figures(tiles),
        }
        wanted = self._store.finish(step.job_id, summary)
        if wanted and self._on_done is not None:
            self._on_done(step.job_id, planner)
        return wanted
