"""In which order jobs are made: fair between owners, by start-time fair queueing (Goyal, Vin and Cheng 1997)."""

from __future__ import annotations

from collections.abc import Mapping


def turns_of(wanted: Mapping[str, str | None], before: Mapping[str, int]) -> dict[str, int]:
    """Return the turn of each job, lower ones first: an owner's jobs one after another, beside those of others.

    `wanted`: owner by the id of a job, oldest first; `before`: the turns of the latest call. A job keeps its turn.
    """
    turns = {job_id: turn for job_id, turn in before.items() if job_id in wanted}
    for job_id, owner in wanted.items():
        if job_id not in turns:
            now = min(turns.values(), default=0)
            latest = max((turn for other, turn in turns.items() if wanted[other] == owner), default=now - 1)
            turns[job_id] = max(now, latest + 1)
    return turns
