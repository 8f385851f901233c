"""The extent of a reproduction: sizes of the field and lengths of the trainings."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

FIRST_SEED = 1001
"""Seeds count from here. The hardness of the simulated ground was chosen on seed 0, which is therefore not used."""

STRATEGIES = ("frozen", "scratch", "finetuned")
"""The paper's three ways to train its network (section IV-C)."""


@dataclass(frozen=True)
class Profile:
    """One extent of a reproduction.

    Attributes
    ----------
    name : str
        Of the profile.
    seeds : int
        Number of fields.
    width_m, height_m : float
        Size of every site [m].
    lane_m : float
        Distance of the parallel lines of a lawnmower drive [m].
    strips : int
        Runs of a lawnmower drive; the first third of them is the west third of the site.
    waypoints, waypoint_runs : int
        Points of a random drive, and runs that it is divided into.
    curve_m : tuple of int
        Driven distances of the learning curve [m].
    short_m : float
        Length of its short drives [m].
    more : int
        How many times the paper's training data the map floor learns from.
    more_epochs, compact_epochs : int
        Passes over the data, at most.
    resnet_size : int
        Rows and columns of a patch of the paper's network.
    resnet_seeds : int
        Number of fields on which the paper's network is trained.
    resnet_epochs : tuple of int
        By strategy.
    dirt_epochs : int
        On the new ground.
    backbone_sites, backbone_epochs : int
        Of the pre-training on simulated terrain.
    """

    name: str
    seeds: int = 5
    width_m: float = 60.0
    height_m: float = 40.0
    lane_m: float = 0.5
    strips: int = 15
    waypoints: int = 60
    waypoint_runs: int = 6
    curve_m: tuple[int, ...] = (0, 50, 200, 1000, 4400)
    short_m: float = 25.0
    more: int = 20
    more_epochs: int = 20
    compact_epochs: int = 12
    resnet_size: int = 64
    resnet_seeds: int = 1
    resnet_epochs: tuple[int, int, int] = (30, 30, 20)
    dirt_epochs: int = 20
    backbone_sites: int = 80
    backbone_epochs: int = 4

    @property
    def west_strips(self) -> int:
        """Runs in the west third."""
        return self.strips // 3

    def as_dict(self) -> dict[str, Any]:
        """Return all values, JSON-able."""
        return asdict(self)


PROFILES = {
    "default": Profile("default"),
    "full": Profile("full", resnet_size=256, resnet_seeds=5, resnet_epochs=(30, 30, 30), backbone_sites=40),
    "quick": Profile(
        "quick",
        seeds=2,
        width_m=18.0,
        height_m=12.0,
        lane_m=1.0,
        strips=6,
        waypoints=8,
        waypoint_runs=2,
        curve_m=(0, 20, 60),
        short_m=6.0,
        more=2,
        more_epochs=1,
        compact_epochs=1,
        resnet_size=32,
        resnet_epochs=(1, 1, 1),
        dirt_epochs=1,
        backbone_sites=1,
        backbone_epochs=1,
    ),
}
"""Profiles by name. `quick` only shows that everything runs: its numbers mean nothing."""
