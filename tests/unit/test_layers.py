"""Layers over a heightmap: what they cost and close in closed form, from every shape in which people have them."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin
from rasterio.warp import transform_bounds
from shapely.geometry import MultiPolygon, Polygon, box

import joulemap as jm
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.model.terrain.layers.kinds import library
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.build import build_lattice, write_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.lattice.tiles import Tiling

ROBOT = Robot(mass_kg=40.0, rolling_resistance=0.05, idle_power_w=10.0, width_m=0.5, length_m=0.5, tracking_std_m=0.0)
LEGEND = {
    "grass": {"value": 1, "rolling_resistance": 0.08},
    "mud": {"value": 2, "factor": 1.5},
    "pond": {"value": 3, "blocked": True},
}
CRS = "EPSG:32630"
WEST, NORTH = 366900.0, 4064340.0


def level(side_m: float = 40.0, cell_m: float = 0.5) -> jm.Heightmap:
    n = round(side_m / cell_m)
    return jm.heightmap(np.zeros((n, n)), resolution_m=cell_m, west_m=WEST, north_m=NORTH, crs=CRS)


def price_at(costs: jm.CostMap, x: float, y: float) -> float:
    return float(np.nanmean(costs.at(WEST + x, NORTH - 40.0 + y).energy_per_m))


def eq5(resistance: float) -> float:
    """Wei & Isler 2022, eq. 5 on level ground, and idle power over the time of a metre."""
    return ROBOT.price_per_m(ROBOT.weight_n * resistance).item()


def write_kinds(path: Path, values: np.ndarray, crs: str = CRS, transform=None) -> Path:
    transform = transform or from_origin(WEST, NORTH, 2.0, 2.0)
    with rasterio.open(path, "w", driver="GTiff", width=values.shape[1], height=values.shape[0], count=1,
                       dtype="uint8", crs=crs, transform=transform) as file:  # fmt: skip
        file.write(values.astype("uint8"), 1)
    return path


@pytest.fixture(scope="module")
def land(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Grass in the west, mud in the east, a pond of 8 x 8 m in the middle; cells of 2 m."""
    values = np.ones((20, 20))
    values[:, 10:] = 2
    values[8:12, 8:12] = 3
    return write_kinds(tmp_path_factory.mktemp("land") / "land.tif", values)


def test_every_kind_costs_its_resistance_or_factor_and_a_blocked_one_is_an_obstacle(land):
    ground = jm.with_layers(level(), kinds=land, legend=LEGEND)
    costs = jm.costmap(ground, ROBOT, model="physics")
    assert price_at(costs, 8.5, 30.5) == pytest.approx(eq5(0.08), rel=1e-5)
    assert price_at(costs, 32.5, 30.5) == pytest.approx(eq5(0.05 * 1.5), rel=1e-5)
    assert costs.at(WEST + 20.0, NORTH - 20.0).reasons[0] == "obstacle"
    route = costs.plan((WEST + 10.0, NORTH - 20.0), (WEST + 30.0, NORTH - 20.0))
    # round a corner of the pond, half the robot's width away: at least the chord that touches both corners
    assert route.length_m > 2.0 * math.hypot(6.0, 4.0) + 8.0
    made = costs.lattice.provenance["layers"]
    assert [(layer["role"], layer["resolution_m"]) for layer in made] == [("kinds", 2.0)]


def test_a_map_without_layers_says_nothing_of_any():
    lattice = build_lattice(level(), ROBOT, PhysicsPredictor())
    assert "layers" not in lattice.provenance


def test_uncertain_kinds_widen_the_uncertainty_of_a_network(land):
    legend = {"grass": {"value": 1, "rolling_resistance": 0.08, "std": 0.03}, **{k: LEGEND[k] for k in ("mud", "pond")}}
    sure, unsure = (jm.costmap(jm.with_layers(level(), kinds=land, legend=one), ROBOT) for one in (LEGEND, legend))
    row, col = 10, 8
    before, after = sure.lattice.std_j[row, col], unsure.lattice.std_j[row, col]
    assert after == pytest.approx(np.hypot(before, ROBOT.weight_n * 0.03), rel=1e-4)
    assert np.array_equal(sure.lattice.std_j[row, 35], unsure.lattice.std_j[row, 35])  # mud is as sure as it was


def test_a_name_alone_has_the_numbers_of_the_library_each_with_a_source(land):
    assert all(kind.source for kind in library().values())
    legend = {"grass": {"value": 1}, "sand": {"value": 2}, "water": {"value": 3}}
    costs = jm.costmap(jm.with_layers(level(), kinds=land, legend=legend), ROBOT, model="physics")
    assert price_at(costs, 32.5, 30.5) == pytest.approx(eq5(library()["sand"].rolling_resistance), rel=1e-5)


def test_layers_in_degrees_lie_where_they_do_in_metres(tmp_path, land):
    frame = level().frame
    west, south, east, north = transform_bounds(CRS, "EPSG:4326", *frame.bounds)
    values = np.ones((200, 200))
    values[:, 100:] = 2
    transform = rasterio.transform.from_bounds(west, south, east, north, 200, 200)
    geographic = write_kinds(tmp_path / "degrees.tif", values, "EPSG:4326", transform)
    costs = jm.costmap(jm.with_layers(level(), kinds=geographic, legend=LEGEND), ROBOT, model="physics")
    assert price_at(costs, 10.5, 20.5) == pytest.approx(eq5(0.08), rel=1e-5)
    assert price_at(costs, 30.5, 20.5) == pytest.approx(eq5(0.075), rel=1e-5)


@pytest.mark.parametrize("shape", ["geojson", "shapely", "array", "xarray"])
def test_the_same_mud_in_every_shape_costs_the_same(shape, tmp_path):
    there = box(WEST + 20.0, NORTH - 40.0, WEST + 40.0, NORTH)
    ground, legend = level(), {"mud": {"value": 1, "factor": 1.5}}
    mask = np.zeros(ground.frame.shape)
    mask[:, 40:] = 1
    if shape == "geojson":
        crs = {"type": "name", "properties": {"name": CRS}}
        feature = {"type": "Feature", "properties": {"kind": "Mud"}, "geometry": there.__geo_interface__}
        given = tmp_path / "mud.geojson"
        given.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [feature]}))
    elif shape == "shapely":
        given = {"mud": [there]}
    elif shape == "array":
        given = mask
    else:
        xarray = pytest.importorskip("xarray")
        x, y = ground.frame.centres()
        given = xarray.DataArray(mask, coords={"y": y, "x": x}, dims=("y", "x"))
    legend["dry"] = {"value": 0}
    costs = jm.costmap(jm.with_layers(ground, kinds=given, legend=legend), ROBOT, model="physics")
    assert price_at(costs, 30.5, 20.5) == pytest.approx(eq5(0.075), rel=1e-5)
    assert price_at(costs, 10.5, 20.5) == pytest.approx(eq5(0.05), rel=1e-5)


def test_factors_and_costs_come_on_top_and_a_function_may_depend_on_the_heading():
    ground = level()
    mask = np.full(ground.frame.shape, np.nan)
    mask[:, 40:] = 2.0
    costs = jm.costmap(jm.with_layers(ground, factor=mask), ROBOT, model="physics")
    assert price_at(costs, 30.5, 20.5) == pytest.approx(eq5(0.1), rel=1e-5)
    assert price_at(costs, 10.5, 20.5) == pytest.approx(eq5(0.05), rel=1e-5)
    headwind = jm.costmap(
        jm.with_layers(ground, cost=lambda x, y, heading: 5.0 * (1.0 + np.cos(heading))), ROBOT, model="physics"
    )
    along = headwind.at(WEST + 20.5, NORTH - 20.5).energy_per_m
    assert along[0] - along[8] == pytest.approx(10.0, rel=1e-4)


@pytest.mark.parametrize("cell_m", [0.1, 0.5, 2.0])
def test_obstacles_of_any_resolution_close_a_wall_but_for_its_door(cell_m):
    """A wall of 2 m across the map, with a door of 4 m, in cells finer and coarser than the heightmap's."""
    n = round(40.0 / cell_m)
    x = (np.arange(n) + 0.5) * cell_m
    wall = (np.abs(x[:, None] - 20.0) <= 1.0) & (np.abs(x[None, :] - 30.0) > 2.0)
    xarray = pytest.importorskip("xarray")
    given = xarray.DataArray(wall.astype(float), coords={"y": NORTH - x, "x": WEST + x}, dims=("y", "x"))
    costs = jm.costmap(jm.with_layers(level(), obstacles=given), ROBOT, model="physics")
    start, goal = (WEST + 10.0, NORTH - 10.0), (WEST + 10.0, NORTH - 30.0)
    route = costs.plan(start, goal)
    assert route.length_m > 2.0 * math.hypot(18.0, 9.0)
    whole = jm.with_layers(level(), obstacles=given.where(given > 0, np.abs(given.y - (NORTH - 20.0)) <= 1.0))
    with pytest.raises(NoRouteError):
        jm.costmap(whole, ROBOT, model="physics").plan(start, goal)


def test_free_ground_closes_what_is_unknown_and_obstacles_do_not():
    ground = level()
    known = np.full(ground.frame.shape, np.nan)
    known[:, :40] = 1.0
    free = jm.costmap(jm.with_layers(ground, free=known), ROBOT, model="physics").lattice
    assert free.blocked[20, [10, 30]].tolist() == [Blocked.FREE, Blocked.OBSTACLE]
    open_ = jm.costmap(jm.with_layers(ground, obstacles=np.where(np.isnan(known), np.nan, 0.0)), ROBOT, model="physics")
    assert open_.lattice.blocked[20, 30] == Blocked.FREE


def test_a_map_on_disk_tile_by_tile_is_that_in_memory(tmp_path, land):
    ground = jm.with_layers(level(), kinds=land, legend=LEGEND, obstacles=land)
    whole = build_lattice(ground, ROBOT, PhysicsPredictor())
    tiling = Tiling.of(ground.frame, spacing_m=1.0, headings=16, side=16)
    write_lattice(tmp_path / "map.zarr", ground, ROBOT, PhysicsPredictor(), tiling)
    stored = load_lattice(tmp_path / "map.zarr")
    assert np.array_equal(stored.traction_per_m, whole.traction_per_m, equal_nan=True)
    assert np.array_equal(stored.blocked, whole.blocked)
    assert np.array_equal(stored.obstacles.room == 0, whole.obstacles.room == 0)


def test_what_cannot_be_a_layer_is_refused_with_the_value(land, tmp_path):
    ground = level()
    with pytest.raises(InputError, match=r"values 1, 2, 3.*legend"):
        jm.with_layers(ground, kinds=land)
    with pytest.raises(InputError, match="none of the values"):
        jm.with_layers(ground, kinds=land, legend={"grass": {"value": 9}})
    with pytest.raises(InputError, match="80 x 80"):
        jm.with_layers(ground, obstacles=np.zeros((3, 3)))
    with pytest.raises(InputError, match="outside the heightmap"):
        jm.with_layers(jm.heightmap(np.zeros((9, 9)), resolution_m=1.0, crs=CRS), kinds=land, legend=LEGEND)
    with pytest.raises(InputError, match="'colour'"):
        jm.with_layers(ground, kinds=land, legend={"grass": {"value": 1, "colour": "green"}})
    with pytest.raises(InputError, match="factor in array is -1, and the limits are 0"):
        jm.with_layers(ground, factor=np.full(ground.frame.shape, -1.0))


def test_a_layer_over_a_part_of_the_map_and_a_kind_without_a_cost_are_warned_of(land):
    half = jm.heightmap(np.zeros((80, 160)), resolution_m=0.5, west_m=WEST, north_m=NORTH, crs=CRS)
    costs = jm.costmap(jm.with_layers(half, kinds=land, legend={"moss": {"value": [1, 2, 3]}}), ROBOT, model="physics")
    assert any("covers 50%" in words for words in costs.warnings)
    assert any("moss" in words for words in costs.warnings)


def test_written_heightmaps_take_layers_as_they_are_read(tmp_path, land):
    write_geotiff(tmp_path / "level.tif", level())
    (tmp_path / "legend.toml").write_text("[grass]\nvalue = 1\nrolling_resistance = 0.08\n")
    read = jm.read_heightmap(tmp_path / "level.tif", layers={"kinds": land}, legend=tmp_path / "legend.toml")
    assert price_at(jm.costmap(read, ROBOT, model="physics"), 8.5, 30.5) == pytest.approx(eq5(0.08), rel=1e-5)


@pytest.mark.parametrize("mode", ["trinary", "raw", "negated"])
def test_a_map_of_nav2_lies_where_its_origin_and_yaw_say(mode, tmp_path):
    """An obstacle in the north-west corner of the picture, which a turn by 90 degrees moves to the south-west."""
    occupied, free, unknown = {"trinary": (0, 254, 205), "raw": (100, 0, 255), "negated": (254, 0, 100)}[mode]
    picture = np.full((20, 30), free, dtype=np.uint8)
    picture[:4, :6], picture[10:, 20:] = occupied, unknown
    (tmp_path / "yard.pgm").write_bytes(b"P5\n30 20\n255\n" + picture.tobytes())
    said = f"image: yard.pgm\nresolution: 1.0\nmode: {'raw' if mode == 'raw' else 'trinary'}\n"
    said += f"negate: {int(mode == 'negated')}\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    (tmp_path / "yard.yaml").write_text(f"{said}origin: [{WEST}, {NORTH - 40.0}, 0.0]\n")
    (tmp_path / "turned.yaml").write_text(f"{said}origin: [{WEST + 30.0}, {NORTH - 40.0}, {math.pi / 2}]\n")

    def _closed(places, **layer: Path) -> list[bool]:
        (found,) = jm.with_layers(level(), **layer).layers.closing
        return [bool(found.is_closed(WEST + x, NORTH - 40.0 + y)) for x, y in places]

    places = ((3, 18), (3, 3), (12, 3), (28, 3))
    assert _closed(places, obstacles=tmp_path / "yard.yaml") == [True, False, False, False]
    assert _closed(places, obstacles=tmp_path / "turned.yaml") == [False, False, True, False]
    known = _closed(((3, 18), (3, 3), (28, 3), (35, 3)), free=tmp_path / "yard.yaml")
    assert known == [True, False, True, True]  # unknown and what lies outside are closed


def test_polygons_of_shapely_are_obstacles_each_alone_together_and_in_a_list():
    one = box(WEST + 4.0, NORTH - 8.0, WEST + 8.0, NORTH - 4.0)
    other = box(WEST + 20.0, NORTH - 8.0, WEST + 24.0, NORTH - 4.0)
    for given, closed in ((one, 1), (MultiPolygon([one, other]), 2), ([one, other], 2)):
        (layer,) = jm.with_layers(level(), obstacles=given).layers.each
        assert layer.is_closed(WEST + np.array([6.0, 22.0]), NORTH - 6.0).tolist() == [True, closed == 2]


@pytest.mark.parametrize("role", ["factor", "cost"])
@pytest.mark.parametrize("value", [math.inf, 1e39, 1e308, -1.0])
def test_numbers_beyond_the_limits_are_refused_in_every_shape(role, value):
    ground = level()
    values = np.full(ground.frame.shape, np.nan)
    values[3, 4] = value
    area = box(WEST + 4.0, NORTH - 8.0, WEST + 8.0, NORTH - 4.0).__geo_interface__
    for given in (values, {"type": "Feature", "properties": {role: value}, "geometry": area}):
        with pytest.raises(InputError, match=f"{role} in .* is .*the limits are 0 and 1") as refused:
            jm.with_layers(ground, **{role: given})
        assert refused.value.context["value"] == str(float(value))
    if role == "cost":
        with pytest.raises(InputError, match="the limits are 0 and"):
            jm.costmap(jm.with_layers(ground, cost=lambda x, y, heading: x * 0.0 + value), ROBOT, model="physics")


def feature(ring: object, **properties: object) -> dict:
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}


RING = [[WEST, NORTH], [WEST + 9.0, NORTH], [WEST + 9.0, NORTH - 9.0], [WEST, NORTH - 9.0], [WEST, NORTH]]


def test_a_ring_is_closed_and_a_crs_may_be_its_name_alone():
    for given in (feature(RING[:-1]), feature(RING) | {"crs": CRS}):
        (layer,) = jm.with_layers(level(), obstacles=given).layers.each
        assert layer.is_closed(WEST + 5.0, NORTH - 5.0)


def test_corners_that_look_like_degrees_are_degrees_where_the_map_has_a_crs():
    lon, lat = rasterio.warp.transform(CRS, "EPSG:4326", *np.transpose(RING))
    (layer,) = jm.with_layers(level(), obstacles=feature(np.column_stack([lon, lat]).tolist())).layers.each
    assert layer.is_closed(WEST + 5.0, NORTH - 5.0)
    nowhere = jm.heightmap(np.zeros((9, 9)), resolution_m=1.0)
    (around,) = jm.with_layers(nowhere, obstacles=feature([[-9, -9], [20, -9], [20, 20], [-9, 20]])).layers.each
    assert around.is_closed(5.0, 5.0)


@pytest.mark.parametrize(
    ("role", "given", "said"),
    [
        ("obstacles", feature([[WEST - 4e9, NORTH], [WEST + 4e9, NORTH], [WEST, NORTH - 9e9]]), "limit is 1e"),
        ("obstacles", feature([RING[0], RING[1], RING[0]]), "2 different corners"),
        ("obstacles", feature([]), "without corners"),
        ("obstacles", feature([["a", "b"]]), "not two numbers"),
        ("obstacles", {"type": "Polygon", "coordinates": []}, "without corners"),
        ("obstacles", Polygon(), "without corners"),
        ("obstacles", {"type": "Feature", "properties": {}, "geometry": None}, "no geometry"),
        ("obstacles", {"type": "GeometryCollection", "geometries": []}, "GeometryCollection"),
        ("obstacles", {"type": "FeatureCollection", "features": []}, "no polygons"),
        ("obstacles", feature(RING) | {"crs": {"properties": {"name": 32630}}}, "crs of .* is 32630"),
        ("obstacles", feature(RING) | {"crs": {"type": "link", "properties": {"href": "a"}}}, "give its name"),
        ("kinds", feature(RING, kind={"a": 1}), "kind .* give a name"),
        ("kinds", feature(RING, kind="m" * 101), "101 letters"),
        ("kinds", feature(RING, kind=10**400), "give a name"),
        ("obstacles", feature([[1e308, 1], [1e308, 9], [2, 95]]) | {"crs": "EPSG:4326"}, "cannot be in EPSG:4326"),
        ("factor", feature(RING, factor="abc"), "'abc', which is no number"),
        ("cost", feature(RING, cost=[1]), "which is no number"),
    ],
)
def test_polygons_that_cannot_be_drawn_are_refused_in_one_sentence(role, given, said):
    with pytest.raises(InputError) as refused:
        jm.with_layers(level(), **{role: given})
    assert re.search(said, str(refused.value)), str(refused.value)
    assert f"the layer of {role}" in str(refused.value)


@pytest.mark.parametrize("key", ["kind", "DN", "value"])
def test_a_number_means_the_kind_that_has_it_in_the_legend(key):
    (layer,) = jm.with_layers(level(), kinds=feature(RING, **{key: 2}), legend=LEGEND).layers.each
    assert layer.kinds[layer.at(WEST + 5.0, NORTH - 5.0)].name == "mud"
    with pytest.raises(InputError, match=r"none of the values .* the first is 9"):
        jm.with_layers(level(), kinds=feature(RING, **{key: 9}), legend=LEGEND)
    with pytest.raises(InputError, match="kind 2, and no legend"):
        jm.with_layers(level(), kinds=feature(RING, **{key: 2}))


def test_values_that_the_legend_does_not_name_are_warned_of_with_their_share(land):
    both = {"type": "FeatureCollection", "features": [feature(RING, DN=2), feature(RING, DN=7)]}
    for given, share in ((land, "52%"), (both, "100%")):
        ground = jm.with_layers(level(), kinds=given, legend={"mud": {"value": 2}, "ice": {}})
        (said, covers) = (words for words in ground.layers.warnings(ground.frame) if " layer " in words)
        assert f"{share} has values that the legend does not name (" in said
        assert ("no cell is of ice" in said) == (given is land)
        assert "covers 48%" in covers or given is both


def test_cells_without_data_are_not_covered():
    ground = level()
    values = np.full(ground.frame.shape, 1.5)
    values[:, 20:] = np.nan
    over = jm.with_layers(ground, factor=values)
    assert over.layers.warnings(ground.frame) == ["the layer array covers 25% of the map: the rest is as without it"]


def test_a_legend_without_kinds_and_a_layer_of_two_bands_are_refused(tmp_path):
    wall = np.zeros(level().frame.shape)
    with pytest.raises(InputError, match="no layer of kinds"):
        jm.with_layers(level(), obstacles=wall, legend=LEGEND)
    with rasterio.open(tmp_path / "two.tif", "w", driver="GTiff", width=80, height=80, count=2, dtype="uint8", crs=CRS,
                       transform=from_origin(WEST, NORTH, 0.5, 0.5)) as file:  # fmt: skip
        file.write(np.zeros((2, 80, 80), dtype="uint8"))
    with pytest.raises(InputError, match=r"layer two.tif has 2 bands, and a layer has one"):
        jm.with_layers(level(), obstacles=tmp_path / "two.tif")
