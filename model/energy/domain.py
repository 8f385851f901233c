"""The ranges that a model has learned, warnings for maps and robots outside of them, and the base of predictors."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

ROBOT_KEYS = ("mass_kg", "width_m", "length_m", "wheel_radius_m", "speed_mps", "rolling_resistance")
"""Fields of the robot file that a network knows; the hotel load over the weight is added to them."""

_TOLERANCE = 0.005  # of a limit: a value on the edge is inside
_SHARE_WARNED = 0.001  # of the map that must be too steep before a warning is given
_COMPARED = {  # what the prices of a model of measured runs depend on, in words
    "mass_kg": "{:.4g} kg",
    "rolling_resistance": "rolling resistance {:.3g}",
    "idle_power_w": "{:.4g} W idle",
}
_SAMPLE_CELLS = 4_000_000  # a larger map's slopes are judged on every n-th row and column


@dataclass(frozen=True)
class Domain:
    """Ranges (low, high) of what a model was trained on.

    Attributes
    ----------
    robot : dict of str to (float, float)
        By the keys of `ROBOT_KEYS` and "hotel_over_weight" (idle energy per metre over m g).
    resolution_m : (float, float)
        Metres per pixel of the heightmaps.
    max_slope_deg : float
        Steepest ground [degrees].
    payload_kg : (float, float)
        Logged load on top of the robot's mass [kg]. A model accounts for a logged load inside this range, and beyond it
        only when a calibration has found an effect of it.
    turned_rad : float
        Mean turn per segment that is in the model's prices [rad]: of models of version 0.1, which learned from straight
        segments alone, and nobody drives perfectly straight.
    driven : dict of str to (float, float)
        What the runs of a training on measured runs showed, without the lowest and the highest hundredth: "speed_mps",
        "turn_rad_per_m", "turn_radps", "grade_deg" (uphill positive). Empty where the model learned from no such runs.
    """

    robot: dict[str, tuple[float, float]]
    resolution_m: tuple[float, float]
    max_slope_deg: float
    payload_kg: tuple[float, float] = (0.0, 0.0)
    turned_rad: float = 0.0
    driven: dict[str, tuple[float, float]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the ranges, JSON-able."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Domain:
        """Make a domain of what `as_dict` wrote.

        Parameters
        ----------
        values : dict
            Ranges by name.

        Returns
        -------
        Domain
            The domain.

        Raises
        ------
        ModelError
            If a range is missing or is none.
        """
        try:
            robot = {str(k): (float(v[0]), float(v[1])) for k, v in values["robot"].items()}
            low, high = values["resolution_m"]
            least, most = values.get("payload_kg", (0.0, 0.0))
            return cls(
                robot,
                (float(low), float(high)),
                float(values["max_slope_deg"]),
                (float(least), float(most)),
                float(values.get("turned_rad", 0.0)),
                {str(k): (float(v[0]), float(v[1])) for k, v in (values.get("driven") or {}).items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise ModelError(f"the model does not say what it learned from: {error!r}") from error

    def joined(self, other: Domain) -> Domain:
        """Return the ranges that cover both: what a fine-tuned model knows.

        Parameters
        ----------
        other : Domain
            Of the runs that it was fine-tuned on.

        Returns
        -------
        Domain
            With the `turned_rad` and `driven` of the other one: costs of driving are fitted to its runs alone.
        """
        robot = dict(self.robot)
        for key, (low, high) in other.robot.items():
            mine = robot.get(key, (low, high))
            robot[key] = min(mine[0], low), max(mine[1], high)
        resolution = (
            min(self.resolution_m[0], other.resolution_m[0]),
            max(self.resolution_m[1], other.resolution_m[1]),
        )
        payload = min(self.payload_kg[0], other.payload_kg[0]), max(self.payload_kg[1], other.payload_kg[1])
        steepest = max(self.max_slope_deg, other.max_slope_deg)
        return Domain(robot, resolution, steepest, payload, other.turned_rad, dict(other.driven))

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Return one sentence for every value outside the ranges, with the value and the limits.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.

        Returns
        -------
        list of str
            Empty where everything is inside.
        """
        found = []
        values = {key: getattr(robot, key) for key in ROBOT_KEYS}
        values["hotel_over_weight"] = robot.hotel_per_m / robot.weight_n
        for key, (low, high) in self.robot.items():
            value = values[key]
            if not low * (1.0 - _TOLERANCE) <= value <= high * (1.0 + _TOLERANCE):
                label = "idle power / (speed x weight)" if key == "hotel_over_weight" else key
                found.append(f"{label} = {value:.3g} is outside the {low:.3g}..{high:.3g} the network learned")
        if "speed_mps" in self.driven:
            low, high = self.driven["speed_mps"]
            if not low * (1.0 - _TOLERANCE) <= robot.speed_mps <= high * (1.0 + _TOLERANCE):
                found.append(
                    f"speed_mps = {robot.speed_mps:.3g} is outside the {low:.3g}..{high:.3g} m/s of the runs that the "
                    "model was trained with"
                )
        low, high = self.resolution_m
        if not low * (1.0 - _TOLERANCE) <= heightmap.resolution_m <= high * (1.0 + _TOLERANCE):
            found.append(
                f"the heightmap's resolution of {heightmap.resolution_m:g} m/pixel is outside the {low:g}..{high:g} "
                "the network learned"
            )
        share = steep_share(heightmap, self.max_slope_deg)
        if share > _SHARE_WARNED:
            digits = 0 if share > 0.1 else 1
            found.append(
                f"{100.0 * share:.{digits}f} % of the map is steeper than the {self.max_slope_deg:.3g} degrees "
                "the network learned"
            )
        return found


def robot_warnings(trained: Mapping[str, Any], robot: Robot, *, model: str) -> list[str]:
    """Return a warning where a model of measured runs is asked about another robot than that of its runs.

    Speed, limits and names may differ: another declared speed is a question that a plan may ask.

    Parameters
    ----------
    trained : mapping
        The robot of the runs, by the keys of the robot file; empty where the model learned from no single robot.
    robot : Robot
        What the model is asked about.
    model : str
        What the model is called.

    Returns
    -------
    list of str
        One sentence with the value that differs most, or nothing.
    """
    most, words = _TOLERANCE, None
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


class Learned(ABC):
    """The part that all predictors of a trained network share.

    Parameters
    ----------
    name : str
        What the model is called.
    domain : Domain
        Ranges of what it was trained on.
    provenance : mapping
        What the predictor says of itself, JSON-able.
    spread : Spread, optional
        Its errors on held-out runs.
    costs : DriveCosts, optional
        Of turning, time and speeding up in its runs, beyond straight driving.
    """

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
        """Return one sentence for every way in which a map or robot differs from what the network learned.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.

        Returns
        -------
        list of str
            As `robot_warnings` and `Domain.warnings`.
        """
        training = (self._provenance.get("config") or {}).get("training") or {}
        trained = training.get("robot")
        other = robot_warnings(trained, robot, model=self.name) if isinstance(trained, Mapping) else []
        return [*other, *self.domain.warnings(heightmap, robot)]

    def robot_with_turning(self, robot: Robot) -> Robot:
        """Return the robot with the energy of turning that the model's runs showed.

        Parameters
        ----------
        robot : Robot
            As its file declares it.

        Returns
        -------
        Robot
            With another `turn_j_per_rad`: that at its declared speed, or at the nearest that the runs showed.
        """
        low, high = self.domain.driven.get("speed_mps", (0.0, math.inf))
        shown = replace(robot, speed_mps=min(max(robot.speed_mps, low), high))
        turn = robot.turn_j_per_rad + self.costs.planned_turn_j_per_rad(shown)
        return replace(robot, turn_j_per_rad=max(turn, 0.0))

    def drive_energy_j(self, robot: Robot, segments: Segments) -> NDArray[np.float64]:
        """Return what measured segments cost beyond going straight ahead at the declared speed.

        Parameters
        ----------
        robot : Robot
            As its file declares it.
        segments : Segments
            Measured.

        Returns
        -------
        ndarray of float64, (n,)
            Energy [J], to be added to the price of the ground: the declared cost of turning and the model's own costs.
        """
        usual = self.costs.planned_turn_j_per_rad(robot) * self.domain.turned_rad
        declared = robot.turn_j_per_rad * segments.turned_abs_rad
        return np.asarray(declared + self.costs.energy_j(robot, segments) - usual)

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Return the traction demand at the cell centres of a lattice.

        Parameters
        ----------
        heightmap, robot, frame, headings_rad : Heightmap, Robot, GridFrame, ndarray
            As `traction_and_std`.

        Returns
        -------
        ndarray of float32, (rows, cols, K)
            Traction demand [J/m]; NaN where the map is unknown.
        """
        return self.traction_and_std(heightmap, robot, frame, headings_rad)[0]

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> NDArray[np.float64]:
        """Return the traction demand of 1 m segments.

        Parameters
        ----------
        heightmap, robot, x, y, heading_rad : Heightmap, Robot, array_like
            As `segment_traction_and_std`.

        Returns
        -------
        ndarray of float64, (n,)
            Traction demand [J/m]; NaN where the map is unknown.
        """
        return self.segment_traction_and_std(heightmap, robot, x, y, heading_rad)[0]

    @abstractmethod
    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return traction and uncertainty at the cell centres of a lattice.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.
        frame : GridFrame
            Cells of the lattice.
        headings_rad : ndarray of float64, (K,)
            Headings [rad].

        Returns
        -------
        traction : ndarray of float32, (rows, cols, K)
            Traction demand [J/m]; NaN where the map is unknown.
        std : ndarray of float32, (rows, cols, K)
            Standard deviation of a 1 m segment's energy [J].
        """

    @abstractmethod
    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return traction and uncertainty of 1 m segments.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.
        x, y : array_like, (n,)
            Centres of the segments [m].
        heading_rad : array_like, (n,)
            Headings [rad].

        Returns
        -------
        traction : ndarray of float64, (n,)
            Traction demand [J/m]; NaN where the map is unknown.
        std : ndarray of float64, (n,)
            Standard deviation of the energy [J].
        """


def steep_share(heightmap: Heightmap, limit_deg: float) -> float:
    """Return the share of the known ground that is steeper than a limit.

    Slopes are central differences over a metre (or over the cell, where that is longer).

    Parameters
    ----------
    heightmap : Heightmap
        The ground.
    limit_deg : float
        The limit [degrees].

    Returns
    -------
    float
        0 to 1; 0 where nothing is known.
    """
    heights = heightmap.heights
    half = max(1, round(0.5 / heightmap.resolution_m))
    if min(heights.shape) < 2 * half + 1:
        return 0.0
    thin = max(1, math.isqrt(heights.size // _SAMPLE_CELLS))
    run = 2 * half * heightmap.resolution_m
    middle = slice(half, -half)
    east = (heights[middle, 2 * half :][::thin, ::thin] - heights[middle, : -2 * half][::thin, ::thin]) / run
    north = (heights[: -2 * half, middle][::thin, ::thin] - heights[2 * half :, middle][::thin, ::thin]) / run
    slope = np.hypot(east, north)
    known = np.isfinite(slope)
    if not known.any():
        return 0.0
    return float((slope[known] > math.tan(math.radians(limit_deg)) * (1.0 + _TOLERANCE)).mean())
