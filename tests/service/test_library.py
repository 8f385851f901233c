"""The Python package as a user writes it: from an array to a cost map, a route, a verdict, and pictures of them."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

import joulemap as jm
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route_planner import RoutePlanner

mpl.use("agg")

START, GOAL = (6.0, 20.0), (54.0, 20.0)


def knoll() -> jm.Heightmap:
    """80 x 120 cells of 0.5 m with a knoll in the middle and a hole of unknown heights in the north-west."""
    row, col = np.mgrid[0:80, 0:120]
    heights = 4.0 * np.exp(-((row - 40) ** 2 + (col - 60) ** 2) / 300.0)
    heights[4:12, 4:12] = np.nan
    return jm.heightmap(heights, resolution_m=0.5, west_m=0.0, crs="EPSG:32630")


@pytest.fixture(scope="module")
def costmap() -> jm.CostMap:
    return jm.costmap(knoll(), robot={"mass_kg": 50.0, "battery_wh": 20.0}, model="physics")


@pytest.fixture(scope="module")
def route(costmap: jm.CostMap) -> jm.PlannedRoute:
    return costmap.plan(START, GOAL, alternatives=1)


def test_importing_it_loads_nothing_heavy() -> None:
    script = "import sys, joulemap; print(*sorted(set(sys.modules) & set(sys.argv[1:])))"
    heavy = ["torch", "numba", "numpy", "scipy", "matplotlib", "fastapi", "ompl", "pydantic", "xarray", "zarr"]
    done = subprocess.run([sys.executable, "-c", script, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_every_public_name_is_there_and_no_other() -> None:
    for name in jm.__all__:
        assert getattr(jm, name) is not None
    assert set(jm.__all__) <= set(dir(jm))
    assert isinstance(jm.__version__, str)
    with pytest.raises(AttributeError, match="no attribute 'costmaps'"):
        jm.costmaps  # type: ignore[attr-defined]  # noqa: B018


def test_a_cost_map_is_the_one_that_the_parts_make(costmap: jm.CostMap) -> None:
    lattice = build_lattice(knoll(), costmap.robot, PhysicsPredictor())
    np.testing.assert_array_equal(costmap.lattice.traction_per_m, lattice.traction_per_m)
    assert costmap.crs == "EPSG:32630"
    assert costmap.bounds == (0.0, 0.0, 60.0, 40.0)
    planned = RoutePlanner(lattice).plan(START, GOAL)
    assert costmap.plan(START, GOAL).energy_j == pytest.approx(planned.route.energy_j)


def test_a_robot_may_be_a_file_a_mapping_or_itself(tmp_path: Path) -> None:
    file = tmp_path / "rover.toml"
    file.write_text("mass_kg = 50\n")
    robots = [file, str(file), {"mass_kg": 50}, jm.Robot(mass_kg=50)]
    energies = {jm.costmap(knoll(), one, model="physics", headings=8).plan(START, GOAL).energy_j for one in robots}
    assert len(energies) == 1


def test_what_is_printed_is_in_words_and_units(costmap: jm.CostMap, route: jm.PlannedRoute) -> None:
    assert repr(costmap) == "<Cost map of 60 x 40 cells of 1 m, 16 headings, robot rover-4wd>"
    assert "J/m" in str(costmap)
    assert "EPSG:32630" in str(costmap)
    assert "less than the shortest" in str(route)
    assert "kJ" in repr(route)
    for shown in (costmap, route, costmap.feasibility(route)):
        html = shown._repr_html_()
        assert html.startswith("<div>")
        assert "object at 0x" not in html + str(shown) + repr(shown)


def test_a_verdict_is_true_exactly_when_the_battery_lasts(costmap: jm.CostMap, route: jm.PlannedRoute) -> None:
    """20 Wh hold 72 kJ; the route needs a few."""
    full = costmap.feasibility(route)
    assert full
    assert full.margin_j == pytest.approx(72_000.0 - route.energy_j)
    share = route.energy_j / 72_000.0
    assert not costmap.feasibility(route, charge=share * 0.9)
    assert costmap.feasibility(route, charge=share * 1.1)
    assert not costmap.feasibility(route, charge=share * 1.1, round_trip=True)
    empty = costmap.feasibility(route, charge=0.0)
    assert "not feasible" in str(empty)
    assert (empty.margin_j, empty.shortfall_j) == (0.0, pytest.approx(route.energy_j))
    both = costmap.feasibility(route, round_trip=True)
    assert both.energy_j == pytest.approx(route.energy_j + costmap.plan(GOAL, START).energy_j)
    assert costmap.feasibility([START, GOAL]).energy_j == pytest.approx(
        costmap.feasibility([START, GOAL]).route_out.energy_j
    )


def test_a_charge_in_percent_is_refused_with_what_to_write(costmap: jm.CostMap, route: jm.PlannedRoute) -> None:
    with pytest.raises(jm.JoulemapError, match=r"for 60 % write 0\.6"):
        costmap.feasibility(route, charge=60)


def test_a_wrong_point_is_named(costmap: jm.CostMap) -> None:
    with pytest.raises(jm.JoulemapError, match=r"goal: .*got there"):
        costmap.plan(START, "there")  # type: ignore[arg-type]


def test_a_tour_comes_home_and_is_judged_as_a_whole(costmap: jm.CostMap) -> None:
    pytest.importorskip("ortools")
    tour = costmap.tour([START, GOAL, (30.0, 34.0)])
    assert tour.order[0] == 0
    assert len(tour.legs) == 3
    assert costmap.feasibility(tour).energy_j == pytest.approx(sum(leg.energy_j for leg in tour.legs))
    with pytest.raises(jm.JoulemapError, match="comes home already"):
        costmap.feasibility(tour, round_trip=True)
    assert [f["properties"]["from_stop"] for f in tour.to_geojson()["features"]] == list(tour.order)
    assert len(tour.plot().lines) >= 3


def test_plots_are_axes_in_true_coordinates(costmap: jm.CostMap, route: jm.PlannedRoute) -> None:
    for axes in (costmap.plot(), route.plot()):
        assert axes.get_xlim() == (0.0, 60.0)
        assert axes.get_ylim() == (0.0, 40.0)
        assert axes.get_xlabel() == "x [m]"
    labels = [text.get_text() for text in route.plot().get_legend().get_texts()]
    assert any(label.startswith("energy-optimal: ") for label in labels)
    assert "blocked: unknown" in labels
    profile = route.plot_profile(quantity="elevation")
    assert profile.get_ylabel() == "elevation [m]"
    with pytest.raises(jm.JoulemapError, match="energy"):
        route.plot_profile(quantity="speed")


def test_a_saved_cost_map_opens_in_joulemap_and_in_xarray(costmap: jm.CostMap, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    folder = costmap.save(tmp_path / "knoll.zarr")
    again = jm.open_costmap(folder)
    np.testing.assert_array_equal(again.lattice.traction_per_m, costmap.lattice.traction_per_m)
    with pytest.raises(jm.JoulemapError, match="overwrite=True"):
        costmap.save(folder)
    costmap.save(folder, overwrite=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        opened = xarray.open_zarr(folder)
    assert opened.x.attrs["units"] == "m"
    np.testing.assert_allclose(opened.x[:2], [0.5, 1.5])
    np.testing.assert_allclose(opened.y[:2], [39.5, 38.5])
    dataset = costmap.to_xarray()
    east = dataset.energy_per_m.sel(heading=90.0, x=10.5, y=20.5)
    assert east.item() == pytest.approx(float(costmap.lattice.energy_per_m[19, 10, 4]))
    assert dataset.energy_per_m.attrs["units"] == "J m-1"  # as the CF conventions write it


def test_routes_as_geojson_and_as_a_table(route: jm.PlannedRoute) -> None:
    document = json.loads(json.dumps(route.to_geojson(), allow_nan=False))
    kinds = [feature["properties"]["kind"] for feature in document["features"]]
    assert kinds[:2] == ["energy_optimal", "shortest"]
    table = route.to_geodataframe()
    assert list(table["kind"]) == kinds
    assert table.crs.to_epsg() == 32630
    assert table.geometry.length[0] == pytest.approx(route.length_m)
    assert table["energy_j"][0] == pytest.approx(route.energy_j)


def test_a_geotiff_has_a_band_for_each_heading(costmap: jm.CostMap, tmp_path: Path) -> None:
    import rasterio

    with rasterio.open(costmap.write_geotiff(tmp_path / "prices.tif")) as file:
        assert file.count == 2 * costmap.lattice.headings  # energies, and why headings are blocked


def test_points_of_a_route_may_be_given_back(costmap: jm.CostMap, route: jm.PlannedRoute) -> None:
    """They have heights, which are not needed."""
    assert costmap.feasibility(route.points).energy_j == pytest.approx(route.energy_j)
    assert costmap.plan(route.points[0], route.points[-1]).energy_j == pytest.approx(route.energy_j, rel=1e-3)


def test_a_heading_is_drawn_when_one_is_given(costmap: jm.CostMap) -> None:
    assert "heading 90" in costmap.plot(heading_deg=90.0).get_title()


@pytest.mark.parametrize(
    ("crs", "match"), [("EPSG:4326", "degrees"), ("UTM30", "not known"), ("EPSG:3857", r"1/cos\(latitude\)")]
)
def test_an_array_is_placed_in_true_metres(crs: str, match: str) -> None:
    with pytest.raises(jm.JoulemapError, match=match):
        jm.heightmap(np.zeros((5, 5)), resolution_m=1.0, crs=crs)


def test_an_undeclared_mark_of_unknown_heights_is_refused() -> None:
    heights = np.zeros((5, 5))
    heights[0, 0] = -9999.0
    with pytest.raises(jm.JoulemapError, match="give `nodata` as -9999"):
        jm.heightmap(heights, resolution_m=1.0)
    assert jm.heightmap(heights, resolution_m=1.0, nodata=-9999.0).known_share == pytest.approx(24 / 25)


def test_what_is_neither_map_nor_robot_is_named() -> None:
    with pytest.raises(jm.JoulemapError, match=r"joulemap\.heightmap"):
        jm.costmap(np.zeros((5, 5)))  # type: ignore[arg-type]
    with pytest.raises(jm.JoulemapError, match="the robot is int '40'"):
        jm.costmap(knoll(), robot=40)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("heights", "match"),
    [([[1.0, 2.0]], "2 x 2"), ([1.0, 2.0], "two dimensions"), ([["a", "b"], ["c", "d"]], "numbers")],
)
def test_what_is_no_heightmap_is_refused(heights: list[object], match: str) -> None:
    with pytest.raises(jm.JoulemapError, match=match):
        jm.heightmap(heights, resolution_m=1.0)  # type: ignore[arg-type]
