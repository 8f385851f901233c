"""Models of a user's own: formulas and objects that predict, and several cost maps side by side."""

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.energy.own_model import OwnModel
from joulemap.model.errors import InputError, ModelError
from joulemap.model.robot import Robot
from tests.service.conftest import GOAL, START, hill

ROBOT = Robot(mass_kg=20.0)


def eq5(along, across, roughness, speed):
    return ROBOT.weight_n * (ROBOT.rolling_resistance + along)


def test_a_formula_is_a_model():
    mine, theirs = jm.costmap(hill(), ROBOT, model=eq5), jm.costmap(hill(), ROBOT, model="physics")
    known = np.isfinite(mine.lattice.traction_per_m)
    assert known.mean() > 0.8
    assert mine.lattice.traction_per_m[known] == pytest.approx(theirs.lattice.traction_per_m[known], abs=1e-3)
    assert mine.plan(START, GOAL).energy_j == pytest.approx(theirs.plan(START, GOAL).energy_j, rel=1e-3)
    assert mine.lattice.provenance["model"]["name"] == "eq5"


def test_a_formula_sees_slopes_roughness_and_speed_as_they_are():
    seen = []
    asked = OwnModel(lambda *given: seen.append(given) or 50.0)
    east = np.tile(0.2 * np.arange(40) * 0.25, (40, 1))  # rises by a fifth eastwards, the right of what goes north
    bumps = 0.02 * (-1.0) ** np.arange(40)[:, None]
    north_east_south = np.radians([0.0, 90.0, 180.0])
    for heights in (east, east + bumps):
        ground = jm.heightmap(heights, resolution_m=0.25)
        asked.segment_traction(ground, jm.Robot(speed_mps=0.7), np.full(3, 5.0), 5.0, north_east_south)
    (along, across, smooth, speed), (_, _, rough, _) = seen
    assert along == pytest.approx([0.0, 0.2, 0.0], abs=1e-6)
    assert across == pytest.approx([0.2, 0.0, -0.2], abs=1e-6)
    assert smooth == pytest.approx(0.0, abs=1e-6)
    assert (rough > 0.005).all()
    assert (rough < 0.02).all()
    assert speed.tolist() == [0.7] * 3


def test_an_object_that_predicts_from_heights_is_a_model():
    class Climbs:
        def predict(self, heights, headings_rad):
            assert heights.shape == (len(headings_rad), 32, 32)
            return ROBOT.weight_n * (
                ROBOT.rolling_resistance + heights[:, 0].mean(axis=1) - heights[:, -1].mean(axis=1)
            )

    slope = jm.heightmap(np.tile(np.linspace(0.0, 3.0, 60), (40, 1)), resolution_m=0.5)
    mine, theirs = (jm.costmap(slope, ROBOT, model=model) for model in (Climbs(), "physics"))
    assert mine.plan((3.0, 10.0), (27.0, 10.0)).energy_j == pytest.approx(
        theirs.plan((3.0, 10.0), (27.0, 10.0)).energy_j, rel=1e-3
    )


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (lambda along, *_: along[:-1], "a finite traction"),
        (lambda along, *_: along * np.nan, "0 of them finite"),
        (3, "a model is a name, a folder"),
    ],
)
def test_what_is_no_model_is_refused(model, words):
    with pytest.raises((ModelError, InputError), match=words):
        jm.costmap(hill(), ROBOT, model=model)


def test_robots_side_by_side():
    wide = jm.Robot(mass_kg=60.0, max_grade_deg=12.0)
    maps = {"light": jm.costmap(hill(), ROBOT, model="physics"), "heavy": jm.costmap(hill(), wide, model="physics")}
    seen = jm.compare(maps, START, GOAL)
    own = [route.energy_j for route in seen.routes.values()]
    assert np.diag(seen.energies_j) == pytest.approx(own)
    assert seen.energies_j[0, 1] >= 0.999 * own[0]
    assert "heavy on the route of" in str(seen)
    assert "light's" in str(seen)
    with pytest.raises(InputError, match="needs two cost maps"):
        jm.compare({"light": maps["light"]}, START, GOAL)
    other = jm.costmap(jm.heightmap(np.zeros((40, 40)), resolution_m=1.0), model="physics")
    with pytest.raises(InputError, match="different coordinate systems"):
        jm.compare({**maps, "other": other}, START, GOAL)
