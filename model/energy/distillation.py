"""What a slow teacher says of ground that nobody drove, as examples for the compact network; how far two models differ.

Source of the idea: Hinton, Vinyals & Dean 2015, "Distilling the knowledge in a neural network".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from model.energy.examples import Examples, concatenate, cut_examples
from model.energy.predictor import Predictor
from model.errors import InputError
from model.robot import Robot
from model.terrain.heightmap import Heightmap

TAUGHT = -1
"""The run of examples that were never driven."""

_AT_ONCE = 512


def ask_teacher(
    teacher: Predictor,
    heightmap: Heightmap,
    robot: Robot,
    *,
    count: int,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> Examples:
    """`count` random places and headings with the energy that the teacher gives them, run `TAUGHT`; fewer where the
    map is unknown. Raises InputError where it knows none of them."""
    parts = []
    for start in range(0, count, _AT_ONCE):
        x, y, heading = random_places(heightmap, min(_AT_ONCE, count - start), rng)
        energy = robot.hotel_per_m + teacher.segment_traction(heightmap, robot, x, y, heading)
        parts.append(cut_examples(heightmap, robot, x, y, heading, energy, run=TAUGHT))
        if progress is not None:
            progress(min(start + _AT_ONCE, count) / count)
    examples = concatenate(parts)
    if not len(examples):
        raise InputError(f"the teacher knows none of {count} random places: is the map unknown nearly everywhere?")
    return examples


def difference(one: Predictor, other: Predictor, heightmap: Heightmap, robot: Robot, *, count: int, seed: int) -> float:
    """Mean absolute difference of two models' energies over the mean energy of the other, at random places and
    headings that both know. NaN where there is none."""
    places = random_places(heightmap, count, np.random.default_rng(seed))
    ours, theirs = (robot.price_per_m(model.segment_traction(heightmap, robot, *places)) for model in (one, other))
    known = np.isfinite(ours) & np.isfinite(theirs)
    if not known.any():
        return float("nan")
    return float(np.abs(ours - theirs)[known].mean() / theirs[known].mean())


def random_places(heightmap: Heightmap, count: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], ...]:
    """x, y [m] anywhere on the map and any heading [rad], (count,) each."""
    west, south, east, north = heightmap.frame.bounds
    return rng.uniform(west, east, count), rng.uniform(south, north, count), rng.uniform(0.0, 2.0 * np.pi, count)
