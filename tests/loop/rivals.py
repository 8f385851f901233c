"""Real robots beside simple least squares, on the very same metres: `python -m tests.loop.rivals`.

Whole runs, and whole campaigns, are left out of everything: of the calibration and of the least squares. The columns of
these are what an engineer writes down first: length, climb, turned angle, and time.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.loop.calibrate import Calibration, calibrate
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import CalibrationRuns, read_calibration_runs
from joulemap.model.runs.odometry import Odometry
from joulemap.model.runs.residuals import Residuals
from joulemap.model.runs.without_map import sites_without_map
from joulemap.service.loop.measured import measure
from tests.coverage.real import cuadriga, drive, real_folder

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Read = Callable[[Path], tuple[CalibrationRuns, list[str]]]


def husky(folder: Path) -> tuple[CalibrationRuns, list[str]]:
    """All runs without positions; a campaign is a kind of ground."""
    files = sorted((folder / "husky").glob("*.csv"))
    sites = sites_without_map(files, Robot(), odometry=Odometry(1.07, terrain_from_name=True))
    runs = read_calibration_runs(sites)
    return runs, [name.rpartition("_")[0] for name in runs.segments.runs]


def bmw(folder: Path) -> tuple[CalibrationRuns, list[str]]:
    """31 drives of a car without positions; every drive is a campaign."""
    car = Robot(mass_kg=1300.0, length_m=4.0, width_m=1.8, speed_mps=15.0, rolling_resistance=0.012, regeneration=0.6)
    runs = read_calibration_runs(sites_without_map(sorted((folder / "bmw_i3").glob("*.csv")), car))
    return runs, list(runs.segments.runs)


REAL: dict[str, Read] = {"drive": drive, "cuadriga": cuadriga, "husky": husky, "bmw": bmw}


def columns_of(rows: Residuals) -> FloatArray:
    """Length, climb, turned angle and time of each row, (n, 4)."""
    of = rows.features
    return np.stack([of.length_m, of.grade * of.length_m, of.turned_abs_rad, of.duration_s], axis=1)


def least_squares(rows: Residuals, fold: NDArray[np.int64], count: int) -> FloatArray:
    """What the first `count` columns say of each metre, fitted to the metres of all other folds, (n,)."""
    columns, out = columns_of(rows)[:, :count], np.full(len(rows), np.nan)
    for k in np.unique(fold):
        known = rows.moving & (fold != k)
        found = np.linalg.lstsq(columns[known], rows.measured[known], rcond=None)[0]
        out[fold == k] = columns[fold == k] @ found
    return out


def combined(rows: Residuals, said: Mapping[str, FloatArray], names: Sequence[str], fold: IntArray) -> FloatArray:
    """The convex combination of predictions that errs least on the metres of all other folds (stacking), (n,)."""
    columns, out = np.stack([said[name] for name in names], axis=1), np.full(len(rows), np.nan)
    for k in np.unique(fold):
        known = rows.moving & (fold != k)
        sure = 1e3 * np.linalg.norm(columns[known])  # that the weights sum to one
        tall = np.vstack([columns[known], np.full(len(names), sure)])
        out[fold == k] = columns[fold == k] @ nnls(tall, np.append(rows.measured[known], sure))[0]
    return out


def rmse(rows: Residuals, said: FloatArray, mine: NDArray[np.bool_] | bool = True) -> float:
    """Root mean square error over metres."""
    return float(np.sqrt(np.mean((rows.measured - said)[rows.moving & mine] ** 2)))


def lines_of(name: str, found: Calibration, fold: NDArray[np.int64]) -> list[str]:
    """Errors of all predictions, the run that became worst, and the sum of the predictions."""
    rows, held, runs = found.residuals, found.held_out, np.unique(found.residuals.run)
    said = held | {"three columns": least_squares(rows, fold, 3), "four columns": least_squares(rows, fold, 4)}
    said |= {
        "all four, combined": combined(rows, held, ("after_planner", "least_squares", "constant", "before"), fold),
        "plan time and before, combined": combined(rows, held, ("after_planner", "before"), fold),
    }
    cells = {f"{name} left out": f"{np.sqrt(np.mean(rows.measured[rows.moving] ** 2)):.4g}"}
    cells |= {key: f"{rmse(rows, energy):.4g}" for key, energy in said.items()}
    for key in ("after", "after_planner", "proposed"):
        by_run = [rmse(rows, said[key], rows.run == k) / rmse(rows, said["before"], rows.run == k) for k in runs]
        total = said[key][rows.moving].sum() / rows.measured[rows.moving].sum() - 1.0
        worse = sum(ratio > 1.05 for ratio in by_run)
        cells[f"{key}: worst run, sum"] = f"{max(by_run):.2f} ({worse} of {len(runs)}), {total:+.1%}"
    turned = rows.features.turned_abs_rad
    for words, mine in {
        "": turned >= 0.0,
        ", without the metre that turned most": turned < turned[rows.moving].max(),
    }.items():
        best = min(rmse(rows, said[key], mine) for key in ("three columns", "four columns"))
        cells[f"proposed / best columns{words}"] = f"{rmse(rows, said['proposed'], mine) / best:.2f}"
    effects = ", ".join(e.term.form.name for e in found.effects) or "nothing"
    lines = [f"| {' | '.join(row)} |" for row in (cells, ["---"] * len(cells), cells.values())]
    return [*lines, "", f"named: {effects}; plans use {found.proposal}"]


_AUXILIARY = ("Heating Power CAN [kW]", "AirCon Power [kW]")


def drive_lines(found: Calibration, fold: NDArray[np.int64]) -> list[str]:
    """Errors of the energy of whole drives, with their stops: of the calibration, and of least squares with more and
    more columns, fitted to the rows and to the sums of the other drives.
    """
    rows, of = found.residuals, found.residuals.features
    columns = [of.length_m, of.grade * of.length_m, of.duration_s, of.speed_mps**2 * of.length_m]
    columns += [of.gained_m2ps2, of.kinetic_m2ps2]
    columns += [1e3 * np.nan_to_num(of.columns[name]) * of.duration_s for name in _AUXILIARY if name in of.columns]
    x = np.stack(columns, axis=1)
    drives = np.stack([np.bincount(rows.run, column) for column in x.T], axis=1)
    energy, left_out = (
        np.bincount(rows.run, rows.measured),
        np.array([fold[rows.run == k][0] for k in np.unique(rows.run)]),
    )
    said = {key: np.bincount(rows.run, held) for key, held in found.held_out.items()}
    for count, words in (
        (1, "distance"),
        (6, "+ climb, time, speed, kinetic energy"),
        (len(columns), "+ auxiliary power"),
    ):
        for kind, (a, b, of_row) in {"metres": (x, rows.measured, fold), "drives": (drives, energy, left_out)}.items():
            out = np.empty(len(energy))
            for k in np.unique(left_out):
                known = of_row != k
                fitted = np.linalg.lstsq(a[known][:, :count], b[known], rcond=None)[0]
                out[left_out == k] = drives[left_out == k][:, :count] @ fitted
            said[f"least squares of {kind}: {words}"] = out
    lines = ["| energy of a drive | mean error | root mean square | sum |", "| --- | --- | --- | --- |"]
    for key, total in said.items():
        away = total / energy - 1.0
        spread = (
            f"{np.abs(away).mean():.1%} | {np.sqrt(np.mean(away**2)):.1%} | {total.sum() / energy.sum() - 1.0:+.1%}"
        )
        lines.append(f"| {key} | {spread} |")
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.loop.rivals", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=["drive", "cuadriga"], help=f"of {', '.join(REAL)}")
    parser.add_argument("--left-out", default="runs,campaigns")
    parser.add_argument("--model", default="physics", help="that the calibration starts from")
    options = parser.parse_args(arguments)
    folder = real_folder()
    if folder is None:
        parser.error("there are no real runs here (set JOULEMAP_REAL_DATA to their folder)")
    for name in options.names:
        runs, campaigns = REAL[name](folder)
        measured = measure(options.model, load_predictor(options.model), runs)
        for left_out in options.left_out.split(","):
            groups = campaigns if left_out == "campaigns" else None
            if groups is not None and len(set(groups)) == len(groups):
                continue  # every run is a campaign
            fold = measured.residuals.folds(groups)
            found = calibrate(measured.residuals, electric=measured.electric, groups=groups)
            whole = [] if runs.placed else ["", *drive_lines(found, fold)]
            print("\n".join([*lines_of(f"{name}, {left_out}, {options.model}", found, fold), *whole, ""]), flush=True)


if __name__ == "__main__":
    main()
