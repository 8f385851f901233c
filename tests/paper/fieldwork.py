"""The field of one seed: a robot, three sites and all drives of the paper, logged to files like a user's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

from joulemap.model.energy.examples import MAX_TURN_RAD, Examples, concatenate, cut_examples
from joulemap.model.field.drives import drive_along, lawnmower, random_waypoints
from joulemap.model.field.logger import Logger, log_trace
from joulemap.model.field.robot_dynamics import FieldRobot
from joulemap.model.field.simulation import Trace, simulate_segments, simulate_trace
from joulemap.model.field.sites import GROUNDS, Site, named_site
from joulemap.model.robot import Robot
from joulemap.model.runs.reader import read_run
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.surface_fit import fit_surface
from joulemap.model.terrain.writers import write_geotiff
from joulemap.model.training.simulated_set import level_ground, rolling_resistance_on
from joulemap.service.library.heightmaps import read_heightmap
from tests.paper.chords import read_chords
from tests.paper.measured import Measured
from tests.paper.profiles import Profile

FloatArray = NDArray[np.float64]

SITES = ("grass_a", "grass_b", "dirt")
SITE_OF = {
    "a_lawnmower": "grass_a",
    "a_waypoints": "grass_a",
    "a_short": "grass_a",
    "b_waypoints": "grass_b",
    "dirt_lawnmower": "dirt",
    "dirt_waypoints": "dirt",
}
"""The drives, and the site of each."""
HEIGHTMAPS = ("survey", "driven")

_DONE = "field.json"
_HOUR_S = 3600.0
_FITTED_REACH_M = 1.6  # a network reads nothing farther from the track


def robot_of(seed: int) -> FieldRobot:
    """Draw the robot of a field. Its declared mu is what an owner would measure on smooth, level ground of site A."""
    rng = np.random.default_rng([seed, 1])
    truth = FieldRobot.drawn(Robot(), rng)
    ground = GROUNDS["grass"]
    measured = rolling_resistance_on(level_ground(ground, rng), ground, truth)
    return replace(truth, declared=replace(truth.declared, rolling_resistance=round(measured, 4)))


def make_field(folder: Path, seed: int, profile: Profile) -> dict[str, Any]:
    """Simulate all drives of a field and write heightmaps, robot.toml and logs.

    Result: JSON-able: `metres` of every drive, and `roughness_m3` of every site's true terrain.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = robot_of(seed)
    robot = truth.declared
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in robot.as_dict().items()]
    (folder / "robot.toml").write_text("".join(lines), encoding="utf-8")
    rng = np.random.default_rng([seed, 2])
    explained: dict[str, FloatArray] = {}
    metres: dict[str, float] = {}
    roughness: dict[str, float] = {}
    for name in SITES:
        site = named_site(name, seed=seed, width_m=profile.width_m, height_m=profile.height_m)
        roughness[name] = roughness_m3(site.terrain)
        write_geotiff(folder / f"{name}.tif", site.survey)
        for drive, place in SITE_OF.items():
            if place != name:
                continue
            parts = []
            metres[drive] = 0.0
            for number, points in enumerate(_routes(drive, site, profile, rng), start=1):
                driven = drive_along(points, speed_mps=robot.speed_mps, rng=rng)
                trace = simulate_trace(site, truth, driven, rng=rng)
                start_s = _HOUR_S * number
                log = log_trace(trace, truth, rng=rng, terrain=site.ground.name, start_s=start_s)
                file = log.write_csv(folder / f"{drive}_{number:02d}.csv")
                segments = read_chords([file], robot, crs=site.survey.frame.crs)
                parts.append(explained_j(trace, segments, start_s))
                metres[drive] += driven.length_m
            explained[drive] = np.concatenate(parts)
    np.savez(folder / "explained.npz", **explained)  # type: ignore[arg-type]
    found = {"metres": {drive: round(length, 1) for drive, length in metres.items()}, "roughness_m3": roughness}
    (folder / _DONE).write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return found


def read_measured(
    folder: Path, drive: str, robot: Robot, *, heightmap_from: str = "survey", heightmap: Heightmap | None = None
) -> Measured:
    """Read a drive that `make_field` wrote."""
    site = SITE_OF[drive]
    files = _logs(folder, drive)
    if heightmap is None:
        heightmap = read_site_heightmap(folder, site, heightmap_from)
    segments = read_chords(files, robot, crs=heightmap.frame.crs)
    with np.load(folder / "explained.npz") as kept:
        explained = kept[drive]
    return Measured(site, heightmap, files, segments, explained)


def read_site_heightmap(folder: Path, site: str, heightmap_from: str) -> Heightmap:
    """Read a site's survey, or fit a surface to the positions of all drives over it, as in the paper."""
    survey = read_heightmap(folder / f"{site}.tif")
    if heightmap_from == "survey":
        return survey
    runs = [read_run(file) for drive, place in SITE_OF.items() if place == site for file in _logs(folder, drive)]
    x, y, z = (np.concatenate(parts) for parts in zip(*((r.x, r.y, r.extras["z"]) for r in runs), strict=True))
    return fit_surface(
        x, y, z, resolution_m=survey.resolution_m, smoothing_m=0.5, max_gap_m=_FITTED_REACH_M, crs=survey.frame.crs
    )


def more_examples(name: str, seed: int, profile: Profile, *, segments: int) -> Examples:
    """Simulate exact segments of this seed's robot on further sites, on their surveys.

    Half of them are driven in parallel lines, half between random waypoints, one run per site and kind.
    """
    truth = robot_of(seed)
    parts: list[Examples] = []
    while sum(len(part) for part in parts) < segments:
        number = len(parts) // 2
        rng = np.random.default_rng([seed, 3, number])
        site = named_site(name, seed=100 * seed + number, width_m=profile.width_m, height_m=profile.height_m)
        routes = (
            lawnmower(site.drivable, spacing_m=2.0 * profile.lane_m),
            random_waypoints(site.drivable, round(1.3 * profile.waypoints), rng),
        )
        for points in routes:
            driven = drive_along(points, speed_mps=truth.declared.speed_mps, rng=rng)
            found = simulate_segments(site, truth, driven, rng=rng)
            keep = np.abs(found.heading_change_rad) < MAX_TURN_RAD
            parts.append(
                cut_examples(
                    site.survey,
                    truth.declared,
                    found.x[keep],
                    found.y[keep],
                    found.heading_rad[keep],
                    found.energy_j[keep],
                    run=len(parts),
                )
            )
    return concatenate(parts)


def roughness_m3(terrain: Heightmap) -> float:
    """Compute the roughness of a terrain along north-south lines as ISO 8608 states that of a road.

    Result: displacement spectral density at 0.1 cycles/m [m3].

    The geometric mean of G(n) (n / 0.1)^2 over wavelengths of 0.5 to 5 m: the fit with the standard's exponent of 2.

    Reference: ISO 8608:2016, "Mechanical vibration - Road surface profiles - Reporting of measured data".
    """
    step = terrain.resolution_m
    frequency, density = periodogram(terrain.heights, fs=1.0 / step, window="hann", detrend="linear", axis=0)
    mean = density.mean(axis=1)
    band = (frequency >= 0.2) & (frequency <= 2.0)
    return float(np.exp(np.mean(np.log(mean[band] * (frequency[band] / 0.1) ** 2))))


def _logs(folder: Path, drive: str) -> tuple[Path, ...]:
    return tuple(sorted(folder.glob(f"{drive}_*.csv")))


def _routes(drive: str, site: Site, profile: Profile, rng: np.random.Generator) -> list[list[tuple[float, float]]]:
    """Corner points of every run of a drive."""
    west, south, east, north = site.drivable
    if drive.endswith("lawnmower"):
        edges = np.linspace(west, east, profile.strips + 1)
        return [
            lawnmower((a, south, b, north), spacing_m=profile.lane_m)
            for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
    if drive.endswith("short"):
        count = round(max(m for m in profile.curve_m if m <= 8 * profile.short_m) / profile.short_m)
        routes = []
        for _ in range(count):
            x, y = float(rng.uniform(west, east)), float(rng.uniform(south, north - profile.short_m))
            routes.append([(x, y), (x, y + profile.short_m)])
        return routes
    points = random_waypoints(site.drivable, profile.waypoints, rng)
    ends = np.linspace(0, len(points) - 1, profile.waypoint_runs + 1).round().astype(int).tolist()
    return [points[a : b + 1] for a, b in zip(ends[:-1], ends[1:], strict=True)]


def explained_j(trace: Trace, segments: Segments, start_s: float) -> FloatArray:
    """Explained energy [J] between the ends of measured segments, at the true power of those moments."""
    clock = trace.t + Logger().standing_s + start_s
    total = trace.energy_j(trace.explained_w)
    ends = (np.interp(segments.t0 + extra, clock, total) for extra in (0.0, segments.duration_s))
    begin, end = ends
    return np.asarray(end - begin)
