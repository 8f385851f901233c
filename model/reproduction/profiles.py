"""How much of the reproduction is run: sizes of the field and lengths of the trainings."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

FIRST_SEED = 1001
"""Seeds count from here. The simulated ground was made hard enough on seed 0, which is therefore none of them."""

STRATEGIES = ("frozen", "scratch", "finetuned")
"""The paper's three ways to train its network (section IV-C)."""


@dataclass(frozen=True)
class Profile:
    """One extent of the reproduction.

    width_m, height_m : of every site; lane_m : between the lines of a lawnmower; strips : runs that a site's lawnmower
    is driven in, the first third of which is the west third of the site. waypoints : of a random drive, in
    waypoint_runs runs. curve_m : driven metres of the learning curve; its short drives are short_m long. more : how
    many times the paper's training data the map floor learns from, in more_epochs. compact_epochs : at most.
    resnet_size : rows of the paper network's patch; resnet_seeds : of the seeds, for how many that network is trained;
    resnet_epochs by strategy, dirt_epochs on the new ground. backbone_sites, backbone_epochs : of the pre-training on
    simulated terrain.
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
"""By name. `quick` only shows that everything runs: its numbers mean nothing."""
