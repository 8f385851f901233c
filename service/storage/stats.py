"""What a listing says about a heightmap, and its frame from that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap


def heightmap_stats(heightmap: Heightmap, *, band: int | None = None) -> dict[str, Any]:
    """Return what a listing says about a heightmap.

    Result: JSON-able: frame, share of known cells, lowest and highest height and noise [m], and a hash of the heights.
    """
    return {
        **frame_values(heightmap.frame),
        "known_share": heightmap.known_share,
        "height_min_m": float(np.nanmin(heightmap.heights)),
        "height_max_m": float(np.nanmax(heightmap.heights)),
        "hash": heightmap.data_hash,
        "noise_m": heightmap.noise_m,
        "noise_length_m": heightmap.noise_length_m,
        "band": band,
    }


def frame_values(frame: GridFrame, *, side: str = "resolution_m") -> dict[str, Any]:
    """Return the frame of a grid, JSON-able. `side`: what the side of a cell is called there."""
    bounds = list(frame.bounds)
    return {"rows": frame.rows, "cols": frame.cols, side: frame.resolution_m, "bounds": bounds, "crs": frame.crs}


def noise_of_stats(stats: Mapping[str, Any]) -> dict[str, Any]:
    """Return the noise of a heightmap that is kept, as options of its reading; estimated again for older ones."""
    return {"noise_m": stats.get("noise_m"), "noise_length_m": stats.get("noise_length_m", 0.0)}


def frame_of_stats(stats: Mapping[str, Any]) -> GridFrame:
    """Return the frame of a heightmap that is kept."""
    west, _, _, north = stats["bounds"]
    return GridFrame(west, north, stats["resolution_m"], stats["rows"], stats["cols"], stats["crs"])
