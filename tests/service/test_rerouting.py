"""A task before and after a calibration: judged at the new prices, and never worse for them."""

from __future__ import annotations

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import BlockedError, NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms.baseline_change import HotelLoad
from joulemap.model.loop.forms.turning import Turning
from joulemap.model.loop.terms import Term
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.loop.calibration import correction_of
from joulemap.service.loop.rerouting import compare_routes, drawn_tasks
from tests.reference.drives import made_up, measured_on, noisy

ROBOT = Robot(mass_kg=40.0, idle_power_w=10.0, rolling_resistance=0.05)
PLACES = np.stack(np.meshgrid(np.arange(3.5, 38.0, 4.0), np.arange(3.5, 28.0, 4.0)), axis=-1).reshape(-1, 2)


def hills() -> Heightmap:
    y, x = np.mgrid[0:30, 0:40].astype(float)
    heights = 1.2 * np.exp(-((y - 15) ** 2 + (x - 20) ** 2) / 40) + 0.4 * np.sin(0.7 * x) * np.sin(0.5 * y)
    heights[20:24, 30:34] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(0.0, 30.0, 1.0, 30, 40))


def calibrated(*terms: Term, **options: object) -> CalibratedPredictor:
    correction = Correction(tuple(terms), tuple(terms), spread=Spread(factor=2.0), **options)  # type: ignore[arg-type]
    return CalibratedPredictor(PhysicsPredictor(), correction, name="mine", version="1")


def test_turning_straightens_the_route() -> None:
    turning = Term(Turning(), (200.0,))
    told = compare_routes(hills(), ROBOT, PhysicsPredictor(), calibrated(turning, turn_j_per_rad=200.0), PLACES)
    assert told.turn_j_per_rad == (0.0, 200.0)
    assert told.chosen == "the two places with the greatest distance that the runs visited"  # whatever they save
    assert told.shown.task == drawn_tasks(PLACES, seed=0)[0]
    assert told.shown.saving_share > 0.0
    document = told.as_dict()
    assert document["saving_j"] == pytest.approx(document["before"]["energy_j"] - document["after"]["energy_j"])
    assert document["before"]["energy_at_old_prices_j"] < document["before"]["energy_j"]
    assert document["after"]["energy_std_j"] > 0.0
    changed = told.map_as_dict()
    assert changed["turn_j_per_rad"] == {"before": 0.0, "after": 200.0}
    assert changed["change_per_m"] == pytest.approx({"low": 0.0, "high": 0.0}, abs=1e-3)  # straight metres


def test_turns_cost_what_base_runs_took_and_what_is_new_beside_them() -> None:
    """The base model charges nothing for turns. Its runs took 20 J/rad, the new ones 80: 60 are new, plans pay all."""
    rng = np.random.default_rng(8)
    drives = [made_up(rng) for _ in range(2)]
    took = [noisy(rng, rows, extra * rows.turned_abs_rad) for rows, extra in zip(drives, (20.0, 80.0), strict=True)]
    base, new = (measured_on(rows, energy) for rows, energy in zip(drives, took, strict=True))
    more, alone = (calibrate(new, base=known, cross_validate=False) for known in (base, None))
    told = []
    for found, extra in ((more, 60.0), (alone, 80.0)):
        effect = found.effects[0]
        assert effect.term.form.name == "turning"
        correction = correction_of(found, np.ones(len(new)))
        if effect.term.form == Turning():
            assert effect.term.coefficients[0] == pytest.approx(extra, rel=0.1)
        told.append(correction.turn_j_per_rad)
    assert told == [pytest.approx(80.0, rel=0.1)] * 2


def test_where_everything_got_dearer_alike_the_way_stays() -> None:
    hotel = Term(HotelLoad(), (5.0,))
    task = ((3.5, 14.5), (36.5, 15.5))
    told = compare_routes(hills(), Robot(idle_power_w=500.0), PhysicsPredictor(), calibrated(hotel), PLACES, task=task)
    assert told.chosen == "as asked for"
    assert told.shown.task == task
    assert told.shown.saving_share == pytest.approx(0.0, abs=2e-3)
    ten = 5.0 / Robot().speed_mps  # J more for a metre
    assert told.map_as_dict()["change_per_m"] == pytest.approx({"low": ten, "high": ten}, abs=1e-2)


def test_a_task_that_cannot_be_driven_says_why() -> None:
    hotel = Term(HotelLoad(), (5.0,))
    models = PhysicsPredictor(), calibrated(hotel)
    with pytest.raises(BlockedError, match="goal"):
        compare_routes(hills(), ROBOT, *models, PLACES, task=((3.5, 14.5), (32.0, 8.0)))
    with pytest.raises(NoRouteError, match="visited"):
        compare_routes(hills(), ROBOT, *models, np.full((4, 2), 31.9) - [0.0, 24.0])


def test_the_farthest_places_are_a_task() -> None:
    tasks = drawn_tasks(PLACES, seed=1)
    assert {tasks[0][0], tasks[0][1]} in ({(3.5, 3.5), (35.5, 27.5)}, {(35.5, 3.5), (3.5, 27.5)})
    assert tasks == drawn_tasks(PLACES, seed=1)
    least = 0.4 * np.hypot(32.0, 24.0)
    assert all(np.hypot(a[0] - b[0], a[1] - b[1]) >= least for a, b in tasks)
