"""Measured and predicted energy of each segment of a calibration, by run, for drawing on a map and along a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from joulemap.model.loop.calibrate import Calibration

MOST_SEGMENTS = 20_000
"""Of more, evenly spaced ones are kept."""


def segments_document(found: Calibration) -> dict[str, Any]:
    """Return what was measured and predicted, segment by segment."""
    residuals, moving = found.residuals, found.residuals.moving
    step = max(1, -(-int(moving.sum()) // MOST_SEGMENTS))
    columns = {
        "x": residuals.features.x,
        "y": residuals.features.y,
        "measured": residuals.measured,
        "before": found.held_out["before"],
        "after": found.held_out["after"],
    }
    runs = []
    for number, name in enumerate(residuals.runs):
        rows = np.flatnonzero(moving & (residuals.features.run == number))[::step]
        runs.append({"name": name, **{key: np.round(of[rows], 3).tolist() for key, of in columns.items()}})
    return {"unit": "A s" if residuals.charge else "J", "runs": [run for run in runs if run["x"]]}
