"""Three kinds of ground hidden in a simulated meadow: given as a layer they are learned, and hold on another meadow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.residuals_of_runs import residuals_on
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.logger import simulate_run
from joulemap.model.field.robot_dynamics import FieldRobot
from joulemap.model.field.sites import Site as FieldSite
from joulemap.model.field.sites import named_site
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import read_calibration_runs
from joulemap.model.runs.residuals import Residuals
from joulemap.model.runs.sites import Site
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers.kinds import Kind
from joulemap.model.terrain.layers.layer import Layer
from joulemap.model.terrain.layers.stack import Layers
from joulemap.model.training.simulated_set import level_ground, rolling_resistance_on

SEEDS = (1, 2, 3)
FACTORS = {"meadow": 1.0, "moss": 1.6, "bog": 2.4}


def drive(
    site: FieldSite, runs: int, truth: FieldRobot, folder: Path, rng: np.random.Generator, *, hidden: bool = True
) -> tuple[Heightmap, list[Path]]:
    """A meadow with kinds of ground in areas of some metres, and drives over it; hidden : whether they cost more."""
    frame = site.terrain.frame.respaced(0.5)
    noise = [gaussian_filter(rng.standard_normal(frame.shape), 8.0) for _ in FACTORS]
    layer = Layer("kinds", "areas", frame, np.argmax(noise, axis=0).astype(np.int16), tuple(map(Kind, FACTORS)))
    survey = replace(site.survey, layers=Layers((layer,)))
    if hidden:
        x, y = np.meshgrid(*site.mu_factor.frame.centres())
        site = site.with_rolling_loss(np.array([*FACTORS.values(), 1.0])[layer.at(x, y)])
    files = []
    for number in range(runs):
        way = drive_along(random_waypoints(site.drivable, 12, rng), speed_mps=0.5, rng=rng)
        log = simulate_run(site, truth, way, rng=rng, start_s=3600.0 * (number + 1))
        log = replace(log, terrain=np.full(log.terrain.shape, ""))
        files.append(log.write_csv(folder / f"{site.name}_{'new' if hidden else 'base'}_{number:02d}.csv"))
    return survey, files


def residuals(ground: Heightmap, files: list[Path], robot: Robot, true_mu: float | None = None) -> Residuals:
    """Against eq. 5; true_mu : of the meadow, with which the base model knows what every kind costs."""
    runs = read_calibration_runs([Site(ground, tuple(files), robot)])
    seen, model = runs.sites[0].heightmap, PhysicsPredictor()
    if true_mu is not None:
        (layer,) = ground.layers.each
        true = tuple(Kind(name, rolling_resistance=true_mu * factor) for name, factor in FACTORS.items())
        seen, model = seen.bare, _Knowing(Layers((replace(layer, kinds=true),)))
    return residuals_on(model, seen, robot, runs.segments)[0]


class _Knowing(PhysicsPredictor):
    """Eq. 5 with the rolling resistance of kinds of ground, whatever layers a heightmap has."""

    def __init__(self, layers: Layers) -> None:
        self._layers = layers

    def segment_traction(self, heightmap, robot, x, y, heading_rad):
        return super().segment_traction(replace(heightmap, layers=self._layers), robot, x, y, heading_rad)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_hidden_kinds_are_learned_and_hold_on_another_site(tmp_path: Path, seed: int) -> None:
    """The error at plan time, on a site that had no part, is within 1.05 of that with the true cost of each kind."""
    rng = np.random.default_rng(seed)
    meadow, other = (named_site(name, seed=seed) for name in ("grass_a", "grass_b"))
    truth, soil = FieldRobot.drawn(Robot(), rng), meadow.ground
    here, new = drive(meadow, 8, truth, tmp_path, rng)
    there, test = drive(other, 4, truth, tmp_path, rng)
    before, base = drive(meadow, 6, truth, tmp_path, rng, hidden=False)
    robot = Robot(rolling_resistance=round(rolling_resistance_on(level_ground(soil, rng), soil, truth), 4))

    def _error(true_mu: float | None) -> tuple[list[str], float]:
        found = calibrate(residuals(here, new, robot, true_mu), cross_validate=False)
        errors = found.errors_on(residuals(there, test, robot, true_mu), elsewhere=True)
        return [e.term.form.name for e in found.effects], errors["after_planner"]["rmse"]

    learned, ours = _error(None)
    assert "terrain_class" in learned
    assert ours <= 1.05 * _error(soil.mu)[1]
    bare = [residuals(ground.bare, files, robot) for ground, files in ((here, new), (before, base))]
    unknown = calibrate(bare[0], base=bare[1], cross_validate=False)
    assert unknown.effects[0].term.form.name == "local_friction"  # structure over place
