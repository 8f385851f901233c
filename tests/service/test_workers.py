"""Jobs done by processes that are killed at random moments, and by several at once: every lattice is the same one."""

from __future__ import annotations

import random
import signal
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import select

from joulemap.service.jobs.steps import Steps
from joulemap.service.jobs.worker import SERVICE
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import StepRow
from tests.service.test_restart import free_port
from tests.service.workers import asked, fingerprint, postgres, postgres_programs, rolling, until, worker


def undisturbed(store: Store, folder: Path, url: str, heightmap_id: str) -> str:
    """The fingerprint of a lattice whose one worker was left alone."""
    costmap_id = asked(store, heightmap_id)
    with worker(folder, url, name="alone"):
        until(lambda: store.status(costmap_id) == "done")
    return fingerprint(store.lattice_path(costmap_id))


def is_over(store: Store, costmap_id: str) -> bool:
    return store.status(costmap_id) == "done"


def killed_again_and_again(folder: Path, *, times: int, seed: int) -> None:
    """One job after another, its worker killed at a random moment, until `times` kills have come in the middle."""
    url = f"sqlite:///{folder / 'joulemap.db'}"
    store = Store(folder, url)
    store.open()
    random_time = random.Random(seed)
    heightmap_id = store.add_heightmap(rolling(), name="rolling", stats={}).id
    expected = undisturbed(store, folder, url, heightmap_id)
    kills = 0
    while kills < times:
        costmap_id = asked(store, heightmap_id)
        done = partial(is_over, store, costmap_id)
        while not done():
            tiles = progress = store.costmap(costmap_id).progress
            with worker(folder, url, name=SERVICE, pause_s=0.02) as process:
                while progress == tiles and not done():
                    time.sleep(0.01)
                    progress = store.costmap(costmap_id).progress
                if kills < times:
                    time.sleep(random_time.uniform(0.0, 0.5))
                    process.send_signal(signal.SIGKILL)
                    process.wait()
                    kills += not done()
                else:
                    until(done)
            Steps(store.sessions, SERVICE).release(SERVICE)  # what the start of a service does
        assert fingerprint(store.lattice_path(costmap_id)) == expected
        assert not list(folder.rglob("*.partial"))
    store.close()


def test_killed_jobs_end_with_the_same_lattice(tmp_path: Path) -> None:
    killed_again_and_again(tmp_path, times=2, seed=1)


@pytest.mark.slow
def test_twenty_kills(tmp_path: Path) -> None:
    killed_again_and_again(tmp_path, times=20, seed=2)


@pytest.mark.slow
@pytest.mark.skipif(postgres_programs() is None, reason="PostgreSQL is not installed (Debian: postgresql)")
def test_two_workers_share_a_job_and_one_goes_on_when_the_other_is_killed(tmp_path: Path) -> None:
    with postgres(free_port()) as url:
        store = Store(tmp_path, url)
        store.open()
        heightmap_id = store.add_heightmap(rolling(), name="rolling", stats={}).id
        expected = undisturbed(store, tmp_path, url, heightmap_id)
        costmap_id = asked(store, heightmap_id)
        with ExitStack() as stack:
            shared = tmp_path.as_uri()
            two = [stack.enter_context(worker(shared, url, name=name, pause_s=0.3)) for name in ("one:", "two:")]

            def both_have_worked() -> bool:
                with store.sessions() as session:
                    names = session.scalars(select(StepRow.worker).where(StepRow.done)).all()
                return {name[:4] for name in names} == {"one:", "two:"}

            until(both_have_worked)
            two[0].send_signal(signal.SIGKILL)
            until(lambda: store.status(costmap_id) == "done")
        assert fingerprint(store.lattice_path(costmap_id)) == expected
        store.close()
