"""Routes by a quantile, by the probability of arriving and within a power: against every path of small grids."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

from joulemap.model.battery import Battery
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.objectives.power_limit import within_power
from joulemap.planner.objectives.risk import Aim, LeastQuantile, MostLikely, Priced, least
from joulemap.planner.objectives.weighing import Weighing, weighed
from joulemap.planner.route import price_route
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from joulemap.service.analysis.objectives import Objective, Weighed, plan_by
from joulemap.service.analysis.route_uncertainty import odds_along
from tests.reference.lattices import plane_lattice, random_lattice

AIMS = [LeastQuantile(1.7, 0.1, 0.05), LeastQuantile(2.5), MostLikely(900.0, 0.1), MostLikely(900.0, 0.0, 0.06)]


def known(lattice: CostLattice, std_j: np.ndarray, **spread: float) -> CostLattice:
    """The lattice with errors of its metres."""
    errors = Spread(**({"run_share": 0.1, "correlation_m": 2.0} | spread)).as_dict()
    shape = lattice.traction_per_m.shape
    std = np.broadcast_to(np.asarray(std_j, np.float32).reshape(*np.shape(std_j), 1), shape)
    return replace(lattice, std_j=std.copy(), provenance={"model": {"spread": errors}})


def patchy(rng: np.random.Generator, rows: int, cols: int) -> CostLattice:
    """Hills on which some ground is badly known."""
    lattice = random_lattice(rng, rows, cols)
    return known(lattice, np.where(rng.random((rows, cols)) < 0.4, 150.0, 5.0))


@pytest.mark.parametrize("aim", AIMS)
def test_the_best_of_some_points_is_found_by_linear_prices(aim: Aim) -> None:
    """Of points of mean and variance, without looking at their objective one by one."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        mean, variance = rng.uniform(300.0, 800.0, 30), rng.uniform(0.0, 200.0, 30) ** 2

        def _solve(price: float, mean=mean, variance=variance) -> Priced[int]:
            k = int(np.argmin(mean + price * variance))
            return Priced(k, float(mean[k]), float(variance[k]))

        found, values = least(aim, _solve), [aim.value(m, v) for m, v in zip(mean, variance, strict=True)]
        assert found.bound <= min(values) + 1e-9
        assert found.value - min(values) <= 1.01e-3 * max(abs(min(values)), 1.0)


@pytest.mark.parametrize("aim", AIMS)
@pytest.mark.parametrize("seed", range(4))
def test_over_grid_moves_no_path_is_better(aim: Aim, seed: int) -> None:
    """Every simple path of a grid of 4 x 3 cells, priced move by move."""
    lattice = patchy(np.random.default_rng(seed), 4, 3)
    planner = RoutePlanner(lattice)
    weighing = Weighing(planner, 2.0)
    base, variance = planner._table(8, distance=False), weighing.variances(8)
    graph = nx.DiGraph()
    for row, col, move in np.argwhere(np.isfinite(base.energy)):
        there = (row + base.offsets[move, 0], col + base.offsets[move, 1])
        at = row, col, move
        graph.add_edge((row, col), there, mean=float(base.energy[at]), variance=float(variance[at]))
    ends = [place for place in ((0, 0), (3, 2)) if place in graph]
    assert nx.has_path(graph, *ends)

    def _sums(path: list) -> tuple[float, float]:
        edges = [graph.edges[edge] for edge in zip(path[:-1], path[1:], strict=True)]
        return sum(e["mean"] for e in edges), sum(e["variance"] for e in edges)

    start, goal = (np.array(place, dtype=float) for place in ends)

    def _solve(price: float) -> Priced[list]:
        prices = weighed(lattice, weighing._variance, price)
        found = grid_search(prices, weighing.table(price, 8), start, goal)
        path = [tuple(int(v) for v in point) for point in found.points]
        mean, more = _sums(path)
        assert found.energy_j == pytest.approx(mean + price * more, rel=1e-5)
        return Priced(path, mean, more, found.energy_j)

    best = min(aim.value(*_sums(path)) for path in nx.all_simple_paths(graph, *ends))
    found = least(aim, _solve)
    assert found.value - best <= 2e-3 * max(abs(best), 1.0)
    assert found.bound <= best + 1e-4 * abs(best)


def test_an_uncertain_short_cut_is_avoided() -> None:
    """Two metres of detour for certain ground: the mean goes straight, the quantile around, and arriving too."""
    lattice = plane_lattice(21, 41, robot=Robot())
    swamp = np.full((21, 41), 1.0)
    swamp[6:15, 15:26] = 90.0
    planner = RoutePlanner(known(lattice, swamp, run_share=0.02, correlation_m=5.0))
    ends = (2.5, 10.5), (38.5, 10.5)
    straight = planner.plan(*ends).route
    careful = plan_by(planner, *ends, Objective("quantile", 0.95))
    weighed_ = Weighed(**careful.details["objective"])
    assert careful.route.energy_j > straight.energy_j
    assert np.abs(careful.route.points[:, 1] - 10.5).max() > 3.0
    for route, said in ((careful.route, weighed_.quantile_j), (straight, weighed_.mean_quantile_j)):
        odds = odds_along([route])
        assert odds is not None
        assert odds.final_quantile(0.95) == pytest.approx(said)
    assert weighed_.quantile_j < weighed_.mean_quantile_j
    battery = Battery(280.0, charge=1.2 * straight.energy_j / 3600.0 / 280.0)
    likely = Weighed(**plan_by(planner, *ends, Objective("arrival"), battery=battery).details["objective"])
    assert likely.probability > likely.mean_probability
    empty = Battery(280.0, charge=0.5 * straight.energy_j / 3600.0 / 280.0)  # luck is no plan
    route = plan_by(planner, *ends, Objective("arrival"), battery=empty).route
    assert route.energy_j == pytest.approx(straight.energy_j)


@pytest.mark.parametrize("common", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(6))
def test_by_its_objective_a_route_is_never_worse_than_the_cheapest(seed: int, common: float) -> None:
    """The error of a whole run: a share of the energy alone, and one that grows with the standard deviations too."""
    rng = np.random.default_rng(seed)
    lattice = patchy(rng, 24, 24)
    planner = RoutePlanner(known(lattice, lattice.std_j[..., 0], run_std_share=common))
    ends = [tuple(float(v) for v in planner.lattice.frame.xy(*rng.uniform(1.0, 22.0, 2))) for _ in range(2)]
    mean = planner.plan(*ends, RouteOptions(snap=True)).route
    for objective in (Objective("quantile", 0.9), Objective("arrival")):
        battery = Battery(280.0, charge=min(1.3 * mean.energy_j / 3600.0 / 280.0, 1.0))
        found = plan_by(planner, *ends, objective, RouteOptions(snap=True), battery=battery)
        said = Weighed(**found.details["objective"])
        if objective.name == "quantile":
            assert said.quantile_j <= said.mean_quantile_j
        else:
            assert said.probability >= said.mean_probability
        assert said.gap is not None
        assert said.gap <= 0.02


@pytest.mark.parametrize("seed", range(4))
def test_no_path_is_below_the_bound_where_runs_have_their_deviations_in_common(seed: int) -> None:
    """Among 300 random paths, each priced in full: the square of a sum of deviations is no sum over metres."""
    rng = np.random.default_rng(seed)
    lattice = patchy(rng, 9, 9)
    lattice = known(lattice, lattice.std_j[..., 0], run_share=0.02, correlation_m=0.5, run_std_share=0.5)
    planner = RoutePlanner(lattice)
    ends = tuple(tuple(float(v) for v in lattice.frame.xy(*place)) for place in ((1.0, 1.0), (6.0, 6.0)))
    found = plan_by(planner, *ends, Objective("quantile", 0.9), RouteOptions(refine=False, neighbours=8, snap=True))
    said = Weighed(**found.details["objective"])
    base = planner._table(8, distance=False)
    graph = nx.DiGraph()
    for row, col, move in np.argwhere(np.isfinite(base.energy)):
        graph.add_edge((row, col), (row + base.offsets[move, 0], col + base.offsets[move, 1]))
    first, last = (
        tuple(np.round(lattice.frame.rowcol(*point)).astype(int)) for point in found.route.points[[0, -1], :2]
    )
    for _ in range(300):
        chance = {edge: rng.random() for edge in graph.edges}
        path = nx.dijkstra_path(graph, first, last, lambda a, b, _, chance=chance: chance[a, b])
        odds = odds_along([price_route(lattice, np.column_stack(lattice.frame.xy(*np.array(path, float).T)))])
        assert odds is not None
        assert odds.final_quantile(0.9) >= (1.0 - said.gap - 0.01) * said.quantile_j


def test_where_errors_are_a_share_of_the_energy_the_routes_are_the_same() -> None:
    lattice = random_lattice(np.random.default_rng(1), 24, 24)
    planner = RoutePlanner(known(lattice, np.zeros((24, 24))))
    ends = tuple(tuple(float(v) for v in lattice.frame.xy(*place)) for place in ((2.0, 2.0), (20.0, 21.0)))
    found = plan_by(planner, *ends, Objective("quantile"), RouteOptions(snap=True))
    assert np.array_equal(found.route.points, planner.plan(*ends, RouteOptions(snap=True)).route.points)
    assert found.details["objective"]["searches"] == 1


def test_no_metre_of_a_route_takes_more_than_the_power() -> None:
    """A hill of 15 %: straight up takes 12 W + 35 kg * g * (0.08 + 0.15) * 0.5 m/s = 51 W."""
    planner = RoutePlanner(plane_lattice(40, 40, rise_north=0.15, robot=Robot()))
    ends = (20.5, 4.5), (20.5, 30.5)
    free = planner.plan(*ends).route
    power = free.profile.energy_j / np.diff(free.profile.distance_m, prepend=0.0) * 0.5
    assert power.max() == pytest.approx(12.0 + 35.0 * 9.80665 * 0.23 * 0.5)
    limited = within_power(planner, 45.0)
    assert within_power(planner, 45.0) is limited
    found = limited.plan(*ends)
    for route in (found.route, found.shortest):
        power = route.profile.energy_j / np.diff(route.profile.distance_m, prepend=0.0) * 0.5
        assert power.max() <= 45.0 + 1e-6
    assert found.route.length_m > free.length_m + 1.0
    codes = limited.lattice.blocked_by_heading()[20, 20]
    assert codes[0] == Blocked.POWER  # north
    assert codes[8] == Blocked.FREE
    with pytest.raises(NoRouteError, match="at most 13 W"):
        within_power(planner, 13.0).plan(*ends)
    with pytest.raises(InputError, match="12 W without moving"):
        within_power(planner, 12.0)


def test_what_cannot_be_weighed_is_refused() -> None:
    planner = RoutePlanner(plane_lattice(9, 9, robot=Robot()))
    ends = (1.5, 1.5), (7.5, 7.5)
    with pytest.raises(InputError, match="knows how far off it is"):
        plan_by(planner, *ends, Objective("quantile"))
    with pytest.raises(InputError, match="needs a battery"):
        plan_by(RoutePlanner(known(planner.lattice, np.zeros((9, 9)))), *ends, Objective("arrival"))
