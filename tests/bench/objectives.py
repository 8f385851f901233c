"""`python -m tests.bench --objectives`: routes by a quantile and by the odds of arriving, beside the cheapest ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rich.table import Table
from scipy.ndimage import gaussian_filter

from joulemap.model.battery import Battery
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import InfeasibleError
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from joulemap.service.analysis.objectives import Objective, Weighed, plan_by
from tests.bench.maps import terrain

CELLS = 200
SPREAD = Spread(run_share=0.1, correlation_m=3.0, freedom=12.0, run_freedom=8.0)
KNOWN, UNKNOWN = 0.08, 1.5  # standard deviation of a metre over its energy
MORE = 1.3  # the battery of "arrival" holds so much of the least expected energy


def compare_objectives(real: Heightmap | None, tasks: int) -> list[Table]:
    """On each map, how much better than the cheapest routes those of the other objectives are."""
    maps = {"hills": terrain(CELLS, 1.0)} | ({} if real is None else {"real": real})
    return [_compared(name, ground, tasks) for name, ground in maps.items()]


def _compared(name: str, ground: Heightmap, tasks: int) -> Table:
    chance = np.random.default_rng(1)
    planner = RoutePlanner(_badly_known(build_lattice(ground, Robot(), PhysicsPredictor()), chance))
    found: dict[str, list[Weighed]] = {"quantile": [], "arrival": []}
    same = 0
    while len(found["arrival"]) < tasks:
        inside = chance.uniform(3.0, np.array(planner.lattice.frame.shape) - 4.0, (2, 2))
        ends = [tuple(float(v) for v in planner.lattice.frame.xy(*place)) for place in inside]
        try:
            mean = planner.plan(ends[0], ends[1], RouteOptions(snap=True)).route
        except InfeasibleError:
            continue
        battery = Battery(280.0, charge=MORE * mean.energy_j / 3600.0 / 280.0)
        for objective, seen in found.items():
            plan = plan_by(planner, ends[0], ends[1], Objective(objective), RouteOptions(snap=True), battery=battery)
            same += objective == "quantile" and np.array_equal(plan.route.points, mean.points)
            seen.append(Weighed(**plan.details["objective"]))
    table = Table(
        title=f"{name}: {tasks} random tasks, two kinds of ground: metres known to {KNOWN:.0%} and {UNKNOWN:.0%}"
    )
    for column in (
        "objective",
        "worse than cheapest",
        "as the cheapest",
        "gain: mean",
        "gain: most",
        "gap: most",
        "prices",
    ):
        table.add_column(column, justify="left" if column == "objective" else "right")
    gains = [1.0 - one.quantile_j / one.mean_quantile_j for one in found["quantile"]]
    odds = [one.probability - one.mean_probability for one in found["arrival"]]
    for label, gain, seen, equal in (
        ("95 % quantile", gains, found["quantile"], str(same)),
        ("arrival", odds, found["arrival"], ""),
    ):
        gaps = [one.gap for one in seen if one.gap is not None]
        prices = np.mean([one.searches for one in seen])
        shown = f"{np.mean(gain):.2%}", f"{max(gain):.2%}", f"{max(gaps):.2%}", f"{prices:.1f}"
        table.add_row(label, str(sum(value < 0.0 for value in gain)), equal, *shown)
    return table


def _badly_known(lattice, chance: np.random.Generator):
    """The lattice with patches of ground that the model hardly knows."""
    rough = gaussian_filter(chance.normal(size=lattice.frame.shape), 6)
    share = np.where(rough > 0.3 * rough.std(), UNKNOWN, KNOWN)
    std = share[..., None] * np.maximum(lattice.energy_per_m, 20.0)
    model = {**lattice.provenance["model"], "spread": SPREAD.as_dict()}
    return replace(lattice, std_j=std.astype(np.float32), provenance={**lattice.provenance, "model": model})
