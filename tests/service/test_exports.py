"""Routes and cost maps for other programs, judged by the readers of those programs."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gpxpy
import jsonschema
import numpy as np
import pytest
import rasterio
import yaml
from mcap.reader import make_reader
from numpy.typing import NDArray
from pyproj import Transformer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import joulemap as jm
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice import Blocked
from joulemap.planner.pricing.integrator import leg_prices, world_points
from joulemap.planner.words import energy_words
from joulemap.service.commands.path_files import read_path
from joulemap.service.exports.clearance import READ_FURTHEST_M, price_given_path
from joulemap.service.exports.mission import corners_to_keep
from joulemap.service.exports.nav2_graph import MOST_NODES
from joulemap.service.exports.nav2_graph import write as write_graph
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from tests.reference.lattices import price_world_path

CM = 0.01
START, GOAL, STOP = (6.0, 8.0), (92.0, 70.0), (20.0, 66.0)
WESTERN = ("EPSG:32630", 370_000.0, 4_064_080.0)
GRIDS = (  # CRS, west, north: UTM, a national grid, a polar one, and one on the antimeridian
    WESTERN,
    ("EPSG:2154", 652_000.0, 6_862_000.0),
    ("EPSG:3413", -200_000.0, -2_200_000.0),
    ("EPSG:3832", 3_339_540.0, 4_000_000.0),
)


def ground(crs: str | None, west: float, north: float, seed: int = 3) -> Heightmap:
    """Hills with holes of unknown ground between them, along whose edges the best ways lead."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0:80, 0:100]
    heights = np.zeros(row.shape)
    for _ in range(6):
        away = (row - rng.uniform(0, 80)) ** 2 + (col - rng.uniform(0, 100)) ** 2
        heights += rng.uniform(1, 6) * np.exp(-away / rng.uniform(50, 400))
    for _ in range(12):
        i, j = rng.integers(12, 60), rng.integers(10, 80)
        heights[i : i + rng.integers(3, 8), j : j + rng.integers(3, 8)] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(west, north, 1.0, 80, 100, crs))


def at(frame: GridFrame, place: tuple[float, float]) -> tuple[float, float]:
    return frame.west_m + place[0], frame.bounds[1] + place[1]


@pytest.fixture(scope="module")
def costmap() -> jm.CostMap:
    return jm.costmap(ground(*WESTERN), model="physics")


@pytest.fixture(scope="module")
def route(costmap: jm.CostMap) -> jm.PlannedRoute:
    frame = costmap.lattice.frame
    return costmap.plan(at(frame, START), at(frame, GOAL), alternatives=1, snap=True)


@pytest.fixture(scope="module")
def tour(costmap: jm.CostMap) -> jm.PlannedTour:
    pytest.importorskip("ortools")
    frame = costmap.lattice.frame
    return costmap.tour([at(frame, place) for place in (START, GOAL, STOP)], snap=True)


def written(track: Any, name: str, **how: Any) -> bytes:
    return RouteFile(ROUTE_FORMATS[name], **how).written(track)


def from_gpx(content: bytes) -> list[NDArray[np.float64]]:
    lines = gpxpy.parse(content.decode()).tracks
    return [np.array([(p.longitude, p.latitude) for s in line.segments for p in s.points]) for line in lines]


def from_kml(content: bytes) -> list[NDArray[np.float64]]:
    """As GDAL reads it."""
    geopandas = pytest.importorskip("geopandas")
    return [np.array(line.coords)[:, :2] for line in geopandas.read_file(io.BytesIO(content), driver="KML").geometry]


def from_geojson(content: bytes) -> list[NDArray[np.float64]]:
    """As GDAL reads it."""
    geopandas = pytest.importorskip("geopandas")
    table = geopandas.read_file(io.BytesIO(content))
    assert table.crs.to_epsg() in (4326, 4979)  # WGS 84, without and with heights
    return [np.vstack([np.array(part.coords)[:, :2] for part in getattr(g, "geoms", [g])]) for g in table.geometry]


@pytest.mark.parametrize(("crs", "west", "north"), GRIDS)
@pytest.mark.parametrize(("name", "read"), [("gpx", from_gpx), ("kml", from_kml), ("geojson", from_geojson)])
def test_positions_hold_to_a_centimetre_in_other_programs(
    crs: str, west: float, north: float, name: str, read: Callable[[bytes], list[NDArray[np.float64]]]
) -> None:
    made = jm.costmap(ground(crs, west, north), model="physics")
    frame = made.lattice.frame
    found = made.plan(at(frame, START), at(frame, GOAL), snap=True)
    lines = read(written(found.track, name))
    assert len(lines) == 2
    back = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    for degrees, own in zip(lines, (found.route, found.shortest), strict=True):
        xy = np.column_stack(back.transform(degrees[:, 0], degrees[:, 1]))
        if len(xy) == len(own.points):  # a line over the antimeridian has points more
            assert np.hypot(*(xy - own.points[:, :2]).T).max() < CM
        assert price_given_path(made.lattice, xy).energy_j == pytest.approx(own.energy_j, rel=1e-3)


def test_a_line_over_the_antimeridian_is_cut_there() -> None:
    crs, west, north = GRIDS[3]
    made = jm.costmap(ground(crs, west, north), model="physics")
    frame = made.lattice.frame
    document = made.plan(at(frame, START), at(frame, GOAL), snap=True).to_geojson()
    for feature in document["features"]:
        assert feature["geometry"]["type"] == "MultiLineString"
        before, after = feature["geometry"]["coordinates"]
        assert (before[-1][0], after[0][0]) == (180.0, -180.0)
        assert before[-1][1:] == after[0][1:]
        assert min(p[0] for p in before) > 179.0
        assert max(p[0] for p in after) < -179.0


def test_written_legs_may_be_driven_when_they_are_read_again() -> None:
    """Best ways touch blocked ground: of 30 of them, hardly one survives rounding as it is."""
    rng, survived, total = np.random.default_rng(0), 0, 0
    for seed in range(3):
        made = jm.costmap(ground(*WESTERN, seed=seed), model="physics")
        lattice, crs = made.lattice, WESTERN[0]
        back = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        for _ in range(5):
            start, goal = (at(lattice.frame, tuple(rng.uniform(2.0, 78.0, 2))) for _ in range(2))
            track = made.plan(start, goal, snap=True).track
            for degrees, line in zip(from_gpx(written(track, "gpx")), track.lines, strict=True):
                xy = np.column_stack(back.transform(degrees[:, 0], degrees[:, 1]))
                total += 1
                survived += bool(np.isfinite(leg_prices(lattice, world_points(lattice, xy))).all())
                assert np.hypot(*(xy - line.points[:, :2]).T).max() < CM
    assert survived >= 0.9 * total  # the others lead through passages of one cell, which have no width


# QGroundControl publishes its format as this page, and no schema of it as a file:
# docs.qgroundcontrol.com/v4.4.3/en/qgc-dev-guide/file_formats/plan.html. These are its required fields and their types.
PLAN_SCHEMA = {
    "type": "object",
    "required": ["fileType", "groundStation", "mission", "version", "geoFence", "rallyPoints"],
    "properties": {
        "fileType": {"const": "Plan"},
        "groundStation": {"type": "string"},
        "version": {"const": 1},
        "geoFence": {"type": "object", "required": ["circles", "polygons", "version"]},
        "rallyPoints": {"type": "object", "required": ["points", "version"]},
        "mission": {
            "type": "object",
            "required": [
                "cruiseSpeed",
                "firmwareType",
                "globalPlanAltitudeMode",
                "hoverSpeed",
                "items",
                "plannedHomePosition",
                "vehicleType",
                "version",
            ],
            "properties": {
                "version": {"const": 2},
                "plannedHomePosition": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
                "items": {
                    "type": "array",
                    "minItems": 1,
                    "items": {
                        "type": "object",
                        "required": ["type", "autoContinue", "command", "doJumpId", "frame", "params"],
                        "properties": {
                            "type": {"const": "SimpleItem"},
                            "autoContinue": {"type": "boolean"},
                            "command": {"type": "integer"},
                            "doJumpId": {"type": "integer", "minimum": 1},
                            "frame": {"type": "integer"},
                            "params": {"type": "array", "minItems": 7, "maxItems": 7},
                        },
                        "if": {"properties": {"command": {"const": 16}}},
                        "then": {"required": ["AMSLAltAboveTerrain", "Altitude", "AltitudeMode"]},
                    },
                },
            },
        },
    },
}


def from_plan(content: bytes, folder: Path) -> NDArray[np.float64]:
    plan = json.loads(content)
    jsonschema.validate(plan, PLAN_SCHEMA)
    items = plan["mission"]["items"]
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    places = np.array([item["params"][4:6] for item in items if item["command"] == 16])
    assert plan["mission"]["plannedHomePosition"][:2] == places[0].tolist()
    return places[:, ::-1]


def from_waypoints(content: bytes, folder: Path) -> NDArray[np.float64]:
    """As MAVProxy loads it."""
    mavwp = pytest.importorskip("pymavlink.mavwp")
    (folder / "mission.waypoints").write_bytes(content)
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(folder / "mission.waypoints")) == loader.count() > 2
    items = [loader.wp(k) for k in range(loader.count())]
    assert [item.seq for item in items] == list(range(len(items)))
    assert (items[1].command, items[1].param1, items[1].param2) == (178, 1.0, 0.5)  # ground speed [m/s]
    return np.array([(item.y, item.x) for item in items[1:] if item.command == 16])


@pytest.mark.parametrize(("name", "read"), [("qgc-plan", from_plan), ("waypoints", from_waypoints)])
@pytest.mark.parametrize("whole", ["route", "tour"])
def test_missions_are_on_free_ground_and_cost_what_the_route_costs(
    name: str,
    read: Callable[[bytes, Path], NDArray[np.float64]],
    whole: str,
    request: pytest.FixtureRequest,
    costmap: jm.CostMap,
    tmp_path: Path,
) -> None:
    planned = request.getfixturevalue(whole)
    degrees = read(written(planned.track, name), tmp_path)
    xy = np.column_stack(Transformer.from_crs("EPSG:4326", WESTERN[0], always_xy=True).transform(*degrees.T))
    corners = np.vstack([line.points[:, :2] for line in planned.track.driven])
    assert len(xy) < len(corners)
    assert np.isfinite(leg_prices(costmap.lattice, world_points(costmap.lattice, xy))).all()
    assert price_world_path(costmap.lattice, xy) == pytest.approx(planned.energy_j, rel=0.01)
    nearest = np.hypot(*(xy[:, None] - corners[None]).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() < CM
    for line in planned.track.driven:  # ends and stops stay
        assert np.hypot(*(xy - line.points[0, :2]).T).min() < CM
    assert np.hypot(*(xy[-1] - planned.track.driven[-1].points[-1, :2])) < CM


def test_fewer_corners_where_a_straight_line_costs_the_same(costmap: jm.CostMap) -> None:
    flat = jm.costmap(
        Heightmap(np.zeros((40, 60), dtype=np.float32), GridFrame(0.0, 40.0, 1.0, 40, 60)), model="physics"
    )
    straight = np.column_stack([np.full(30, 20.0), np.linspace(5.0, 50.0, 30)])
    assert corners_to_keep(flat.lattice, straight).tolist() == [0, 29]
    detour = np.array([[20.0, 5.0], [5.0, 28.0], [20.0, 50.0]])  # a quarter longer
    assert corners_to_keep(flat.lattice, detour).tolist() == [0, 1, 2]
    turning = replace(flat.lattice, robot=replace(flat.lattice.robot, turn_j_per_rad=50.0))
    bent = np.vstack([straight, [[35.0, 50.0]]])
    assert corners_to_keep(turning, bent).tolist() == [0, 29, 30]
    blocked = flat.lattice.blocked.copy()
    blocked[14:19, 20:30] = Blocked.STEP  # north of the straight line between the ends
    walled = replace(flat.lattice, blocked=blocked)
    around = np.array([[20.0, 5.0], [19.5, 25.0], [10.0, 45.0]])
    assert corners_to_keep(walled, around, share=0.5).tolist() == [0, 1, 2]
    assert corners_to_keep(flat.lattice, around, share=0.5).tolist() == [0, 2]


def test_ros_reads_the_path(route: jm.PlannedRoute, tmp_path: Path) -> None:
    content = written(route.track, "mcap")
    (schema, channel, message), *others = make_reader(io.BytesIO(content)).iter_messages()
    assert not others
    assert schema is not None
    assert (schema.name, channel.topic, channel.message_encoding) == ("nav_msgs/msg/Path", "/plan", "cdr")
    path = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(message.data, "nav_msgs/msg/Path")
    places = np.array([(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in path.poses])
    profile = route.profile
    np.testing.assert_allclose(places[1:, 0], profile.x, atol=1e-6)
    np.testing.assert_allclose(places[1:, 2], np.nan_to_num(profile.z), atol=1e-6)
    yaw = np.array([2.0 * np.arctan2(p.pose.orientation.z, p.pose.orientation.w) for p in path.poses])
    step = np.diff(places[:, :2], axis=0)
    moved = np.hypot(*step.T) > 1e-3
    np.testing.assert_allclose(np.cos(yaw[:-1][moved]), (step[:, 0] / np.hypot(*step.T))[moved], atol=1e-5)
    np.testing.assert_allclose(np.sin(yaw[:-1][moved]), (step[:, 1] / np.hypot(*step.T))[moved], atol=1e-5)
    last = path.poses[-1].header.stamp
    assert last.sec + 1e-9 * last.nanosec == pytest.approx(route.duration_s)
    assert path.header.frame_id == "map"
    document = json.loads(written(route.track, "ros-path"))
    assert [p["pose"]["position"]["y"] for p in document["poses"]] == places[:, 1].tolist()


def test_rosbags_opens_the_file_as_a_bag(route: jm.PlannedRoute, tmp_path: Path) -> None:
    route.save(tmp_path / "plan.mcap")
    with Reader(tmp_path / "plan.mcap") as bag:
        assert [(c.topic, c.msgtype) for c in bag.connections] == [("/plan", "nav_msgs/msg/Path")]
        assert len(list(bag.messages())) == 1


def test_gpx_describes_a_route_in_units(route: jm.PlannedRoute) -> None:
    said = gpxpy.parse(written(route.track, "gpx").decode()).tracks[0].description
    assert f"energy {energy_words(route.energy_j)}; length {route.length_m:.1f} m; duration " in said
    assert "_" not in said


def test_csv_is_the_route_metre_by_metre(tour: jm.PlannedTour) -> None:
    table = np.genfromtxt(io.BytesIO(written(tour.track, "csv")), delimiter=",", names=True)
    assert sorted(set(table["leg"])) == [1.0, 2.0, 3.0]
    assert table["energy_j"].sum() == pytest.approx(tour.energy_j, rel=1e-4)
    back = Transformer.from_crs("EPSG:4326", WESTERN[0], always_xy=True)
    x, y = back.transform(table["longitude_deg"], table["latitude_deg"])
    assert np.hypot(x - table["x_m"], y - table["y_m"]).max() < CM


@pytest.mark.parametrize("name", [name for name in ROUTE_FORMATS if name != "mcap"])
@pytest.mark.parametrize("whole", ["route", "tour"])
def test_what_is_written_is_read_again(
    name: str, whole: str, request: pytest.FixtureRequest, costmap: jm.CostMap, tmp_path: Path
) -> None:
    planned = request.getfixturevalue(whole)
    file = planned.save(tmp_path / f"path{ROUTE_FORMATS[name].suffix}")
    points, notes = read_path(file, costmap.lattice.frame)
    assert notes == []
    assert price_given_path(costmap.lattice, np.array(points)).energy_j == pytest.approx(planned.energy_j, rel=0.01)


def test_a_path_rounded_onto_blocked_ground_is_moved_by_a_centimetre_at_most(costmap: jm.CostMap) -> None:
    lattice = costmap.lattice
    edge = np.argwhere((lattice.blocked[:-1, :-1] == Blocked.FREE) & (lattice.blocked[1:, :-1] != Blocked.FREE))
    row, col = next((r, c) for r, c in edge if (lattice.blocked[r, c : c + 3] == 0).all() and r > 2)
    x, y = lattice.frame.xy([row, row], [col, col + 2])
    beside = np.column_stack([x, y - 0.004])  # 4 mm over the edge
    route = price_given_path(lattice, beside)
    assert "were moved" in route.notes[0]
    assert np.hypot(*(route.points[:, :2] - beside).T).max() <= READ_FURTHEST_M + 1e-9
    with pytest.raises(jm.JoulemapError, match="may not be driven"):
        price_given_path(lattice, np.column_stack([x, y - 0.3]))


def test_a_map_without_crs_refuses_degrees_and_says_what_to_do(tmp_path: Path) -> None:
    made = jm.costmap(ground(None, 0.0, 80.0), model="physics")
    found = made.plan(START, GOAL, snap=True)
    for chosen in ROUTE_FORMATS.values():
        file = tmp_path / f"route{chosen.suffix}"
        if chosen.degrees:
            with pytest.raises(InputError, match=r"name it yourself with `crs`, like EPSG:32630.*csv"):
                found.save(file)
            assert not file.exists()
        else:
            assert found.save(file).stat().st_size > 0
    document = found.to_geojson(coordinates="map")
    assert "crs" not in document
    assert document["features"][0]["geometry"]["coordinates"][0][:2] == list(found.points[0, :2])
    with pytest.raises(InputError, match="has no coordinate reference system"):
        made.plan({"lat": 36.7, "lon": -4.4}, GOAL)


def test_geojson_in_the_map_s_own_coordinates_names_them(route: jm.PlannedRoute) -> None:
    document = json.loads(written(route.track, "geojson", coordinates="map"))
    assert document["crs"]["properties"]["name"] == WESTERN[0]
    line = np.array(document["features"][0]["geometry"]["coordinates"])
    np.testing.assert_array_equal(line[:, :2], route.points[:, :2])
    with pytest.raises(InputError, match="leave it out for gpx"):
        written(route.track, "gpx", coordinates="map")
    with pytest.raises(InputError, match="give wgs84 or map"):
        written(route.track, "geojson", coordinates="utm")


@pytest.mark.parametrize("name", ["geotiff", "cog"])
def test_gdal_reads_units_headings_reasons_and_deviations(name: str, costmap: jm.CostMap, tmp_path: Path) -> None:
    lattice = replace(costmap.lattice, std_j=np.full_like(costmap.lattice.traction_per_m, 0.5))
    made = jm.CostMap(lattice)
    count = lattice.headings
    with rasterio.open(made.export(tmp_path / "map.tif", format=name)) as file:
        assert (file.count, file.crs.to_epsg()) == (3 * count, 32630)
        assert file.units == ("J/m",) * count + ("1",) * count + ("J",) * count
        assert file.tags(5) == {"KIND": "energy_per_m", "HEADING_DEG": "90"} | {
            key: value for key, value in file.tags(5).items() if key.startswith("STATISTICS")
        }
        codes = lattice.blocked_by_heading()
        energy = np.where(codes[..., 4] == Blocked.FREE, lattice.energy_per_m[..., 4], np.nan)
        np.testing.assert_array_equal(file.read(5), energy.astype(np.float32))
        np.testing.assert_array_equal(file.read(count + 5), codes[..., 4])
        assert json.loads(file.tags(count + 5)["BLOCKED_CODES"])["3"] == "step"
        assert (file.read(2 * count + 5) == 0.5).all()
        assert json.loads(file.tags()["JOULEMAP"])["provenance"] == lattice.provenance
        if name == "cog":
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        x, y = lattice.frame.xy(10, 20)
        assert file.index(float(x), float(y)) == (10, 20)


def test_nav2_reads_the_map_where_it_lies(costmap: jm.CostMap, tmp_path: Path) -> None:
    """By the rules of nav2_map_server's map_io: the last row of the image is the southernmost row of cells."""
    file = costmap.export(tmp_path / "site.yaml")
    about = yaml.safe_load(file.read_text())
    assert (about["mode"], about["image"]) == ("raw", "site.pgm")
    with rasterio.open(tmp_path / about["image"]) as image:
        grid = image.read(1)[::-1]  # row 0 in the south
    lattice = costmap.lattice
    west, south, _, _ = lattice.frame.bounds
    assert about["origin"] == [west, south, 0.0]
    assert about["resolution"] == lattice.frame.resolution_m
    energy = lattice.mean_energy_per_m()[::-1]
    unknown = np.isin(lattice.blocked[::-1], (Blocked.UNKNOWN, Blocked.OUTSIDE))
    np.testing.assert_array_equal(grid == 255, unknown)
    np.testing.assert_array_equal(grid == 100, ~np.isfinite(energy) & ~unknown)
    free = np.isfinite(energy)
    assert (grid[free].min(), grid[free].max()) == (0, 98)
    order = np.argsort(energy[free])
    assert (np.diff(grid[free][order].astype(int)) >= 0).all()


def test_a_route_graph_has_the_prices_of_its_edges(costmap: jm.CostMap) -> None:
    lattice = costmap.lattice
    features = json.loads(write_graph(lattice)[".geojson"])["features"]
    nodes = {f["properties"]["id"]: f["geometry"]["coordinates"] for f in features if f["geometry"]["type"] == "Point"}
    edges = [f for f in features if f["geometry"]["type"] == "MultiLineString"]
    assert len({f["properties"]["id"] for f in features}) == len(features)
    assert len(nodes) <= MOST_NODES
    assert edges
    for edge in edges[:: len(edges) // 50]:
        ends = [nodes[edge["properties"][key]] for key in ("startid", "endid")]
        assert edge["geometry"]["coordinates"] == [ends]
        energy = price_world_path(lattice, ends)
        assert edge["properties"]["cost"] == pytest.approx(max(energy, 0.0), abs=1e-6)
    pairs = {(e["properties"]["startid"], e["properties"]["endid"]) for e in edges}
    assert sum((b, a) in pairs for a, b in pairs) > 0.9 * len(pairs)
