"""Reach beside planning: the same verdict for goals one by one, and seconds beside an energy field."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.areas.reach import peak_need, reach_field
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route_planner import ANY_ANGLE_NEIGHBOURS, RoutePlanner
from tests.bench.maps import physics_lattice, terrain
from tests.bench.quality import quality_maps
from tests.bench.timing import raced

_SIDE = 1000


def compare_reach(heightmap: Heightmap | None, goals: int) -> list[Table]:
    """Two tables: agreement with planning to random goals, half of the map's energies being in reach; and times."""
    agreement = Table(title=f"reach and planning, {goals} random goals a map")
    columns = ("map", "way", "unlike", "of them further than a cell from the border", "goals in 15 % of the border")
    for column in columns:
        agreement.add_column(column, justify="left" if column in columns[:2] else "right")
    for name, lattice in quality_maps(heightmap):
        for round_trip in (False, True):
            figures = _disagreements(lattice, goals, round_trip=round_trip)
            agreement.add_row(name, "and back" if round_trip else "one way", *(str(figure) for figure in figures))
    times = Table(title=f"seconds, {_SIDE} x {_SIDE} cells, physics")
    for column in ("what", "seconds", "energy fields"):
        times.add_column(column, justify="left" if column == "what" else "right")
    for what, (took, ratio) in _times().items():
        times.add_row(what, f"{took:.2f}", f"{ratio:.2f}")
    return [agreement, times]


def _disagreements(lattice: CostLattice, goals: int, *, round_trip: bool) -> tuple[int, int, int]:
    planner, random = RoutePlanner(lattice), np.random.default_rng(11)
    free = np.argwhere(lattice.blocked == 0)
    start = _world(lattice, free[random.integers(len(free))])
    found, _ = planner.reach(start, round_trip=round_trip)
    places = np.argwhere(np.isfinite(found.base_j))
    available = float(np.median(found.base_j[tuple(places.T)]))
    margin = found.margin_j(available)
    inside = margin >= 0.0
    padded = np.pad(inside, 1, mode="edge")
    rows, cols = inside.shape
    around = [padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3)]
    border = np.any([part != inside for part in around], axis=0)
    unlike = far = near = 0
    for goal in places[random.integers(len(places), size=goals)]:
        there = _world(lattice, goal)
        legs = [(start, there), (there, start)] if round_trip else [(start, there)]
        needed = peak_need([planner.plan(*leg).route for leg in legs])
        near += abs(needed - available) < 0.15 * available
        if (needed <= available) != inside[tuple(goal)]:
            unlike += 1
            far += not border[tuple(goal)]
    return unlike, far, near


def _times() -> dict[str, tuple[float, float]]:
    lattice = physics_lattice(terrain(_SIDE, 1.0))
    table = RoutePlanner(lattice)._table(ANY_ANGLE_NEIGHBOURS, distance=False)
    start = np.array([0.45, 0.55]) * _SIDE
    known = reach_field(lattice, table, start)
    available = float(np.median(known.base_j[np.isfinite(known.base_j)]))

    def _answer(round_trip: bool) -> None:
        reach_field(lattice, table, start, round_trip=round_trip).margin_j(available * (2.0 if round_trip else 1.0))

    return raced(
        {
            "energy field": lambda: reach_field(lattice, table, start),
            "reach, one way": lambda: _answer(False),
            "reach, there and back": lambda: _answer(True),
            "another charge, one way": lambda: known.margin_j(0.98 * available),
        },
        rounds=3,
    )


def _world(lattice: CostLattice, cell: np.ndarray) -> tuple[float, float]:
    x, y = lattice.frame.xy(float(cell[0]), float(cell[1]))
    return float(x), float(y)
