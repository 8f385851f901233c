"""What every experiment of the reproduction works on: where it is kept, its test sets, and the scores of methods."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.robot import Robot
from tests.paper.fieldwork import HEIGHTMAPS, read_measured
from tests.paper.measured import Measured, judged
from tests.paper.profiles import Profile

FloatArray = NDArray[np.float64]

ROWS = ("V-A", "V-B", "V-C", "V-D", "V-E", "V-E shifted", "V-E rest", "V-E other")
"""Test sets. V-D is the test set of V-A, for friction that is fitted to five metres and used on the next five."""

_DRIVE_OF = {"V-B": "a_waypoints", "V-C": "b_waypoints", "V-E": "dirt_lawnmower", "V-E other": "dirt_waypoints"}


@dataclass(frozen=True)
class Setting:
    """Where a reproduction is kept, and how much of it is run.

    Attributes
    ----------
    folder : Path
        Of the reproduction.
    profile : Profile
        Its extent.
    heightmap_from : str
        One of `HEIGHTMAPS`.
    weights : Path, optional
        An ImageNet file for the paper's network.
    """

    folder: Path
    profile: Profile
    heightmap_from: str = "survey"
    weights: Path | None = None

    def field(self, seed: int) -> Path:
        """Return the folder of a seed's heightmaps and logs."""
        return self.folder / "field" / str(seed)

    def model(self, name: str, seed: int) -> Path:
        """Return the folder of a trained network."""
        return self.folder / "models" / f"{name}_{seed}"

    @property
    def other_heightmap(self) -> str:
        """The kind of heightmap that this reproduction does not use."""
        return next(kind for kind in HEIGHTMAPS if kind != self.heightmap_from)


class Scores:
    """Errors and predictions of methods. `arrays`: every prediction [J] by "method/row"."""

    def __init__(self) -> None:
        self.methods: dict[str, dict[str, Any]] = {}
        self.arrays: dict[str, FloatArray] = {}

    def add(self, method: str, row: str, predicted: FloatArray, measured: Measured) -> None:
        """Judge the predictions of a method on a test set. `predicted` (n,): energy of every segment [J]."""
        self.methods.setdefault(method, {})[row] = judged(predicted, measured)
        self.arrays[f"{method}/{row}"] = predicted

    def add_shifted(self, method: str, predicted: FloatArray, measured: Measured) -> None:
        """Judge predictions after the mean shift of section V-E, e_hat - mean(e_hat) + mean(e).

        `predicted` (n,): energy of every segment [J].
        """
        known = np.isfinite(predicted) & measured.straight
        off = float(np.mean(measured.segments.energy_j[known] - predicted[known]))
        self.add(method, "V-E shifted", predicted + off, measured)


class Field:
    """The measured drives of one seed, divided into training and test sets as in the paper."""

    def __init__(self, setting: Setting, seed: int, *, heightmap_from: str | None = None) -> None:
        self.folder = setting.field(seed)
        self.robot = Robot.from_toml(self.folder / "robot.toml")
        self._kind = heightmap_from or setting.heightmap_from
        self._west = setting.profile.west_strips
        self._kept: dict[str, Measured] = {}

    def drive(self, name: str) -> Measured:
        """Return a whole drive. Drives on one site share their heightmap."""
        if name not in self._kept:
            site = name.split("_")[0]
            known = next((m.heightmap for key, m in self._kept.items() if key.split("_")[0] == site), None)
            self._kept[name] = read_measured(self.folder, name, self.robot, heightmap_from=self._kind, heightmap=known)
        return self._kept[name]

    def west(self, drive: str) -> Measured:
        """Return the west third of a drive, the training set."""
        return self.drive(drive).of_runs(0, self._west)

    def test(self, row: str) -> Measured:
        """Return a test set."""
        if row in ("V-A", "V-D"):
            return self.drive("a_lawnmower").of_runs(self._west)
        if row == "V-E rest":
            return self.drive("dirt_lawnmower").of_runs(self._west)
        return self.drive(_DRIVE_OF[row.removesuffix(" shifted")])
