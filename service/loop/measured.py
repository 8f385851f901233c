"""The runs of a calibration beside the prediction of its base model, of all sites together, also segment by segment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.energy.residuals_of_runs import base_residuals, residuals_on
from joulemap.model.errors import RunsError
from joulemap.model.loop.calibrate import Calibration
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import CalibrationRuns, SiteSegments
from joulemap.model.runs.consistency import check_units
from joulemap.model.runs.residuals import LEAST_SEGMENTS, Residuals, joined
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]
_Driven = Sequence[tuple[Heightmap, Segments]]
_Part = tuple[Residuals, dict[str, FloatArray], FloatArray]  # as `residuals_on` returns it


@dataclass(frozen=True, eq=False, repr=False)
class Measured:
    """What a calibration compares.

    Attributes
    ----------
    residuals : Residuals
        Of the runs to learn from, in the order of the sites.
    electric : dict of str to ndarray of float, (n,)
        Readings of the battery of each row, which no effect may copy.
    std : ndarray of float, (n,)
        Standard deviation that the base model assumes [J].
    baseline : Residuals, optional
        Of the baseline runs.
    test : Residuals, optional
        Of the test runs.
    driven_m : tuple of float
        Metres of the runs to learn from that are compared, of each site [m].
    main : SiteSegments
        The site with the most of them. Routes are compared there.
    places : ndarray of float, (m, 2)
        World points [m] that these runs visited on it, on ground that the map knows.
    """

    residuals: Residuals
    electric: dict[str, FloatArray]
    std: FloatArray
    baseline: Residuals | None
    test: Residuals | None
    driven_m: tuple[float, ...]
    main: SiteSegments
    places: FloatArray


def measure(model: str | Path, predictor: Predictor, runs: CalibrationRuns) -> Measured:
    """Compare the runs of all sites with a model."""
    new = [(site, site.new) for site in runs.sites if site.new is not None]
    parts = _each(predictor, runs.robot, [(site.heightmap, segments) for site, segments in new])
    metres = [float(part[0].features.length_m.sum()) for part in parts]
    first = int(np.argmax(metres))
    driven = parts[first][0].features.take(parts[first][0].moving)
    driven_m = iter(metres)
    baseline = [(site.heightmap, site.baseline) for site in runs.sites if site.baseline is not None]
    test = [(site.heightmap, site.test) for site in runs.sites if site.test is not None]
    return Measured(
        _joined(parts),
        {key: np.concatenate([part[1][key] for part in parts]) for key in parts[0][1]},
        np.concatenate([part[2] for part in parts]),
        _joined(_each(predictor, runs.robot, baseline))
        if baseline
        else base_residuals(model, predictor, runs.sites[0].heightmap, runs.robot, None),
        _joined(_each(predictor, runs.robot, test, least=1)) if test else None,
        tuple(0.0 if site.new is None else next(driven_m) for site in runs.sites),
        new[first][0],
        np.column_stack([driven.x, driven.y]),
    )


def _joined(parts: Sequence[_Part]) -> Residuals:
    return parts[0][0] if len(parts) == 1 else joined([part[0] for part in parts])


def _each(predictor: Predictor, robot: Robot, driven: _Driven, *, least: int = LEAST_SEGMENTS) -> list[_Part]:
    """Residuals of each site; `least` segments are asked of all sites together."""
    check_units([(segments, robot) for _, segments in driven])
    if len(driven) == 1:
        return [residuals_on(predictor, driven[0][0], robot, driven[0][1], least=least)]
    parts = []
    for heightmap, segments in driven:
        try:
            parts.append(residuals_on(predictor, heightmap, robot, segments, least=1))
        except RunsError as error:
            raise RunsError(f"{error.message} (site {heightmap.source})", **error.context) from error
    known = sum(int(part[0].moving.sum()) for part in parts)
    if known < least:
        raise RunsError(
            f"only {known} of {sum(len(segments) for _, segments in driven)} segments of 1 m lie on ground that the "
            f"heightmaps know; at least {least} are needed. Do the runs and the heightmaps belong together?",
            segments=known,
            limit=least,
        )
    return parts


def sites_document(runs: CalibrationRuns, measured: Measured) -> list[dict[str, Any]]:
    """Return the sites and what was driven on each, JSON-able.

    Result: `heightmap` (name), names of the `runs`, `baseline_runs` and `test_runs`, metres compared `used_m`, and
    whether it is the `main` site. Runs without positions lie on no map, and are in one entry.
    """
    if not runs.placed:
        driven = {key: [name for site in runs.sites for name in _names(getattr(site, key))] for key in _GROUPS}
        names = {"runs": driven["new"], "baseline_runs": driven["baseline"], "test_runs": driven["test"]}
        return [
            {"heightmap": "none: the runs have no positions", **names, "used_m": sum(measured.driven_m), "main": True}
        ]
    return [
        {
            "heightmap": site.heightmap.source,
            "runs": _names(site.new),
            "baseline_runs": _names(site.baseline),
            "test_runs": _names(site.test),
            "used_m": metres,
            "main": site is measured.main,
        }
        for site, metres in zip(runs.sites, measured.driven_m, strict=True)
    ]


_GROUPS = ("new", "baseline", "test")


def _names(segments: Segments | None) -> list[str]:
    return [] if segments is None else list(segments.runs)


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
