"""Distillation: a compact model out of a ResNet18 teacher's answers and the runs that the teacher learned from.

Source of the idea: Hinton, Vinyals & Dean 2015, "Distilling the knowledge in a neural network".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.architectures import find_architecture
from joulemap.model.energy.artifact import Artifact, load_artifact, predictor_of, read_artifact, save_artifact
from joulemap.model.energy.examples import Examples, concatenate, cut_examples, examples_of
from joulemap.model.energy.prediction import predict_segments
from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import InputError, ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_placed, check_runs
from joulemap.model.runs.files import read_segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.evaluation import segment_errors, segment_spread
from joulemap.model.training.optimisation import TrainingOptions, train_network
from joulemap.model.training.run_record import runs_record

TAUGHT = -1
"""The run number of examples that a teacher answered and nobody drove."""

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
    """Ask the teacher for the energy at random places and headings.

    Result: of the run `TAUGHT`; fewer than `count` where the map is unknown.
    """
    parts = []
    for start in range(0, count, _AT_ONCE):
        x, y, heading = random_places(heightmap, min(_AT_ONCE, count - start), rng)
        energy = robot.hotel_per_m + teacher.segment_traction(heightmap, robot, x, y, heading)
        parts.append(cut_examples(heightmap, robot, x, y, heading, energy, run=TAUGHT, architecture=STUDENT))
        if progress is not None:
            progress(min(start + _AT_ONCE, count) / count)
    examples = concatenate(parts)
    if not len(examples):
        raise InputError(f"the teacher knows none of {count} random places: is the map unknown nearly everywhere?")
    return examples


def difference(one: Predictor, other: Predictor, heightmap: Heightmap, robot: Robot, *, count: int, seed: int) -> float:
    """Compare the energies of two models at random places and headings that both know.

    Result: mean absolute difference over the mean energy of the other; NaN where no place is known to both.
    """
    places = random_places(heightmap, count, np.random.default_rng(seed))
    ours, theirs = (robot.price_per_m(model.segment_traction(heightmap, robot, *places)) for model in (one, other))
    known = np.isfinite(ours) & np.isfinite(theirs)
    if not known.any():
        return float("nan")
    return float(np.abs(ours - theirs)[known].mean() / theirs[known].mean())


def random_places(heightmap: Heightmap, count: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], ...]:
    """Choose places anywhere on a map.

    Returns `x`, `y` (count,): places [m]; `heading_rad` (count,): headings [rad].
    """
    west, south, east, north = heightmap.frame.bounds
    return rng.uniform(west, east, count), rng.uniform(south, north, count), rng.uniform(0.0, 2.0 * np.pi, count)


TEACHER, STUDENT = "resnet18", "compact"
"""Architectures of the two."""
DISTILLING = TrainingOptions(epochs=30, batch=128, learning_rate=1e-3, keep_last=True)
ANSWERS = 20_000
_JUDGED = 2_000  # places at which student and teacher are compared; the student has learned none of them
_ASKING = 0.5  # share of the time


@dataclass(frozen=True)
class DistilledModel:
    """The result of a distillation."""

    version: str  # Of the student
    teacher: str  # Folder of the teacher
    answers: int  # Number of the teacher's answers that the student learned from
    segments: int  # Number of measured segments that it learned from
    # Runs that neither network was fitted to. They decided when the teacher's training stopped.
    held_out_runs: list[str]
    difference: float  # Mean absolute difference from the teacher at random places, over the energy
    teacher_held_out: dict[str, Any]  # Errors on `held_out_runs`, as `evaluation.errors`
    student_held_out: dict[str, Any]


def distil_on_runs(
    heightmap: Heightmap,
    robot: Robot,
    files: Sequence[Path],
    *,
    teacher: Path,
    start_from: Path,
    out: Path,
    answers: int = ANSWERS,
    epochs: int | None = None,
    seed: int = 0,
    charge: bool = False,
    progress: Callable[[float], None] | None = None,
) -> DistilledModel:
    """Train a compact network on a ResNet18's answers and on measured segments, and write its model's folder.

    The runs that the teacher held out are held out of the student too.
    """
    report = progress or (lambda _: None)
    knows, learned = load_artifact(teacher), read_artifact(teacher)
    if learned.architecture != TEACHER:
        raise ModelError(f"the teacher {teacher} is no {TEACHER}: make one with `joulemap train --arch {TEACHER}`")
    parent = read_artifact(start_from)
    if parent.architecture != STUDENT:
        raise ModelError(f"{start_from} is no {STUDENT} model: a student cannot start from it")
    runs, segments = read_segments(files, robot, crs=heightmap.frame.crs, charge=charge)
    check_placed(runs)
    check_runs(segments, heightmap, robot)
    heightmap = heightmap.without_noise
    unseen = [str(name) for name in learned.training.get("held_out_runs", [])]
    held = [number for number, name in enumerate(segments.runs) if name in unseen]
    if not held:
        raise InputError(
            f"none of the {len(segments.runs)} runs is one that the teacher had not seen "
            f"({', '.join(unseen) or 'it held none out'}): give the runs that it was trained on",
            held_out_runs=unseen,
        )
    rng = np.random.default_rng(seed)
    copies = find_architecture(STUDENT).training.copies
    turns = np.concatenate([np.zeros((1, len(segments))), rng.uniform(0.0, 2.0 * np.pi, (copies - 1, len(segments)))])
    beside = knows.drive_energy_j(robot, segments)
    measured = examples_of(heightmap, robot, segments, turns, run=segments.run, architecture=STUDENT, beside_j=beside)
    taught = ask_teacher(knows, heightmap, robot, count=answers, rng=rng, progress=lambda done: report(_ASKING * done))
    examples = concatenate([*measured, taught])
    result = train_network(
        examples,
        architecture=STUDENT,
        seed=seed,
        start_from=parent.net,
        held_out_runs=held,
        options=replace(DISTILLING, epochs=epochs or DISTILLING.epochs),
        progress=lambda done: report(_ASKING + (1.0 - _ASKING) * done),
    )
    shown = replace(examples.domain(), turned_rad=learned.domain.turned_rad, driven=learned.domain.driven)
    student = Artifact(result.net, parent.domain.joined(shown), costs=learned.costs)
    answers_of = predictor_of(student, name=out.name)
    judged = segments.take(np.flatnonzero(np.isin(segments.run, held)))
    said = predict_segments(answers_of, heightmap, robot, judged)
    found = DistilledModel(
        "",
        str(teacher),
        len(taught),
        int((~np.isin(segments.run, held)).sum()),
        [segments.runs[k] for k in held],
        difference(answers_of, knows, heightmap, robot, count=_JUDGED, seed=seed + 1),
        segment_errors(predict_segments(knows, heightmap, robot, judged).energy_j, judged),
        segment_errors(said.energy_j, judged),
    )
    training = {
        "data": "measured runs and a teacher's answers",
        "data_hash": examples.data_hash,
        **runs_record(runs),
        "stopped_by_held_out": True,  # the teacher's training
        "seed": seed,
        "epochs": result.epochs,
        "teacher_version": knows.provenance()["version"],
        "started_from": str(start_from),
        "held_out": found.student_held_out,
        **{key: value for key, value in asdict(found).items() if key != "version"},
    }
    student = replace(student, spread=segment_spread(said, judged), training=training)
    return replace(found, version=save_artifact(out, student))
