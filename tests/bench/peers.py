"""Other people's searches on the same map: seconds, and the energy of the paths they find under our integrator.

Each peer gets what it can take: the very same move prices where it knows directed edges, the mean price of a cell where
it knows only cells, the closest coefficients where it has a formula of its own. One that is not installed says so.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse.csgraph import dijkstra

from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import MoveTable

GRAPH_CELLS = 100_000
"""Larger maps are not given to libraries whose edges are objects: building their graph takes minutes."""


@dataclass(frozen=True)
class PeerRow:
    """What a peer did: search_s alone, build_s before it, energy_j of its path; a note where it could not."""

    name: str
    search_s: float = np.nan
    build_s: float = np.nan
    energy_j: float = np.nan
    note: str = ""


@dataclass(frozen=True, eq=False)
class Question:
    """start, goal : (row, col) cells."""

    lattice: CostLattice
    table: MoveTable
    graph: object
    start: tuple[int, int]
    goal: tuple[int, int]

    def flat(self, cell: tuple[int, int]) -> int:
        return cell[0] * self.lattice.frame.cols + cell[1]

    def energy(self, cells: np.ndarray) -> float:
        return path_price(self.lattice, np.asarray(cells, dtype=float))

    def mean_price(self) -> np.ndarray:
        """(rows, cols) J per cell length, the mean over headings; inf where blocked."""
        mean = self.lattice.energy_per_m.mean(axis=2) * self.lattice.frame.resolution_m
        return np.where(self.lattice.blocked == 0, mean, np.inf)


def timed(work: Callable[[], object]) -> tuple[float, object]:
    began = time.perf_counter()
    out = work()
    return time.perf_counter() - began, out


def by_scipy(q: Question) -> PeerRow:
    source, target = q.flat(q.start), q.flat(q.goal)
    took, (_, before) = timed(lambda: dijkstra(q.graph, indices=source, return_predecessors=True))
    cells = [target]
    while cells[-1] != source:
        cells.append(int(before[cells[-1]]))
    return PeerRow("scipy dijkstra, 16, the same prices", took, energy_j=_flat_energy(q, cells[::-1]))


def by_mcp(q: Question) -> PeerRow:
    graph = importlib.import_module("skimage.graph")
    build, search = timed(lambda: graph.MCP_Geometric(q.mean_price()))
    took, _ = timed(lambda: search.find_costs([q.start], [q.goal]))
    path = np.array(search.traceback(q.goal))
    return PeerRow("scikit-image MCP_Geometric, 8, mean price", took, build, q.energy(path))


def by_pyastar(q: Question) -> PeerRow:
    module = importlib.import_module("pyastar2d")
    price = q.mean_price()
    weights = (price / price.min()).astype(np.float32)
    took, path = timed(lambda: module.astar_path(weights, q.start, q.goal, allow_diagonal=True))
    return PeerRow("pyastar2d, 8, mean price", took, energy_j=q.energy(path))


def by_rustworkx(q: Question) -> PeerRow:
    module = importlib.import_module("rustworkx")
    edges = q.graph.tocoo()

    def build():
        graph = module.PyDiGraph(multigraph=False)
        graph.add_nodes_from(range(edges.shape[0]))
        graph.add_edges_from(list(zip(edges.row.tolist(), edges.col.tolist(), edges.data.tolist(), strict=True)))
        return graph

    built, graph = timed(build)
    target = q.flat(q.goal)
    took, paths = timed(
        lambda: module.dijkstra_shortest_paths(graph, q.flat(q.start), target=target, weight_fn=lambda price: price)
    )
    return PeerRow("rustworkx dijkstra, 16, the same prices", took, built, _flat_energy(q, paths[target]))


def by_igraph(q: Question) -> PeerRow:
    module = importlib.import_module("igraph")
    edges = q.graph.tocoo()
    built, graph = timed(
        lambda: module.Graph(n=edges.shape[0], edges=np.column_stack([edges.row, edges.col]).tolist(), directed=True)
    )
    prices = edges.data.tolist()
    took, paths = timed(lambda: graph.get_shortest_paths(q.flat(q.start), q.flat(q.goal), weights=prices))
    return PeerRow("igraph dijkstra, 16, the same prices", took, built, _flat_energy(q, paths[0]))


def _flat_energy(q: Question, cells) -> float:
    return q.energy(np.column_stack(np.divmod(list(cells), q.lattice.frame.cols)))


def by_grass(q: Question) -> PeerRow:
    """r.walk's formula is eq. 5 while the robot is not braking; beyond, its line for steep descents comes near."""
    if shutil.which("grass") is None:
        raise ModuleNotFoundError("grass")
    robot, frame = q.lattice.robot, q.lattice.frame
    weight, mu = robot.weight_n, robot.rolling_resistance
    (x, y), (gx, gy) = ((float(v) for v in frame.xy(*cell)) for cell in (q.start, q.goal))
    west, south, east, north = frame.bounds
    with tempfile.TemporaryDirectory() as folder:
        heights = Path(folder) / "z.bin"
        q.lattice.elevation_m.astype("<f4").tofile(heights)
        script = Path(folder) / "walk.sh"
        script.write_text(f"""set -e
r.in.bin --q -f input={heights} output=z bytes=4 north={north} south={south} east={east} west={west} \
  rows={frame.rows} cols={frame.cols}
g.region raster=z
began=$(date +%s.%N)
r.walk --q -k elevation=z friction=z lambda=0 output=cost outdir=way start_coordinates={x},{y} \
  walk_coeff={robot.hotel_per_m + weight * mu},{weight},{weight},{weight / 2} slope_factor={-mu}
echo "took $(echo "$(date +%s.%N) - $began" | bc)"
r.path --q input=way format=degree vector_path=path start_coordinates={gx},{gy}
v.out.ascii --q input=path type=line format=standard
""")
        done = subprocess.run(
            ["grass", "--tmp-location", "XY", "--exec", "bash", str(script)], capture_output=True, text=True, check=True
        )
    lines = [line.split() for line in done.stdout.splitlines()]
    took = float(next(line[1] for line in lines if line and line[0] == "took"))
    points = np.array([[float(v) for v in line] for line in lines if len(line) == 2 and line[0][0].isdigit()])
    row, col = frame.rowcol(points[::-1, 0], points[::-1, 1])
    return PeerRow(
        "GRASS r.walk -k, 16, its own formula (with I/O)", took, energy_j=q.energy(np.column_stack([row, col]))
    )


PEERS: dict[str, Callable[[Question], PeerRow]] = {
    "scipy": by_scipy,
    "scikit-image": by_mcp,
    "pyastar2d": by_pyastar,
    "rustworkx": by_rustworkx,
    "igraph": by_igraph,
    "GRASS": by_grass,
}


def ask_peers(question: Question) -> list[PeerRow]:
    """One row for every peer, absent ones included."""
    rows = []
    for name, ask in PEERS.items():
        if name in ("rustworkx", "igraph") and question.table.surface.size > GRAPH_CELLS:
            rows.append(PeerRow(name, note=f"not asked above {GRAPH_CELLS:,} cells: an object per edge"))
            continue
        try:
            rows.append(ask(question))
        except ModuleNotFoundError:
            rows.append(PeerRow(name, note="not installed"))
    return rows
