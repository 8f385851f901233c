"""docs/how-to/add-a-planner.md: its example is run, planned with, and judged by the energies of its paths."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from joulemap.model.errors import InputError, NoRouteError
from joulemap.planner import planners
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from tests.docs.code_blocks import Machine, blocks_of
from tests.reference.lattices import ascii_lattice, price_world_path, random_lattice

PAGE = "docs/how-to/add-a-planner.md"


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """The names that the page's blocks define; its planner is known while the tests of this module run."""
    known = dict(planners._REGISTRY)
    with Machine(tmp_path_factory.mktemp("page")) as machine:
        for block in blocks_of(PAGE):
            machine.run(block)
        yield machine.names
    planners._REGISTRY.clear()
    planners._REGISTRY.update(known)


def test_the_page_plans_with_its_planner(example: dict[str, Any]) -> None:
    assert example["mine"].energy_j >= example["best"].energy_j * (1 - 1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_it_is_never_cheaper_than_astar_and_within_its_factor(example: dict[str, Any], seed: int) -> None:
    """Weighted A* costs at most its weight more (Pohl 1970); both paths are priced again, leg by leg."""
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 14, 18, regeneration=0.0)
    planner = RoutePlanner(lattice)
    free = np.argwhere(lattice.blocked == 0)[[3, -4]] + rng.uniform(-0.1, 0.1, (2, 2))
    start, goal = (tuple(float(v) for v in lattice.frame.xy(*place)) for place in free)
    try:
        best = planner.plan(start, goal, RouteOptions(refine=False))
    except NoRouteError:
        with pytest.raises(NoRouteError):
            planner.plan(start, goal, RouteOptions(planner="weighted_astar", refine=False))
        return
    mine = planner.plan(start, goal, RouteOptions(planner="weighted_astar", refine=False))
    prices = [price_world_path(lattice, plan.route.points) for plan in (best, mine)]
    assert prices[0] * (1 - 1e-6) <= prices[1] <= example["WEIGHT"] * prices[0]
    assert mine.planner == mine.details["planner"] == "weighted_astar"


def test_behind_a_wall_it_says_that_there_is_no_route(example: dict[str, Any]) -> None:
    lattice, at = ascii_lattice("a.#.b\n..#..")
    with pytest.raises(NoRouteError):
        example["weighted_astar"](
            lattice,
            RoutePlanner(lattice)._table(16, distance=False),
            *(np.array(lattice.frame.rowcol(*at[name])) for name in "ab"),
            planners.Options(),
        )


def test_a_name_is_given_once_and_an_unknown_one_gets_the_nearest(example: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="there is a planner called 'astar' already"):
        planners.register(planners.Planner("astar", example["weighted_astar"]))
    assert planners.register(example["WEIGHTED_ASTAR"]) is example["WEIGHTED_ASTAR"]  # again is no harm
    with pytest.raises(InputError, match="did you mean 'weighted_astar'"):
        planners.planner_named("weighted_astr")
    assert "weighted_astar" not in planners.PLANNERS


def test_one_line_of_the_registry_is_all_that_a_planner_of_joulemap_needs() -> None:
    """What the page says: a module and a line; `PLANNERS` follows."""
    text = Path(planners.__file__).read_text(encoding="utf-8")
    assert text.count("\nregister(") == len(planners.PLANNERS)
    assert planners.PLANNERS == ("astar", "dijkstra", "rrtstar", "informed_rrtstar", "bitstar")
