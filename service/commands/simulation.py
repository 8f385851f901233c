"""`joulemap simulate`: drives of a robot on simulated ground, with the faults that real logs have."""

from __future__ import annotations

import json
from collections.abc import Iterator
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.options import RobotFile, robot_of
from joulemap.service.words import runs_words

if TYPE_CHECKING:
    from joulemap.model.robot import Robot


def _one_of(registry: str, *more: str) -> Any:
    """The type of a name in a registry of the simulated field, which is loaded when this command is made."""
    module, _, name = registry.partition(":")
    names = (*getattr(import_module(f"joulemap.model.field.{module}"), name), *more)
    return StrEnum(name, {each: each for each in names})


def simulate(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for dem.tif, robot.toml and run_NN.csv.")],
    site: Annotated[
        _one_of("sites:SITES", "random"),  # type: ignore[valid-type]
        typer.Option(help="Two grass sites, a dirt site, or one drawn by the seed."),
    ] = "grass_a",
    drive: Annotated[
        Literal["lawnmower", "waypoints"],
        typer.Option(help="Parallel lines, or from one random point to the next."),
    ] = "lawnmower",
    survey: Annotated[
        _one_of("sites:SURVEYS") | None,  # type: ignore[valid-type]
        typer.Option(
            help="Who surveyed dem.tif, of the same ground: a scanner on a tripod (noise of 4 mm, cells of 0.1 m), the "
            "robot's own lidar (20 mm, 0.1 m), a drone's camera (30 mm, alike over 0.2 m, 0.1 m), lidar from an "
            "aircraft (50 mm, 0.5 m) or a country's terrain model (100 mm, 1 m). [default: scanner, for a random site "
            "with cells of 0.05 to 1 m]",
        ),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, max=99, metavar="N", help="Number of runs.")] = 4,
    robot: RobotFile = None,
    hidden: Annotated[
        list[_one_of("hidden_draws:EFFECT_NAMES")] | None,  # type: ignore[valid-type]
        typer.Option(
            metavar="EFFECT...",
            help="Effects at work in the runs that no file declares: "
            f"{', '.join(_one_of('hidden_draws:EFFECT_NAMES'))}. Their strength is drawn by the seed.",
        ),
    ] = None,
    day: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Another day has other drives and other weather; site, survey and robot stay the same. "
            "[default: 1, with `--hidden` 2]",
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="The same seed gives the same site and robot, and on the same day the same runs."
        ),
    ] = 0,
    json_file: JsonFile = None,
) -> None:
    """Simulate **measured runs**: a robot, a site, a battery, and a 10 Hz logger with noise, gaps and spikes.

    The robot's true mass and losses differ a little from what its file declares. Without `--robot`, robot.toml declares
    the rolling resistance that its owner would measure on smooth level ground of that site.

    Examples:

    `joulemap simulate --out field --site dirt --drive waypoints --runs 6`

    `joulemap simulate --out new --hidden turning` (the site and the robot of `joulemap simulate --out base`)
    """
    from dataclasses import replace

    import numpy as np

    from joulemap.model.field.days import simulate_day
    from joulemap.model.field.drives import Drive, drive_along, lawnmower, random_waypoints
    from joulemap.model.field.logger import RunLog, simulate_run
    from joulemap.model.field.robot_dynamics import FieldRobot
    from joulemap.model.field.sites import SURVEYS, named_site, random_site
    from joulemap.model.terrain.survey import degrade
    from joulemap.model.terrain.writers import write_geotiff
    from joulemap.model.training.simulated_set import level_ground, rolling_resistance_on

    output = Output(json_file)
    rng = np.random.default_rng([seed, 1])
    place = random_site(np.random.default_rng(seed)) if site == "random" else named_site(site, seed=seed)
    if survey is not None:
        place = replace(place, survey=degrade(place.terrain, SURVEYS[survey], rng=np.random.default_rng([seed, 3])))
    declared = robot_of(robot)
    truth = FieldRobot.drawn(declared, rng)
    if robot is None:
        measured = rolling_resistance_on(level_ground(place.ground, rng), place.ground, truth)
        declared = replace(declared, rolling_resistance=round(measured, 4))
    out.mkdir(parents=True, exist_ok=True)
    write_geotiff(out / "dem.tif", place.survey)
    write_file(out / "robot.toml", _toml(declared).encode())
    today = day or (2 if hidden else 1)
    if today > 1 or hidden:
        rng = np.random.default_rng([seed, 2, today])
    files, drives = [], list[Drive]()
    west, south, east, north = place.drivable

    def driven() -> Iterator[Drive]:
        for number in range(1, runs + 1):
            if drive == "lawnmower":  # each run its own strip of the site, as a day in the field is shared out
                strip = west + (east - west) * (number - 1) / runs, south, west + (east - west) * number / runs, north
                points = lawnmower(strip, spacing_m=2.0)
            else:
                points = random_waypoints(place.drivable, 20, rng)
            drives.append(drive_along(points, speed_mps=declared.speed_mps, rng=rng))
            yield drives[-1]

    def logged() -> Iterator[RunLog]:
        if today > 1 or hidden:
            yield from simulate_day(place, truth, driven(), day=today, hidden=hidden or (), rng=rng)
        else:
            for number, one in enumerate(driven(), start=1):
                yield simulate_run(place, truth, one, rng=rng, start_s=3600.0 * number)

    with progress_bar("Driving") as report:
        for number, log in enumerate(logged(), start=1):
            files.append(str(log.write_csv(out / f"run_{number:02d}.csv")))
            report(number / runs)
    metres = sum(one.length_m for one in drives)
    output.say(f"{runs_words(runs)} over {site}, {metres:.0f} m in all, written to {out}", head="Simulated")
    output.document(
        {
            "heightmap": str(out / "dem.tif"),
            "robot": str(out / "robot.toml"),
            "runs": files,
            "length_m": metres,
            "seed": seed,
            "survey": survey,
            "day": today,
            "hidden": list(map(str, hidden or ())),
        }
    )


def _toml(robot: Robot) -> str:
    """A robot file. JSON's texts and numbers are TOML's too."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in robot.as_dict().items())
