"""Bridges and ramps: heights of layers in place of the map's, as polygons, corners, rasters and files."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.terrain.writers import write_geotiff
from tests.unit.test_layers import CRS, NORTH, RING, ROBOT, WEST, eq5, feature, level


def ditch() -> jm.Heightmap:
    """Level ground with a ditch of 2 x 40 m and a depth of 2 m from south to north, whose bottom nobody surveyed."""
    heights = np.zeros((80, 80))
    heights[:, 38:42], heights[:, 39:41] = -2.0, np.nan
    return jm.heightmap(heights, resolution_m=0.5, west_m=WEST, north_m=NORTH, crs=CRS)


@pytest.mark.parametrize("shape", ["polygon", "corners", "raster", "file"])
def test_a_bridge_over_a_ditch_is_driven_over_as_level_ground(shape, tmp_path):
    """A deck of 4 m in the way, and one to which a robot must turn, past its near corners."""
    south = NORTH - 12.0
    straight, beside = (((WEST + 10.0, y), (WEST + 30.0, y)) for y in (south + 2.0, NORTH - 20.0))
    with pytest.raises(NoRouteError):
        jm.costmap(ditch(), ROBOT, model="physics").plan(*straight)
    corners = [[WEST + 18.0, south], [WEST + 22.0, south], [WEST + 22.0, south + 4.0], [WEST + 18.0, south + 4.0]]
    given = feature([[*corner, 0.0] for corner in corners]) if shape == "corners" else feature(corners, height=0.0)
    if shape == "raster":
        given = np.full((80, 80), np.nan)
        given[16:24, 36:44] = 0.0
    if shape == "file":
        write_geotiff(tmp_path / "ditch.tif", ditch())
        (tmp_path / "deck.geojson").write_text(json.dumps(given | {"crs": CRS}))
        ground = jm.read_heightmap(tmp_path / "ditch.tif", layers={"height": tmp_path / "deck.geojson"})
    else:
        ground = jm.with_layers(ditch(), height=given)
    costs = jm.costmap(ground, ROBOT, model="physics")
    route = costs.plan(*straight)
    assert route.length_m == pytest.approx(20.0, abs=1e-6)
    assert route.energy_j == pytest.approx(20.0 * eq5(0.05), rel=1e-4)
    route = costs.plan(*beside)
    crossing = [y for x, y, *_ in route.points if WEST + 18.9 < x < WEST + 21.1]
    assert all(south < y < south + 4.0 for y in crossing)
    assert route.length_m > 2.0 * math.hypot(9.0, 8.0 + 0.5 * ROBOT.width_m) + 2.0
    assert [layer["role"] for layer in costs.lattice.provenance["layers"]] == ["height"]
    assert any("gives the heights of 16.0 m2, in place of the map's" in words for words in costs.warnings)
    assert ground.data_hash == jm.with_layers(ditch(), height=given).data_hash


def test_a_ramp_is_linear_between_the_heights_of_its_corners_and_costs_its_climb():
    """A platform of 2 m that only a ramp of 10 m reaches: the climb takes the weight times its height."""
    heights = np.zeros((80, 80))
    heights[:, 40:], heights[:, 20:40] = 2.0, np.nan
    hall = jm.heightmap(heights, resolution_m=0.5, west_m=WEST, north_m=NORTH, crs=CRS)
    ramp = [
        [WEST + 10, NORTH - 24, 0],
        [WEST + 20, NORTH - 24, 2],
        [WEST + 20, NORTH - 16, 2],
        [WEST + 10, NORTH - 16, 0],
    ]
    ends = ((WEST + 6.0, NORTH - 20.0), (WEST + 30.0, NORTH - 20.0))
    with pytest.raises(NoRouteError):
        jm.costmap(hall, ROBOT, model="physics").plan(*ends)
    ground = jm.with_layers(hall, height=feature(ramp))
    assert ground.sample(WEST + 15.25, NORTH - 20.25) == pytest.approx(1.05, abs=1e-6)
    route = jm.costmap(ground, ROBOT, model="physics").plan(*ends)
    assert route.length_m == pytest.approx(24.0, abs=1e-6)
    assert route.energy_j == pytest.approx(24.0 * eq5(0.05) + 2.0 * ROBOT.weight_n, rel=0.01)


def test_a_height_that_nobody_gives_is_refused_and_heights_stay_under_other_layers():
    for ring, said in (
        (RING, "the property 'height', or a height at each corner"),
        ([[x, y, 1e6] for x, y in RING], "a height in the layer of height is 1e.06 m, and the limits are"),
    ):
        with pytest.raises(InputError, match=said):
            jm.with_layers(level(), height=feature(ring))
    raised = jm.with_layers(level(), height=feature(RING, height=3.0))
    both = jm.with_layers(raised, factor=np.full(raised.frame.shape, 2.0))
    assert both.heights.max() == 3.0
    assert [layer.role for layer in both.layers.each] == ["height", "factor"]
