"""What to drive next: where least squares knows the answer, the suggestion is that answer."""

import numpy as np
import pytest

from joulemap.model.errors import InfeasibleError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.forms.baseline_change import HotelLoad, RollingResistance
from joulemap.model.loop.forms.turning import Turning
from joulemap.model.loop.suggest import suggest_drive
from joulemap.model.terrain.heightmap import Heightmap
from tests.reference.drives import ROBOT, made_up, measured_on, noisy

TURNING, HOTEL, FRICTION = Turning(), HotelLoad(), RollingResistance()


def field(known=True):
    heights = np.zeros((100, 100), dtype=np.float32)
    if not known:
        heights[1:] = np.nan
    return Heightmap(heights, GridFrame(0.0, 50.0, 0.5, 100, 100, None))


def level(x, y, heading_rad):
    return np.full(np.shape(x), ROBOT.rolling_resistance * ROBOT.weight_n)


def straight_runs(seed=0):
    """Runs that hardly turn, at one speed and on level ground."""
    rng = np.random.default_rng(seed)
    rows = made_up(rng)
    rows.turned_abs_rad[:] *= 0.02
    rows.duration_s[:] = 2.0
    rows.grades[:] = 0.0
    return measured_on(rows, noisy(rng, rows))


def test_turning_is_learned_by_turning():
    found = suggest_drive(straight_runs(), TURNING, [], field(), ROBOT, level)
    assert found.kind.split()[0] == "circles" or "slalom" in found.kind
    assert found.shrinkage < 0.1
    assert ((found.points > 0.0) & (found.points < 50.0)).all()


def test_idle_power_is_told_from_friction_by_speed():
    found = suggest_drive(straight_runs(), HOTEL, [FRICTION], field(), ROBOT, level)
    assert "slow and fast" in found.kind
    assert found.shrinkage < 0.3


def test_no_known_ground_no_drive():
    with pytest.raises(InfeasibleError, match="known ground"):
        suggest_drive(straight_runs(), TURNING, [], field(known=False), ROBOT, level)
