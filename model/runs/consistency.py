"""Whether measured runs can have been driven on this heightmap by this robot; checked before they are used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.fixes import projected
from joulemap.model.runs.run import Run
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.units import quantity_of
from joulemap.model.terrain.heightmap import Heightmap

_FAR_OFF = 100.0  # thousandfold are milliamperes, millivolts and milliseconds; no robot is a hundredfold its own file


def check_runs(segments: Segments, heightmap: Heightmap, robot: Robot) -> None:
    """Refuse runs that cannot have been driven on this heightmap by this robot."""
    check_place(segments, heightmap)
    check_units([(segments, robot)])


def check_placed(runs: Iterable[Run]) -> None:
    """Refuse runs on a map of whose positions none was recognised."""
    for run in runs:
        if not run.placed:
            columns = unused_columns(run.extras)
            first, second = [*columns, "...", "..."][:2]
            raise RunsError.of_run(
                run.name,
                "no position was recognised, and a distance alone lies on no map; unused columns are "
                f"{', '.join(columns)[:300] or 'none'}. Say which are its positions: `joulemap import {run.name} "
                f"--map x={first[:60]},y={second[:60]} --out FOLDER` writes the run with them",
                columns=columns,
            )


def unused_columns(columns: Iterable[str]) -> list[str]:
    """Return those of the columns of a run that are none of joulemap's."""
    return [column for column in columns if quantity_of(column) is None]


def check_place(segments: Segments, heightmap: Heightmap) -> None:
    """Refuse runs that hold no segment, or lie off this heightmap."""
    if len(segments) == 0:
        metres = segments.left_out_m
        rules = ", ".join(
            f"{count} {rule}" + (f" ({metres[rule]:.1f} m)" if rule in metres else "")
            for rule, count in segments.left_out.items()
            if count
        )
        raise RunsError(
            "the runs hold no segment of 1 m: did the robot move, is its position recorded, and is `t` in s?"
            + (f" Left out: {rules}" if rules else ""),
            left_out=segments.left_out,
        )
    frame = heightmap.frame
    if not _inside(heightmap, segments.x, segments.y).any():
        west, south, east, north = frame.bounds
        if _inside(heightmap, segments.y, segments.x).any():
            hint = "with x and y exchanged they would lie on it"
        elif _inside(heightmap, *_exchanged(segments, frame.crs)).any():
            hint = "with 'lat' and 'lon' exchanged they would lie on it"
        else:
            hint = f"are they in its coordinate system ({frame.crs or 'which the file does not name'})?"
        raise RunsError(
            f"the runs lie off the heightmap: they span x {_span(segments.x)}, y {_span(segments.y)}, the map x "
            f"{west:.2f}..{east:.2f}, y {south:.2f}..{north:.2f}; {hint}",
            bounds=list(frame.bounds),
        )


def check_units(driven: Sequence[tuple[Segments, Robot]]) -> None:
    """Refuse runs whose metres take a hundred times more or less than their robots need on level ground, in the median
    of all runs: single runs may be circles on the spot.
    """
    every, levels = [np.zeros(0)], [0.0]
    for segments, robot in driven:
        unit = robot.nominal_voltage_v if segments.charge else 1.0
        every.append(unit * segments.energy_j / segments.driven_m)
        levels.append(float(robot.price_per_m(np.array(robot.weight_n * robot.rolling_resistance))))
    took_all = np.concatenate(every)
    if not took_all.size:
        return  # that there is no segment is said where they are placed
    took = float(np.median(took_all))
    usual = float(np.repeat(levels, [len(part) for part in every]).mean())
    if usual > 0 and not usual / _FAR_OFF < took < usual * _FAR_OFF:
        raise RunsError(
            f"a metre took {took:,.1f} J, where this robot needs about {usual:,.1f} J on level ground: are `t` in s, "
            "`current` in A and `voltage` in V, and is the robot's file this robot's?",
            measured=took,
            expected=usual,
        )


def _exchanged(segments: Segments, crs: str | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x, y [m] with latitude and longitude exchanged; none of runs that were recorded without them."""
    lat, lon = (segments.extras.get(key, np.zeros(0)) for key in ("lat", "lon"))
    if crs is None or lat.size == 0 or lon.size == 0:
        return np.zeros(0), np.zeros(0)
    possible = np.abs(lon) <= 90.0
    return projected(lon[possible], lat[possible], crs)


def _inside(heightmap: Heightmap, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    west, south, east, north = heightmap.frame.bounds
    return np.asarray((x >= west) & (x <= east) & (y >= south) & (y <= north))


def _span(values: NDArray[np.float64]) -> str:
    return f"{values.min():.2f}..{values.max():.2f}"
