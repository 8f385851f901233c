"""The lattice as a networkx DiGraph, for people who want to explore it, and the slow reference of the tests."""

from __future__ import annotations

import networkx as nx
import numpy as np

from joulemap.model.errors import TooLargeError
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import leg_prices_between
from joulemap.planner.pricing.move_prices import move_offsets

MAX_GRAPH_CELLS = 250_000
"""A node is a Python object: larger lattices belong to `joulemap.planner.grid.search`."""


def lattice_graph(lattice: CostLattice, *, neighbours: int = 16) -> nx.DiGraph:
    """Return a directed graph of all free cells and permitted grid moves.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    neighbours : {16, 8, 32}
        Moves per cell.

    Returns
    -------
    networkx.DiGraph
        Nodes are (row, col) with attributes `x`, `y` and `elevation_m` [m]; edges carry `energy_j` [J] and `length_m`
        [m], each priced by `edges` on its own.

    Raises
    ------
    TooLargeError
        Above `MAX_GRAPH_CELLS` cells.
    """
    rows, cols = lattice.frame.shape
    if rows * cols > MAX_GRAPH_CELLS:
        raise TooLargeError(
            f"{rows} x {cols} cells are too many for a networkx graph, the limit is {MAX_GRAPH_CELLS:,} cells",
            cells=rows * cols,
            limit=MAX_GRAPH_CELLS,
        )
    graph = nx.DiGraph(crs=lattice.frame.crs, spacing_m=lattice.frame.resolution_m)
    row, col = np.nonzero(lattice.blocked == Blocked.FREE)
    x, y = lattice.frame.xy(row, col)
    for r, c, east, north in zip(row.tolist(), col.tolist(), x.tolist(), y.tolist(), strict=True):
        graph.add_node((r, c), x=east, y=north, elevation_m=float(lattice.elevation_m[r, c]))
    cells = np.column_stack([row, col]).astype(np.float64)
    for offset in move_offsets(neighbours):
        ends = cells + offset
        energy = leg_prices_between(lattice, cells, ends)
        length = float(np.hypot(*offset)) * lattice.frame.resolution_m
        for k in np.flatnonzero(np.isfinite(energy)):
            here, there = cells[k].astype(int), ends[k].astype(int)
            graph.add_edge(tuple(here.tolist()), tuple(there.tolist()), energy_j=float(energy[k]), length_m=length)
    return graph
