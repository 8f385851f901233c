"""A Nav2 map, YAML and PGM: the mean energy per metre as occupancy, for a static layer of a costmap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import Blocked, CostLattice

LETHAL, UNKNOWN, MOST = 100, 255, 98
"""Values of occupied and unknown cells, and of the cell in which a metre takes most energy."""

_NOT_KNOWN = (Blocked.OUTSIDE, Blocked.UNKNOWN)


def occupancy_of(lattice: CostLattice) -> tuple[NDArray[np.uint8], tuple[float, float]]:
    """Return a cost map as occupancy.

    Returns `values` (rows, cols): 0 to 98 from the least to the greatest mean energy per metre over the headings that
    may be driven, 100 where no heading may be, 255 where the ground is not known; `span`: that least and greatest
    energy [J/m], zeros where nothing may be driven.
    """
    energy = lattice.mean_energy_per_m()
    free = np.isfinite(energy)
    low, high = (float(energy[free].min()), float(energy[free].max())) if free.any() else (0.0, 0.0)
    scaled = np.zeros(energy.shape)
    if high > low:
        scaled[free] = (energy[free] - low) * (MOST / (high - low))
    values = np.where(free, np.rint(scaled), LETHAL).astype(np.uint8)
    values[np.isin(lattice.blocked, [int(reason) for reason in _NOT_KNOWN])] = UNKNOWN
    return values, (low, high)


def write(lattice: CostLattice) -> dict[str, bytes]:
    """Return a cost map as the files of Nav2's map server.

    Result: ".pgm" -> the image, whose first row is north; ".yaml" -> where it lies. The name of the image in it is
    "{stem}.pgm", to be replaced by that of the file.

    Reference: nav2_map_server, map_io: in mode `raw` values of 0 to 100 are the occupancy, and others are unknown.
    """
    values, (low, high) = occupancy_of(lattice)
    rows, cols = values.shape
    west, south, _, _ = lattice.frame.bounds
    lines = [
        f"# joulemap: mean energy per metre for {' '.join(lattice.robot.name.split())}, 0 = {low:.2f} J/m to {MOST} =",
        f"# {high:.2f} J/m; {LETHAL} = no heading may be driven; {UNKNOWN} = not known.",
        f"# Frame: x east, y north in metres of {lattice.frame.crs_in_words}.",
        "# In Nav2's static layer set trinary_costmap: false.",
        "image: {stem}.pgm",
        "mode: raw",
        f"resolution: {lattice.frame.resolution_m!r}",
        f"origin: [{west!r}, {south!r}, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.99",
        "free_thresh: 0.01",
    ]
    picture = f"P5\n{cols} {rows}\n255\n".encode() + values.tobytes()
    return {".yaml": ("\n".join(lines) + "\n").encode(), ".pgm": picture}
