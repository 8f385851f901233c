"""A cost lattice as a file of NumPy arrays."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from joulemap.model.frames import heading_bins
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.layout import metadata


def export_npz(lattice: CostLattice) -> bytes:
    """Return a lattice as a compressed NumPy npz file.

    Parameters
    ----------
    lattice : CostLattice
        What to export.

    Returns
    -------
    bytes
        The file: `energy_per_m` and `blocked` (rows, cols, headings), `headings_rad` (headings,), `elevation_m`
        (rows, cols), `std_j` where it is known, and `metadata` as JSON.
    """
    out = io.BytesIO()
    known: dict[str, Any] = {} if lattice.std_j is None else {"std_j": lattice.std_j}
    np.savez_compressed(
        out,
        energy_per_m=lattice.energy_per_m,
        blocked=lattice.blocked_by_heading(),
        headings_rad=heading_bins(lattice.headings),
        elevation_m=lattice.elevation_m,
        metadata=metadata_json(lattice),
        **known,
    )
    return out.getvalue()


def metadata_json(lattice: CostLattice) -> str:
    """Return what a lattice is, and how it was made.

    Parameters
    ----------
    lattice : CostLattice
        What is exported.

    Returns
    -------
    str
        JSON: frame, robot, codes of blocked reasons, units and provenance.
    """
    return json.dumps({**metadata(lattice.frame, lattice.robot), "provenance": lattice.provenance})
