"""What all predictors of a trained network share: what it learned from, its costs of driving, its warnings."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.domain import TOLERANCE, Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.drivetrain import SIMULATED
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


@dataclass(frozen=True)
class Facts:
    """What is known of a trained network beside its weights."""

    domain: Domain  # what it was trained on
    size: int  # rows and columns of its input
    name: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)  # what its predictor says of itself, JSON-able
    spread: Spread = field(default_factory=Spread)  # its errors on held-out runs
    costs: DriveCosts = field(default_factory=DriveCosts)  # of turning, time and speeding up


class Learned(ABC):
    """The part that all predictors of a trained network share."""

    def __init__(self, facts: Facts) -> None:
        self.name, self.domain, self.spread, self.costs = facts.name, facts.domain, facts.spread, facts.costs
        self._provenance = dict(facts.provenance)

    def provenance(self) -> dict[str, Any]:
        """Return what the predictor is, JSON-able."""
        of_runs = {"heightmaps": self._training["heightmaps"]} if "heightmaps" in self._training else {}
        return {"name": self.name, "spread": self.spread.as_dict(), **of_runs, **self._provenance}

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Return one sentence for every way in which a map or robot differs from what the network learned."""
        trained = self._training.get("robot")
        other = robot_warnings(trained, robot, model=self.name) if isinstance(trained, Mapping) else []
        if robot.drivetrain_efficiency > 0.0 and not self.drivetrain_efficiency:
            other.append(
                f"the drivetrain efficiency of {robot.drivetrain_efficiency:g} is not used: {self.name} learned what "
                "climbs cost from runs of a robot that declared none"
            )
        return [*other, *self.domain.warnings(heightmap, robot)]

    @property
    def _training(self) -> Mapping[str, Any]:
        return (self._provenance.get("config") or {}).get("training") or {}

    @property
    def drivetrain_efficiency(self) -> float:
        """That of the robot whose runs it learned from, 0 where that was not declared; of simulated ones the mean."""
        trained = self._training.get("robot")
        return float(trained.get("drivetrain_efficiency", 0.0)) if isinstance(trained, Mapping) else SIMULATED

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
