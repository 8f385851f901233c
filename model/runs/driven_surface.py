"""The heightmap of runs without a survey: a surface through the positions that the robot drove over (paper, IV-B)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, InputError, RunsError
from joulemap.model.runs.run import Run
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

RESOLUTION_M = 0.1
"""Side of a cell [m] unless the caller says otherwise: that of the paper's surveys."""
SMOOTHING_M = 0.5
"""Usual smoothing [m]. A body between two axles follows a mean over about half a metre: its positions hold no shorter
waves; the reproduction of the paper uses the same."""
MAX_GAP_M = 2.0
"""Usual reach of the known ground beside driven positions [m]: the square of 2 m that the compact network sees reaches
1.42 m into its corners, and the turned square of a position that is off by a few decimetres must be known too."""
_FAR_OFF_M = 0.1
"""Runs that differ by more than this in height where they meet [m], in the median, are said aloud: RTK-GPS and lidar
registration err by 0.02 to 0.05 m in height."""
_MEET_M = 0.5  # side of the squares in which heights of two runs are compared
_FEWEST_MET = 10  # squares


@dataclass(frozen=True, eq=False)
class DrivenSurface:
    """A surface through driven positions, and how well it fits them.

    Attributes
    ----------
    heightmap : Heightmap
        The surface; unknown far from driven positions.
    fit_m : float
        Root mean square distance of the positions from the surface [m], outliers left out.
    height_differences_m : dict of str to float
        By run, the median difference of its heights and those of other runs at the same places [m]. Runs that meet no
        other are not in it.
    points : int
        Positions used.
    warnings : list of str
        A sentence about runs that do not fit the others; empty where all do.
    """

    heightmap: Heightmap
    fit_m: float
    height_differences_m: dict[str, float]
    points: int
    warnings: list[str]


def driven_surface(
    runs: Sequence[Run],
    *,
    resolution_m: float = RESOLUTION_M,
    smoothing_m: float = SMOOTHING_M,
    max_gap_m: float = MAX_GAP_M,
    antenna_height_m: float = 0.0,
    crs: str | None = None,
) -> DrivenSurface:
    """Fit a heightmap to the positions of runs that are in one frame.

    `runs`: with the column `z`, the height of the antenna or the sensor [m].

    Reference: Wei & Isler 2022, section IV-B: "we fit a surface with the GPS positions along the trajectory".
    """
    if not runs:
        raise InputError("there is no run to make a heightmap of")
    parts = [_positions(run) for run in runs]
    x, y, z = np.concatenate(parts, axis=1)
    try:
        from joulemap.model.terrain.surface_fit import fit_surface  # loads SciPy, and few commands need it

        heightmap = fit_surface(
            x, y, z - antenna_height_m, resolution_m=resolution_m, smoothing_m=smoothing_m, max_gap_m=max_gap_m, crs=crs
        )
    except HeightmapError as error:
        raise HeightmapError(f"no surface through {_listed(runs)}: {error.message}", **error.context) from error
    heightmap = replace(heightmap, source=f"driven positions of {_listed(runs)}")
    off = np.abs(z - antenna_height_m - heightmap.sample(x, y))
    off = off[np.isfinite(off)]
    inside = off[off <= np.quantile(off, 0.99)]
    differences = _differences({run.name: part for run, part in zip(runs, parts, strict=True)})
    off_others = {name: away for name, away in differences.items() if away > _FAR_OFF_M}
    warnings = []
    if off_others:
        listed = ", ".join(f"{name} by {away:.2f} m" for name, away in off_others.items())
        warnings.append(
            f"where runs meet their heights differ ({listed}): are all runs in one frame, and is `z` in metres? "
            "Otherwise make one map for each run"
        )
    return DrivenSurface(heightmap, float(np.sqrt(np.mean(inside**2))), differences, int(x.size), warnings)


def _differences(parts: Mapping[str, FloatArray]) -> dict[str, float]:
    """Median difference of a run's height and the others' in the squares that they share [m], by run."""
    squares: dict[tuple[int, int], dict[str, float]] = {}
    for name, (x, y, z) in parts.items():
        cells, inverse = np.unique(np.floor(np.stack([x, y]) / _MEET_M).astype(np.int64), axis=1, return_inverse=True)
        inverse = inverse.ravel()
        order = np.argsort(inverse, kind="stable")
        ends = np.cumsum(np.bincount(inverse))[:-1]
        for cell, heights in zip(cells.T, np.split(z[order], ends), strict=True):
            squares.setdefault((int(cell[0]), int(cell[1])), {})[name] = float(np.median(heights))
    found: dict[str, float] = {}
    for name in parts:
        away = [
            abs(met[name] - float(np.median([height for other, height in met.items() if other != name])))
            for met in squares.values()
            if name in met and len(met) > 1
        ]
        if len(away) >= _FEWEST_MET:
            found[name] = round(float(np.median(away)), 3)
    return found


def _positions(run: Run) -> FloatArray:
    """x, y and z of the usable fixes with a height, (3, n) [m]."""
    z = run.extras.get("z")
    if z is None or not np.isfinite(z).any():
        what = "no column 'z'" if z is None else "only blanks in the column 'z'"
        raise RunsError.of_run(
            run.name,
            f" has {what}: a surface through driven positions needs their heights [m]. Give a surveyed "
            "heightmap instead",
            column="z",
        )
    points = np.stack([run.x, run.y, z])
    return points[:, np.isfinite(points).all(axis=0)]


def _listed(runs: Sequence[Run]) -> str:
    names = ", ".join(run.name for run in runs[:3])
    return names + (f" and {len(runs) - 3} more runs" if len(runs) > 3 else "")
