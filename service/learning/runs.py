"""Measured runs as what models learn from and are judged by: segments in joules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from model.errors import RunsError
from model.loop.run_names import distinct_names
from model.loop.runs import Run, read_run
from model.loop.segments import CARRIED, Segments, concatenate, cut_segments, driven_only
from model.robot import Robot


def read_segments(
    files: Sequence[Path], robot: Robot, *, crs: str | None, charge: bool = False
) -> tuple[list[Run], Segments]:
    """Every run, and their 1 m segments in joules.

    Of a run without voltage, and of every run if `charge`, the energy is its charge times the robot's nominal voltage.
    Raises RunsError.
    """
    if not files:
        raise RunsError("there is no run to read: no file has such a name")
    runs = [read_run(file, name=name, crs=crs) for file, name in zip(files, distinct_names(files), strict=True)]
    parts = []
    for run in runs:
        counted = charge or run.voltage_v is None
        cut = cut_segments(run, charge=counted, max_speed_mps=CARRIED * robot.speed_mps)
        parts.append(replace(cut, energy_j=cut.energy_j * robot.nominal_voltage_v, charge=False) if counted else cut)
    return runs, driven_only(concatenate(parts))
