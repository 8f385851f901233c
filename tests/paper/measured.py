"""A measured drive, and the errors of predictions for it."""

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
    """One measured drive with the map of its site.

    Attributes
    ----------
    site : str
        Name of the site.
    heightmap : Heightmap
        Its ground.
    files : tuple of Path
        The logs, one per run.
    segments : Segments
        Of all runs.
    explained_j : ndarray of float64, (n,)
        Energy of each segment with perfect knowledge of ground, robot and driving [J]; NaN where nobody knows.
    """

    site: str
    heightmap: Heightmap
    files: tuple[Path, ...]
    segments: Segments
    explained_j: FloatArray

    @property
    def straight(self) -> NDArray[np.bool_]:
        """Mask of the segments without a turn, which the paper uses, (n,)."""
        return np.abs(self.segments.heading_change_rad) < MAX_TURN_RAD

    def of_runs(self, first: int, stop: int | None = None) -> Measured:
        """Return some of the runs, numbered from 0."""
        runs = self.segments.runs[first:stop]
        mine = (self.segments.run >= first) & (self.segments.run < first + len(runs))
        taken = self.segments.take(mine)
        taken = replace(taken, run=taken.run - first, runs=runs)
        return replace(self, files=self.files[first:stop], segments=taken, explained_j=self.explained_j[mine])


def judged(predicted: FloatArray, measured: Measured) -> dict[str, Any]:
    """Judge predictions for a drive.

    `predicted` (n,): energy of every segment [J], NaN where unknown. Result: the numbers of `errors` on the straight
    segments, and straight_route_relative_error. On all segments: route_relative_error of whole runs,
    site_relative_error of the whole drive, and with_turns, the mean relative error. unknown : number of segments
    without a prediction.
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
