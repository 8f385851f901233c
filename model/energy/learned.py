"""What all predictors of a trained network share: what it learned from, its costs of driving, its warnings."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.domain import TOLERANCE, Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

_COMPARED = {  # what the prices of a model of measured runs depend on, in words
    "mass_kg": "{:.4g} kg",
    "rolling_resistance": "rolling resistance {:.3g}",
    "idle_power_w": "{:.4g} W idle",
}


class Learned(ABC):
    """The part that all predictors of a trained network share."""

    def __init__(
        self,
        name: str,
        domain: Domain,
        provenance: Mapping[str, Any],
        *,
        spread: Spread | None = None,
        costs: DriveCosts | None = None,
    ) -> None:
        self.name = name
        self.domain = domain
        self.spread = spread or Spread()
        self.costs = costs or DriveCosts()
        self._provenance = dict(provenance)

    def provenance(self) -> dict[str, Any]:
        """Return what the predictor is, JSON-able."""
        return {"name": self.name, "spread": self.spread.as_dict(), **self._provenance}

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Return one sentence for every way in which a map or robot differs from what the network learned."""
        training = (self._provenance.get("config") or {}).get("training") or {}
        trained = training.get("robot")
        other = robot_warnings(trained, robot, model=self.name) if isinstance(trained, Mapping) else []
        return [*other, *self.domain.warnings(heightmap, robot)]

    def robot_with_turning(self, robot: Robot, kinds: Mapping[str, float] | None = None) -> Robot:
        """Return the robot with the energy of turning that the model's runs showed, whatever the kinds of ground.

        Result: with another `turn_j_per_rad`: that at its declared speed, or at the nearest that the runs showed.
        """
        low, high = self.domain.driven.get("speed_mps", (0.0, math.inf))
        shown = replace(robot, speed_mps=min(max(robot.speed_mps, low), high))
        turn = robot.turn_j_per_rad + self.costs.planned_turn_j_per_rad(shown)
        return replace(robot, turn_j_per_rad=max(turn, 0.0))

    def drive_energy_j(self, robot: Robot, segments: Segments) -> NDArray[np.float64]:
        """Return what measured segments cost beyond going straight ahead at the declared speed.

        Result (n,): energy [J], to be added to the price of the ground: the declared cost of turning and the model's
        own costs.
        """
        usual = self.costs.planned_turn_j_per_rad(robot) * self.domain.turned_rad
        declared = robot.turn_j_per_rad * segments.turned_abs_rad
        return np.asarray(declared + self.costs.energy_j(robot, segments) - usual)

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Return the traction demand at the cell centres of a lattice.

        Result (rows, cols, K): traction demand [J/m]; NaN where the map is unknown.
        """
        return self.traction_and_std(heightmap, robot, frame, headings_rad)[0]

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> NDArray[np.float64]:
        """Return the traction demand of 1 m segments.

        Result (n,): traction demand [J/m]; NaN where the map is unknown.
        """
        return self.segment_traction_and_std(heightmap, robot, x, y, heading_rad)[0]

    @abstractmethod
    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return traction and uncertainty at the cell centres of a lattice.

        `headings_rad` is (K,). Returns `traction` (rows, cols, K): traction demand [J/m], NaN where the map is unknown;
        `std` (rows, cols, K): standard deviation of a 1 m segment's energy [J].
        """

    @abstractmethod
    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return traction and uncertainty of 1 m segments.

        `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,). Returns `traction` (n,): traction demand [J/m],
        NaN where the map is unknown; `std` (n,): standard deviation of the energy [J].
        """


def robot_warnings(trained: Mapping[str, Any], robot: Robot, *, model: str) -> list[str]:
    """Return a warning where a model of measured runs is asked about another robot than that of its runs.

    Speed, limits and names may differ: another declared speed is a question that a plan may ask.

    `trained`: the robot of the runs, by the keys of the robot file, empty where the model learned from no single robot.
    Result: one sentence with the value that differs most, or nothing.
    """
    most, words = TOLERANCE, None
    for key, unit in _COMPARED.items():
        try:
            then, now = float(trained[key]), float(getattr(robot, key))
        except (KeyError, TypeError, ValueError):  # an older model, or a file that somebody wrote
            continue
        difference = abs(now - then) / max(abs(now), abs(then), 1e-9)
        if difference > most:
            most, words = difference, (unit.format(now), unit.format(then))
    if words is None:
        return []
    return [
        f"this robot is {robot.name} ({words[0]}), but the model {model} was trained with "
        f"{trained.get('name', 'another robot')} ({words[1]}): give that robot's file, or expect errors"
    ]
