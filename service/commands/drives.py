"""Which measured runs a command looks at, on which ground and of which robot: options that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.options import (
    BaselineRuns,
    Campaign,
    MaybeHeightmap,
    MaybeRuns,
    ModelName,
    ReadingWithLayers,
    RobotFile,
    Sites,
    reading_words,
)

if TYPE_CHECKING:
    from joulemap.model.robot import Robot
    from joulemap.model.runs.calibration_runs import CalibrationRuns
    from joulemap.model.runs.sites import Site

OdometryTrack = Annotated[
    float | None,
    typer.Option(
        "--odometry",
        metavar="TRACK",
        help="The runs have wheel speeds of both sides and no positions: integrate `speed_left` and `speed_right` on "
        "level ground, with this effective track width [m].",
    ),
]
TerrainFromName = Annotated[
    bool, typer.Option("--terrain-from-name", help="With `--odometry`: the file snow_02.csv was driven on snow.")
]


def _currents(text: str) -> str:
    ways = ("auto", "signed", "magnitude")
    if text not in ways:
        raise typer.BadParameter(f"{text!r} is none of {', '.join(ways)}")
    return text


SumOfCurrents = Annotated[
    Any,
    typer.Option(
        "--currents",
        parser=_currents,
        metavar="auto|signed|magnitude",
        help="How the currents of several motors are summed: with their sign, without it, or as the log tells.",
    ),
]


@dataclass(frozen=True)
class Drives:
    """Runs, their ground and their robot, as the options name them."""

    reading: ReadingWithLayers
    heightmap: MaybeHeightmap = None
    runs: MaybeRuns = None
    site: Sites = None
    campaign: Campaign = None
    robot: RobotFile = None

    @property
    def named(self) -> bool:
        """Whether anything is named."""
        return self._ways > 0

    @property
    def _ways(self) -> int:
        """In how many ways runs are named."""
        return sum((self.heightmap is not None or bool(self.runs), bool(self.site), self.campaign is not None))

    @property
    def given(self) -> dict[str, Any]:
        """What is named, as the functions of the library take it."""
        from joulemap.service.library.heightmaps import read_heightmap
        from joulemap.service.library.sites import sites_of_options

        if self.heightmap is not None and not self.runs:
            raise typer.BadParameter("--heightmap and --runs go together")
        named = sites_of_options(self.site or ())
        return {
            "ground": None if self.heightmap is None else read_heightmap(self.heightmap, **self.reading),
            "runs": self.runs or None,
            "sites": [(read_heightmap(ground, **self.reading), files) for ground, files in named] or None,
            "campaign": self.campaign,
            "robot": self.robot,
        }

    def sites(self) -> list[Site]:
        """The sites that are named: at least one."""
        from joulemap.service.library.sites import sites_given

        if self._ways != 1:
            raise typer.BadParameter("give --heightmap and --runs, or --site, or --campaign")
        return sites_given(**self.given)


@dataclass(frozen=True)
class ComparedDrives(Drives):
    """Runs that are compared with a model, and how they are read."""

    model: ModelName = "default"
    baseline_runs: BaselineRuns = None
    odometry: OdometryTrack = None
    terrain_from_name: TerrainFromName = False
    currents: SumOfCurrents = "auto"

    def __post_init__(self) -> None:
        if self._ways > 1:
            raise typer.BadParameter("give one of --runs (with --heightmap or without), --site and --campaign")
        if not self._ways:
            raise typer.BadParameter(
                "give --runs, and the map that they were driven on with --heightmap; or --site, or --campaign. Runs "
                "with a speed or a distance and no positions need no map"
            )
        if self.odometry is not None and (self.heightmap is not None or not self.runs):
            raise typer.BadParameter("--odometry is for runs without positions, which lie on no map: give --runs alone")
        if self.terrain_from_name and self.odometry is None:
            raise typer.BadParameter("--terrain-from-name goes with --odometry")
        if self.baseline_runs and (self.site or self.campaign):
            raise typer.BadParameter(
                "--baseline-runs goes with --runs; in a campaign file a site has the key `baseline`"
            )

    def read(self, test_runs: list[str] | None = None) -> CalibrationRuns:
        """The runs, on their maps or on the ground that their logs describe."""
        from joulemap.model.runs.odometry import Odometry
        from joulemap.service.library.sites import read_compared

        how = None if self.odometry is None else Odometry(self.odometry, self.terrain_from_name)
        more: dict[str, Any] = {"baseline_runs": self.baseline_runs, "test_runs": test_runs}
        return read_compared(self.given, **more, odometry=how, currents=self.currents)

    def words(self) -> list[str]:
        """The options again, as they are typed."""
        words = ["--model", self.model]
        for name, value in (
            ("--heightmap", self.heightmap),
            ("--campaign", self.campaign),
            ("--odometry", self.odometry),
            ("--robot", self.robot),
        ):
            words += [] if value is None else [name, str(value)]
        words += ["--terrain-from-name"] * self.terrain_from_name + reading_words(self.reading)
        for name, values in (("--site", self.site), ("--runs", self.runs), ("--baseline-runs", self.baseline_runs)):
            words += [name, *values] if values else []
        return words if self.currents == "auto" else [*words, "--currents", self.currents]

    def ground_words(self, document: Mapping[str, Any], robot: Robot) -> list[str]:
        """The map that the report's route is on and the robot, as a cost map needs them."""
        from joulemap.model.robot import Robot as Declared
        from joulemap.service.library.sites import sites_of_options

        number = next(k for k, site in enumerate(document["sites"]) if site["main"])
        ground, usual = self.heightmap, self.robot
        if self.site:
            ground = sites_of_options(self.site)[number][0]
        elif self.campaign is not None:
            beside = self.campaign.parent / document["sites"][number]["heightmap"]
            ground = beside if beside.is_file() else None
            usual = usual or (None if robot == Declared() else Path("ROBOT"))
        words = [str(ground or "HEIGHTMAP"), *([] if self.campaign or ground is None else reading_words(self.reading))]
        return words if usual is None else [*words, "--robot", str(usual)]
