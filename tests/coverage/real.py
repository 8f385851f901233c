"""Routes of real robots, with whole campaigns left out: Cuadriga on a hillside, DRIVE on grass and asphalt."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import fit_spread
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import CalibrationRuns, read_calibration_runs
from joulemap.model.runs.sites import Site
from joulemap.service.library.heightmaps import heightmap_from_runs, read_heightmap
from joulemap.service.loop.calibration import campaigns_of
from joulemap.service.loop.measured import measure
from tests.coverage.scores import Held, Judged, judged

WARTHOG = Robot(
    name="warthog",
    mass_kg=470.0,
    width_m=1.4,
    length_m=1.5,
    wheel_radius_m=0.3,
    nominal_voltage_v=48.0,
    speed_mps=1.5,
    idle_power_w=100.0,
    rolling_resistance=0.05,
)


def real_folder() -> Path | None:
    """The folder of real recordings; None where it is absent."""
    named = os.environ.get("JOULEMAP_REAL_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "real"
    return folder if folder.is_dir() else None


def cuadriga(folder: Path) -> tuple[CalibrationRuns, list[str]]:
    """All runs, and the campaign of each."""
    ground = read_heightmap(folder / "cuadriga" / "uma_rescue_area_1m.tif")
    files = tuple(sorted((folder / "cuadriga" / "runs").glob("*.csv")))
    runs = read_calibration_runs([Site(ground, files, Robot())])
    return runs, campaigns_of(runs.segments.runs)


def drive(folder: Path) -> tuple[CalibrationRuns, list[str]]:
    """All runs, each on the surface through its own positions; every run is of another day."""
    files = sorted((folder / "drive").glob("*.csv"))
    runs = read_calibration_runs([Site(heightmap_from_runs([file]), (file,), WARTHOG) for file in files])
    return runs, list(runs.segments.runs)


def left_out(runs: CalibrationRuns, campaigns: Sequence[str]) -> dict[str, tuple[Held, Held]]:
    """By campaign: what a calibration of `physics` without it says of its own runs, each campaign left out in turn,
    and of the campaign.
    """
    measured = measure("physics", PhysicsPredictor(), runs)
    rows = measured.residuals
    names, number = np.unique(np.asarray(campaigns), return_inverse=True)
    group = number[rows.run]
    found = {}
    for k, name in enumerate(names):
        train, test = np.flatnonzero(group != k), np.flatnonzero(group == k)
        electric = {key: values[train] for key, values in measured.electric.items()}
        model = calibrate(rows.take(train), electric=electric, groups=campaigns)
        said = model.states(rows.take(test))["proposed"]
        parts = []
        for index, energy in ((train, model.held_out["proposed"]), (test, said)):
            moving = rows.moving[index]
            columns = rows.measured[index], energy, measured.std[index], rows.run[index], group[index]
            parts.append(Held(*(column[moving] for column in columns)))
        found[str(name)] = (parts[0], parts[1])
    return found


def routes_of(found: dict[str, tuple[Held, Held]]) -> list[Judged]:
    """The routes of every campaign, by the spread that the others show."""
    out = []
    for name, (train, test) in found.items():
        spread = fit_spread(train.measured, train.predicted, train.std, train.run, group=train.group)
        out.append(judged(name, spread, test, shortest=20, longest=100))
    return out


def keep(folder: Path, found: dict[str, tuple[Held, Held]]) -> None:
    """Write predictions, so that another look at them takes a second."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, parts in found.items():
        columns = {
            f"{part}_{field.name}": getattr(held, field.name)
            for part, held in zip(("train", "test"), parts, strict=True)
            for field in fields(Held)
        }
        np.savez_compressed(folder / f"{name}.npz", **columns)


def kept(folder: Path) -> dict[str, tuple[Held, Held]]:
    """What `keep` wrote; empty where there is nothing."""
    found = {}
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as read:
            parts = [Held(*(read[f"{part}_{field.name}"] for field in fields(Held))) for part in ("train", "test")]
        found[file.stem] = (parts[0], parts[1])
    return found
