"""A drive as measured, and how what is said of it is judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.examples import MAX_TURN_RAD
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.evaluation import errors

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """One drive as measured, with the map its site has.

    files : the logs, one per run. segments : all of them. explained_j : (n,) what perfect knowledge of ground, robot
    and driving would have said of each segment [J].
    """

    site: str
    heightmap: Heightmap
    files: tuple[Path, ...]
    segments: Segments
    explained_j: FloatArray

    @property
    def straight(self) -> NDArray[np.bool_]:
        """Segments without a turn: the paper's kind."""
        return np.abs(self.segments.heading_change_rad) < MAX_TURN_RAD

    def of_runs(self, first: int, stop: int | None = None) -> Measured:
        """The runs first..stop - 1, numbered anew."""
        runs = self.segments.runs[first:stop]
        mine = (self.segments.run >= first) & (self.segments.run < first + len(runs))
        taken = self.segments.take(mine)
        taken = replace(taken, run=taken.run - first, runs=runs)
        return replace(self, files=self.files[first:stop], segments=taken, explained_j=self.explained_j[mine])


def judged(predicted: FloatArray, measured: Measured) -> dict[str, Any]:
    """`errors` on the straight segments; whole routes (route_relative_error, site_relative_error of the whole set) and
    `with_turns`, the mean relative error, on all of them; straight_route_relative_error on the straight ones.
    """
    energy, run = measured.segments.energy_j, measured.segments.run
    known = np.isfinite(predicted)
    straight = known & measured.straight
    found = errors(predicted[straight], energy[straight], run[straight])
    whole = errors(predicted[known], energy[known], run[known])
    return found | {
        "straight_route_relative_error": found["route_relative_error"],
        "route_relative_error": whole["route_relative_error"],
        "route_relative_errors": whole["route_relative_errors"],
        "site_relative_error": float(abs(predicted[known].sum() / energy[known].sum() - 1.0)),
        "with_turns": whole["mean_relative_error"],
        "unknown": int((~known).sum()),
    }
