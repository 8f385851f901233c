"""A route graph for Nav2's route server: places on a coarse grid, and what driving between neighbours costs."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import leg_prices_between
from joulemap.service.exports.ros_path import FRAME

MOST_NODES = 2_500
"""Setting: of a graph, whose spacing follows from it; they make a file of about 5 MB, all of which is read."""

_NEIGHBOURS = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))


def write(lattice: CostLattice) -> dict[str, bytes]:
    """Return a route graph.

    Result: ".geojson" -> the file, in the form of Nav2: nodes are points with `id` and `frame`, edges have `startid`,
    `endid` and `cost`, the energy of the straight way [J], at least 0. Its coordinates are x, y [m] of the map.
    """
    rows, cols = lattice.frame.shape
    cells = max(1, math.ceil(math.sqrt(rows * cols / MOST_NODES)))
    place = _nodes(lattice, cells)
    there = place[..., 0] >= 0
    number = np.where(there, np.cumsum(there).reshape(there.shape) - 1, -1)
    edges = _edges(lattice, place, number)
    x, y = lattice.frame.xy(place[there][:, 0], place[there][:, 1])
    features: list[dict[str, Any]] = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [east, north]},
            "properties": {"id": k, "frame": FRAME},
        }
        for k, (east, north) in enumerate(zip(x.tolist(), y.tolist(), strict=True))
    ]
    first = len(features)
    for k, (start, end, energy, length) in enumerate(edges, start=first):
        shape = [features[n]["geometry"]["coordinates"] for n in (start, end)]
        properties = {
            "id": k,
            "startid": start,
            "endid": end,
            "cost": max(energy, 0.0),
            "overridable": False,
            "metadata": {"energy_j": energy, "length_m": length},
        }
        geometry = {"type": "MultiLineString", "coordinates": [shape]}
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    document = {"type": "FeatureCollection", "name": "graph", "features": features}
    return {".geojson": (json.dumps(document, allow_nan=False) + "\n").encode()}


def _nodes(lattice: CostLattice, cells: int) -> NDArray[np.int64]:
    """(m, n, 2) row and column of the free cell nearest the middle of each square of cells; -1 where there is none."""
    rows, cols = lattice.frame.shape
    free = (lattice.blocked == Blocked.FREE) & np.isfinite(lattice.mean_energy_per_m())
    found = np.full((math.ceil(rows / cells), math.ceil(cols / cells), 2), -1)
    for i, j in np.ndindex(*found.shape[:2]):
        part = np.argwhere(free[i * cells : (i + 1) * cells, j * cells : (j + 1) * cells])
        if part.size:
            nearest = part[np.square(part - 0.5 * (cells - 1)).sum(axis=1).argmin()]
            found[i, j] = nearest + np.array([i * cells, j * cells])
    return found


def _edges(
    lattice: CostLattice, place: NDArray[np.int64], number: NDArray[np.int64]
) -> list[tuple[int, int, float, float]]:
    """Start, end, energy [J] and length [m] of every way between neighbours that may be driven."""
    found = []
    shape = number.shape
    for i, j in _NEIGHBOURS:
        here = np.s_[max(-i, 0) : shape[0] - max(i, 0), max(-j, 0) : shape[1] - max(j, 0)]
        there = np.s_[max(i, 0) : shape[0] + min(i, 0), max(j, 0) : shape[1] + min(j, 0)]
        both = (number[here] >= 0) & (number[there] >= 0)
        starts, ends = place[here][both].astype(float), place[there][both].astype(float)
        energy = leg_prices_between(lattice, starts, ends)
        length = np.hypot(*(ends - starts).T) * lattice.frame.resolution_m
        rows = zip(
            number[here][both].tolist(), number[there][both].tolist(), energy.tolist(), length.tolist(), strict=True
        )
        found += [row for row in rows if math.isfinite(row[2])]
    return found
