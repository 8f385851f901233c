"""The steps of the jobs, in the service's database: any process that shares the database may take one and do it.

A cost map is made in steps: one that lays it out, one per tile, and a last one that finishes it when all others are
done. A calibration is a single step.

A worker takes a step for a short time (its *lease*) and renews the lease while it works. A worker that is killed renews
no more, and its step goes to the next worker that asks. A step that is done is never done again.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from sqlalchemy import and_, func, insert, or_, select, text, update
from sqlalchemy.orm import Session, aliased, sessionmaker

from joulemap.service.storage.tables import COSTMAP, FAILED, JOBS, QUEUED, RUNNING, StepRow, kind_of

LEASE_S = 15.0
"""A step whose worker has not renewed it for so long goes to another worker [s]."""


class Step(NamedTuple):
    """A step that a worker has taken.

    Attributes
    ----------
    job_id : str
        Id of the job.
    number : int
        LAY_OUT, a tile's number + 1, or that of the last step.
    last : bool
        Whether it is the last step.
    """

    job_id: str
    number: int
    last: bool


class Steps:
    """The steps of jobs in one database, as one worker sees them.

    Parameters
    ----------
    sessions : sessionmaker
        Of the database.
    worker : str
        Name of the worker, which no other worker has.
    kinds : iterable of str, optional
        Kinds of jobs that this worker does.
    """

    def __init__(self, sessions: sessionmaker[Session], worker: str, kinds: Iterable[str] = (COSTMAP,)) -> None:
        self._sessions = sessions
        self.worker = worker
        self._kinds = tuple(kinds)

    def add_missing(self) -> None:
        """Add the first step of every unfinished job that has no step."""
        with self._sessions.begin() as session:
            known = select(StepRow.job_id)
            for table in (JOBS[kind] for kind in self._kinds):
                unfinished = select(table).where(table.status.in_([QUEUED, RUNNING]), table.id.not_in(known))
                session.add_all([StepRow.first(job) for job in session.scalars(unfinished).all()])

    def take(self) -> Step | None:
        """Take the next free step of the oldest job.

        Returns
        -------
        Step or None
            None where there is nothing to do.
        """
        other = aliased(StepRow)
        waits = select(other.number).where(
            other.job_id == StepRow.job_id, other.number < StepRow.number, other.done.is_(False)
        )
        while True:
            with self._at() as (session, now):
                free = and_(StepRow.done.is_(False), StepRow.lease_until < now)
                found = session.execute(
                    select(StepRow.job_id, StepRow.number, StepRow.last)
                    .where(free, StepRow.kind.in_(self._kinds), or_(StepRow.last.is_(False), ~waits.exists()))
                    .order_by(StepRow.created_at, StepRow.job_id, StepRow.number)
                    .limit(1)
                ).first()
                if found is None:
                    return None
                step = Step(*found)
                mine = update(StepRow).where(_is(step), free).values(worker=self.worker, lease_until=now + LEASE_S)
                if session.execute(mine).rowcount:  # type: ignore[attr-defined]
                    table = JOBS[kind_of(step.job_id)]
                    begun = update(table).where(table.id == step.job_id, table.status == QUEUED)
                    session.execute(begun.values(status=RUNNING))
                    return step

    def renew(self, step: Step) -> bool:
        """Keep a step for another lease.

        Parameters
        ----------
        step : Step
            The step, taken by this worker.

        Returns
        -------
        bool
            False where another worker has it by now, or where its job was deleted.
        """
        with self._at() as (session, now):
            mine = update(StepRow).where(_is(step), StepRow.worker == self.worker, StepRow.done.is_(False))
            return bool(session.execute(mine.values(lease_until=now + LEASE_S)).rowcount)  # type: ignore[attr-defined]

    def report(self, step: Step, progress: float) -> bool:
        """Report the progress of a job that has a single step.

        Parameters
        ----------
        step : Step
            The step, taken by this worker.
        progress : float
            Share that is done, 0..1.

        Returns
        -------
        bool
            False where another worker has it by now, or where its job was deleted.
        """
        if not self.renew(step):
            return False
        table = JOBS[kind_of(step.job_id)]
        with self._sessions.begin() as session:
            said = update(table).where(table.id == step.job_id, table.status == RUNNING).values(progress=progress)
            return bool(session.execute(said).rowcount)  # type: ignore[attr-defined]

    def complete(self, step: Step, result: Any, *, tiles: int = 0) -> bool:
        """Mark a step as done.

        Parameters
        ----------
        step : Step
            The step, taken by this worker.
        result : object
            What it found, JSON-able.
        tiles : int, optional
            Add a step for each of so many tiles, and the last step.

        Returns
        -------
        bool
            False where the job was deleted or has failed meanwhile.
        """
        with self._sessions.begin() as session:
            job = session.get(JOBS[kind_of(step.job_id)], step.job_id, with_for_update=True)
            if job is None or job.status == FAILED:
                return False
            mine = update(StepRow).where(_is(step), StepRow.done.is_(False))
            if not session.execute(mine.values(done=True, result=result)).rowcount:  # type: ignore[attr-defined]
                return True  # done by another worker after our lease ended
            if tiles:
                shared = {"job_id": step.job_id, "kind": kind_of(step.job_id), "created_at": job.created_at}
                rows = [{**shared, "number": n, "last": n == tiles + 1} for n in range(1, tiles + 2)]
                session.execute(insert(StepRow), rows)
            every = select(func.count()).where(StepRow.job_id == step.job_id)
            done = session.scalar(every.where(StepRow.done)) or 0
            if not step.last:  # laying out is no part of the progress
                job.progress = (done - 1) / max((session.scalar(every) or 0) - 1, 1)
            return True

    def release(self, steps_of: str | None = None) -> None:
        """Give back every step of a worker at once.

        Parameters
        ----------
        steps_of : str, optional
            Beginning of the names of the workers; without it this worker.
        """
        prefix = StepRow.worker == self.worker if steps_of is None else StepRow.worker.startswith(steps_of)
        with self._sessions.begin() as session:
            session.execute(update(StepRow).where(prefix, StepRow.done.is_(False)).values(lease_until=0.0))

    def results(self, job_id: str) -> list[Any]:
        """Return what the finished steps of a job found.

        Parameters
        ----------
        job_id : str
            Id of the job.

        Returns
        -------
        list
            In the order of the steps.
        """
        with self._sessions() as session:
            query = select(StepRow.result).where(StepRow.job_id == job_id, StepRow.done)
            return list(session.scalars(query.order_by(StepRow.number)))

    @contextmanager
    def _at(self) -> Iterator[tuple[Session, float]]:
        """A transaction and the time that all workers share: PostgreSQL's clock, or this machine's."""
        with self._sessions.begin() as session:
            if session.get_bind().dialect.name == "postgresql":
                yield session, float(session.scalar(text("select extract(epoch from clock_timestamp())")) or 0.0)
            else:
                yield session, time.time()


def _is(step: Step) -> Any:
    return and_(StepRow.job_id == step.job_id, StepRow.number == step.number)
