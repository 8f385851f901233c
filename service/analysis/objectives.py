"""What a route is chosen by: its expected energy, a quantile of it, or the probability that the battery lasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from joulemap.model.battery import Battery
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import InputError
from joulemap.model.ranges import OBJECTIVES
from joulemap.planner.answers import Plan
from joulemap.planner.grid.stopping import check_stop
from joulemap.planner.objectives.power_limit import within_power
from joulemap.planner.objectives.risk import Aim, LeastQuantile, MostLikely, Outcome, Priced, least
from joulemap.planner.objectives.weighing import Weighing
from joulemap.planner.pricing.integrator import world_points
from joulemap.planner.route import Route, in_sequence
from joulemap.planner.route_planner import ANY_ANGLE_NEIGHBOURS, USUAL, RouteOptions, RoutePlanner
from joulemap.planner.verdict.budget import chance
from joulemap.planner.verdict.energy_distribution import EnergyOdds
from joulemap.planner.verdict.trajectory import course_of
from joulemap.service.analysis.route_uncertainty import odds_along

MEAN, QUANTILE, ARRIVAL = OBJECTIVES


@dataclass(frozen=True)
class Objective:
    """What the best route is.

    Attributes
    ----------
    name : str
        One of `OBJECTIVES`.
    quantile : float
        Share of drives that take no more energy than the one that is made least, 0.5 to 0.99; for "quantile" only.
    """

    name: str = MEAN
    quantile: float = 0.95


@dataclass(frozen=True)
class Weighed:
    """How a route does by an objective, and how the one of least expected energy does.

    Attributes
    ----------
    name : str
        Of the objective.
    quantile : float or None
        Its share of drives; None for arrival.
    quantile_j : float or None
        Energy that this share of drives does not exceed [J]; None for arrival.
    mean_quantile_j : float or None
        The same on the route of least expected energy [J], never less.
    probability : float or None
        That the battery lasts, with its tails; None for quantile.
    mean_probability : float or None
        The same on the route of least expected energy, never more.
    gap : float or None
        By how much a better route may be better, as a share of the energy, or as a difference of probabilities, if
        every search found its cheapest route; None where nothing is known.
    searches : int
        Number of prices of uncertainty that were searched.
    """

    name: str
    quantile: float | None = None
    quantile_j: float | None = None
    mean_quantile_j: float | None = None
    probability: float | None = None
    mean_probability: float | None = None
    gap: float | None = None
    searches: int = 1


Routes = tuple[Route, ...]


def limited(planner: RoutePlanner, max_power_w: float) -> RoutePlanner:
    """Return the planner of the same map whose routes draw at most some power, at the robot's speed [W]."""
    planner.needs_memory("a limit of power")
    return within_power(planner, max_power_w)


def plan_by(
    router: RoutePlanner,
    start: tuple[float, float],
    goal: tuple[float, float],
    objective: Objective,
    how: RouteOptions = USUAL,
    *,
    battery: Battery | None = None,
) -> Plan:
    """Return the best route by an objective, with the shortest one beside it.

    `start`, `goal`: world x, y [m]. Result: its details have the objective under "objective", if it is another one than
    the expected energy.
    """
    if objective.name != MEAN:
        _check(router, objective, battery)
    plan = router.plan(start, goal, how)
    if objective.name == MEAN:
        return plan
    neighbours = ANY_ANGLE_NEIGHBOURS if how.refine else how.neighbours
    routes, weighed = best_routes(
        router,
        (plan.route,),
        objective,
        battery=battery,
        refine=how.refine,
        neighbours=neighbours,
        progress=how.progress,
    )
    return replace(plan, route=routes[0], details=plan.details | {"objective": weighed.__dict__})


def best_routes(
    planner: RoutePlanner,
    means: Routes,
    objective: Objective,
    *,
    battery: Battery | None = None,
    refine: bool = True,
    neighbours: int = ANY_ANGLE_NEIGHBOURS,
    progress: Callable[[float], None] | None = None,
) -> tuple[Routes, Weighed]:
    """Return the best routes by an objective that are driven one after another.

    Returns `routes`: never worse by the objective than `means`; `weighed`: how good they are.
    """
    _check(planner, objective, battery)
    assert isinstance(planner, RoutePlanner)
    odds = odds_along(means)
    assert odds is not None
    assert means[0].spread is not None
    spread = Spread.from_dict(means[0].spread)
    if not odds.mean_j.size:  # from a place to itself
        if objective.name == QUANTILE:
            return means, Weighed(objective.name, objective.quantile, 0.0, 0.0, gap=0.0)
        sure = float(battery is not None and battery.available_j >= 0.0)
        return means, Weighed(objective.name, probability=sure, mean_probability=sure, gap=0.0)
    aim = _aim(objective, odds, spread, battery)
    ends = [world_points(planner.lattice, route.points[[0, -1]]) for route in means]
    searched = 0

    def _solve(tangent: _Tangent, weighing: Weighing, price: float) -> Priced[Routes]:
        nonlocal searched
        searched += 1
        if price == 0.0:
            return tangent.priced(means, price, None)
        check_stop()
        if progress is not None:
            progress(1.0 - 0.8**searched)
        found = [weighing.cheapest(start, goal, price, neighbours=neighbours, refine=refine) for start, goal in ends]
        routes = tuple(route for route, _ in found)
        return tangent.priced(routes, price, None if refine else sum(bound for _, bound in found))

    def _worth(one: Priced[Routes]) -> float:
        if objective.name == QUANTILE:
            known = odds_along(one.ways)
            assert known is not None
            return known.final_quantile(objective.quantile)
        assert battery is not None
        volts = planner.lattice.robot.nominal_voltage_v
        return 1.0 - chance(course_of(one.ways), battery, nominal_voltage_v=volts, odds=odds_along(one.ways))

    def _around(routes: Routes) -> Outcome[Routes]:
        """The best routes, with the tangent at some."""
        tangent = _Tangent(spread, _sums(routes)[2], planner.lattice.robot.turn_j_per_rad)
        weighing = Weighing(planner, spread.correlation_m, per_std_j=tangent.per_std_j)
        return least(aim, partial(_solve, tangent, weighing), worth=_worth)

    outcome = _around(means)
    if spread.run_std_share > 0.0 and outcome.best is not outcome.mean:
        outcome = outcome.joined(_around(outcome.best.ways), _worth)
    best, mean = _worth(outcome.best), _worth(outcome.mean)
    gap = _gap(aim, outcome, odds)
    if objective.name == QUANTILE:
        weighed = Weighed(objective.name, objective.quantile, best, mean, gap=gap, searches=outcome.searches)
    else:
        chances = {"probability": 1.0 - best, "mean_probability": 1.0 - mean}
        weighed = Weighed(objective.name, **chances, gap=gap, searches=outcome.searches)
    pairs = zip(outcome.best.ways, means, strict=True)
    return tuple(replace(one, notes=mean.notes, goal_moved_m=mean.goal_moved_m) for one, mean in pairs), weighed


def _check(planner: RoutePlanner, objective: Objective, battery: Battery | None) -> None:
    planner.needs_memory(f"the objective {objective.name}")
    lattice = planner.lattice
    if lattice.std_j is None or lattice.provenance.get("model", {}).get("spread") is None:
        raise InputError(
            f"the objective {objective.name} needs a model that knows how far off it is: use the model default, or "
            "calibrate this one with runs",
            objective=objective.name,
        )
    if objective.name == ARRIVAL and battery is None:
        raise InputError("the objective arrival needs a battery: give its charge and reserve", objective=ARRIVAL)


def _aim(objective: Objective, odds: EnergyOdds, spread: Spread, battery: Battery | None) -> Aim:
    """The objective of mean and variance, at the degrees of freedom of the route of least expected energy."""
    if objective.name == ARRIVAL:
        assert battery is not None
        return MostLikely(battery.available_j, spread.run_share, spread.bias)
    from scipy.special import ndtri, stdtrit  # loads slowly, and few questions need it

    share = objective.quantile
    steps = ndtri(share) if odds.freedom is None else stdtrit(odds.freedom[-1], share)
    return LeastQuantile(float(steps) * spread.skew**0.5, spread.run_share, spread.bias)


@dataclass(frozen=True)
class _Tangent:
    """The variance of routes, and a bound of it that adds up metre by metre.

    The square of the sum S of standard deviations, which whole runs have in common, is no sum over metres. Its tangent
    2 S0 S - S0^2 at some routes is, and lies below it: what is found with it is priced in full, and bounds stay bounds.
    """

    spread: Spread
    std_j: float
    turn_j_per_rad: float

    @property
    def per_std_j(self) -> float:
        """Slope of the tangent [J]."""
        return 2.0 * self.spread.run_std_share**2 * self.std_j

    def priced(self, routes: Routes, price: float, least_j: float | None) -> Priced[Routes]:
        """Routes, cheapest at a price without turns between them; `least_j`: none are cheaper, where that is known."""
        share = self.spread.run_std_share
        mean_j, of_metres, std_j = _sums(routes)
        variance = self.spread.correlation_m * of_metres + (share * std_j) ** 2
        if least_j is None:
            bound_j = mean_j + price * (variance - (share * (std_j - self.std_j)) ** 2)
        else:
            bound_j = least_j - price * (share * self.std_j) ** 2
        driven = in_sequence(routes, self.turn_j_per_rad)
        return Priced(driven, sum(route.energy_j for route in driven), variance, bound_j)


def _sums(routes: Routes) -> tuple[float, float, float]:
    """Mean energy [J], variance of the metres as if they were independent [J2], and their standard deviations [J]."""
    course = course_of(routes)
    assert course.std_j is not None
    driven, std_j = course.driven_m, course.std_j
    of_metres = std_j[driven > 0.0] ** 2 / driven[driven > 0.0]  # a piece is correlated in itself
    return sum(route.energy_j for route in routes), float(of_metres.sum()), float(std_j.sum())


def _gap(aim: Aim, outcome: Outcome[Routes], odds: EnergyOdds) -> float | None:
    if isinstance(aim, LeastQuantile):
        return (outcome.value - outcome.bound) / outcome.bound if outcome.bound > 0.0 else None
    if outcome.value > 0.0:  # the median takes more than there is
        return None
    freedom = None if odds.freedom is None else odds.freedom[-1:]
    normal = replace(odds, mean_j=odds.mean_j[-1:] * 0.0, scale_j=odds.scale_j[-1:] * 0.0 + 1.0, freedom=freedom)
    likely = [float(normal.lasts(-steps)[0]) for steps in (outcome.bound, outcome.value)]
    return likely[0] - likely[1]
