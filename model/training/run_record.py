"""Which runs a model has seen: a hash of every run in its training facts, and warnings where one is met again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from joulemap.model.runs.run import Run

_MOST_NAMES = 5


def run_hash(run: Run) -> str:
    """Identify a run by its samples, whatever its file is called and whatever map it is read for.

    Result: first 16 hex digits of the SHA-256 of its times, currents and voltages.
    """
    digest = hashlib.sha256()
    for values in (run.t, run.current_a, run.voltage_v):
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return digest.hexdigest()[:16]


def runs_record(runs: Sequence[Run]) -> dict[str, Any]:
    """Return what a model's training facts say of its runs.

    Result: `runs`, their names, and `run_hashes` by name; JSON-able.
    """
    return {"runs": [run.name for run in runs], "run_hashes": {run.name: run_hash(run) for run in runs}}


def seen_runs(provenance: Mapping[str, Any], runs: Sequence[Run]) -> tuple[list[str], list[str]]:
    """Compare runs with those that a model was trained on.

    Returns `names`: those of these runs that were part of the training; `warnings`: one sentence for the runs that the
    network learned from, one for those that stopped its training, empty where there are none.
    """
    training = _training_facts(provenance)
    hashes = {str(value): str(name) for name, value in dict(training.get("run_hashes") or {}).items()}
    names = {str(name) for name in training.get("runs") or []}
    by_name = not hashes and bool(names)
    learned: list[str] = []
    stopped: list[str] = []
    held_out = {str(name) for name in training.get("held_out_runs") or []}
    for run in runs:
        known = hashes.get(run_hash(run)) if hashes else (run.name if run.name in names else None)
        if known is not None:
            only_stopped = training.get("stopped_by_held_out") and known in held_out and held_out != names
            (stopped if only_stopped else learned).append(run.name)
    warnings = []
    how = " (by their names: this model keeps no record of its runs' data)" if by_name else ""
    if learned:
        warnings.append(
            f"the model was trained on {len(learned)} of these {len(runs)} runs{how}: {_listed(learned)}. The errors "
            "on them are not held-out errors: expect larger ones on new runs"
        )
    if stopped:
        warnings.append(
            f"{len(stopped)} of these {len(runs)} runs decided when the model's training stopped{how}: "
            f"{_listed(stopped)}. The errors on them are a little too small"
        )
    return [*learned, *stopped], warnings


def _training_facts(provenance: Mapping[str, Any]) -> Mapping[str, Any]:
    while "base" in provenance:
        provenance = provenance["base"]
    facts = dict(provenance.get("config") or {}).get("training")
    return facts if isinstance(facts, Mapping) else {}


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
