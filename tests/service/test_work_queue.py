"""Work on threads for requests: in turn, bounded, and ended when nobody waits for it any more."""

from __future__ import annotations

import asyncio
import threading
import time

import numpy as np
import pytest

from joulemap.model.errors import BusyError, NoRouteError
from joulemap.planner.grid.fields import field_towards
from joulemap.planner.grid.stopping import Stopped, check_stop, new_flag, stop_flag, stoppable
from joulemap.planner.pricing.moves import move_table
from joulemap.service.http.long_questions import events, while_connected
from joulemap.service.http.work_queue import WorkQueue
from joulemap.service.jobs.engine import turns_of
from tests.reference.lattices import random_lattice

GENEROUS_S = 30.0


def a_queue(**options: object) -> WorkQueue:
    return WorkQueue("plans", **{"threads": 1, "per_group": 8, "overall": 16, **options})  # type: ignore[arg-type]


async def _until(condition) -> None:  # type: ignore[no-untyped-def]
    async with asyncio.timeout(GENEROUS_S):
        while not condition():
            await asyncio.sleep(0.005)


def _stopped() -> None:
    """Work until the flag is set, as a search does."""
    while True:
        check_stop()
        time.sleep(0.002)


def test_the_result_and_the_error_of_some_work_come_back():
    async def ask():
        queue = a_queue()
        assert await queue.do("a", lambda: 42) == 42
        with pytest.raises(NoRouteError, match="nowhere"):
            await queue.do("a", lambda: (_ for _ in ()).throw(NoRouteError("nowhere")))
        assert (queue.waiting, queue.running) == (0, 0)

    asyncio.run(ask())


def test_cost_maps_take_turns():
    """One client with many questions to its map does not make another one wait for all of them."""

    async def ask():
        queue, order, begun, go = a_queue(), [], threading.Event(), threading.Event()

        def first():
            begun.set()
            go.wait(GENEROUS_S)

        tasks = [asyncio.create_task(queue.do("a", first))]
        await _until(begun.is_set)
        for group in ("a", "a", "a", "b", "c", "b"):
            tasks.append(asyncio.create_task(queue.do(group, lambda group=group: order.append(group))))
        await _until(lambda: queue.waiting == 6)
        go.set()
        await asyncio.gather(*tasks)
        assert order == ["a", "b", "c", "a", "b", "a"]

    asyncio.run(ask())


@pytest.mark.parametrize(("groups", "words"), [(["a"] * 3, "this cost map"), (["a", "b", "c", "d"], "of all")])
def test_what_is_too_much_is_refused_with_a_time_to_come_back(groups, words):
    async def ask():
        queue, go = a_queue(per_group=2, overall=3), threading.Event()
        tasks = [asyncio.create_task(queue.do("x", lambda: go.wait(GENEROUS_S)))]
        await _until(lambda: queue.running == 1)
        tasks += [asyncio.create_task(queue.do(group, lambda: 1)) for group in groups[:-1]]
        await _until(lambda: queue.waiting == len(groups) - 1)
        with pytest.raises(BusyError, match=words) as refused:
            await queue.do(groups[-1], lambda: 1)
        assert refused.value.context["retry_after_s"] >= 1
        assert queue.refused == 1
        go.set()
        await asyncio.gather(*tasks)

    asyncio.run(ask())


def test_work_that_nobody_waits_for_ends_and_what_waits_is_never_begun():
    async def ask():
        queue, begun = a_queue(), []
        running = asyncio.create_task(queue.do("a", _stopped))
        await _until(lambda: queue.running == 1)
        waiting = asyncio.create_task(queue.do("a", lambda: begun.append(1)))
        await _until(lambda: queue.waiting == 1)
        waiting.cancel()
        await asyncio.wait([waiting])
        assert queue.waiting == 0
        running.cancel()
        await asyncio.wait([running])
        await _until(lambda: queue.running == 0)
        assert (begun, queue.given_up) == ([], 2)
        assert await queue.do("a", lambda: 7) == 7  # the thread is free again

    asyncio.run(ask())


def test_only_one_question_loads_a_cost_map_and_another_map_does_not_wait():
    async def ask():
        loaded: set[str] = set()
        queue = a_queue(threads=3, one_at_a_time=lambda group: group not in loaded)
        at_once, most, go = [], [0], threading.Event()

        def load():
            at_once.append(1)
            most[0] = max(most[0], len(at_once))
            go.wait(GENEROUS_S)
            at_once.pop()

        tasks = [asyncio.create_task(queue.do("big", load)) for _ in range(3)]
        await _until(lambda: len(at_once) == 1)
        assert await queue.do("other", lambda: "other") == "other"
        assert (queue.running, queue.waiting) == (1, 2)
        loaded.add("big")
        go.set()
        await asyncio.gather(*tasks)
        assert most[0] <= 2  # the last two may run side by side

    asyncio.run(ask())


def test_a_service_that_stops_ends_all_work():
    async def ask():
        queue = a_queue()
        tasks = [asyncio.create_task(queue.do("a", _stopped)) for _ in range(3)]
        await _until(lambda: queue.running == 1 and queue.waiting == 2)
        queue.stop()
        for found in await asyncio.gather(*tasks, return_exceptions=True):
            assert isinstance(found, BusyError)
        with pytest.raises(BusyError, match="stops"):
            await queue.do("a", lambda: 1)

    asyncio.run(ask())


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_a_search_ends_when_its_flag_is_set(turn):
    """A flag that is set before the search begins, and one that is set while it runs."""
    lattice = random_lattice(np.random.default_rng(3), rows=60, cols=60, turn_j_per_rad=turn)
    table, goal = move_table(lattice), np.array([[30.0, 30.0]])
    flag = new_flag()
    with stoppable(flag):
        assert np.isfinite(field_towards(lattice, table, goal).energy_j).any()
        flag[0] = 1
        with pytest.raises(Stopped):
            field_towards(lattice, table, goal)
    assert stop_flag()[0] == 0
    field_towards(lattice, table, goal)

    over, ended = new_flag(), threading.Event()

    def search() -> None:
        with stoppable(over):
            try:
                while True:
                    field_towards(lattice, table, goal)
            except Stopped:
                ended.set()

    thread = threading.Thread(target=search, daemon=True)
    thread.start()
    time.sleep(0.05)
    assert not ended.is_set()
    over[0] = 1
    assert ended.wait(GENEROUS_S)


def test_a_closed_connection_ends_the_work():
    class Closed:
        async def receive(self):
            await asyncio.sleep(0.02)
            return {"type": "http.disconnect"}

    async def ask():
        queue = a_queue()
        answer = await while_connected(Closed(), queue.do("a", _stopped))  # type: ignore[arg-type]
        assert answer.status_code == 499
        await _until(lambda: queue.running == 0)
        stream = events(lambda report: queue.do("a", _stopped))
        first = await anext(stream)
        assert first.event == "progress"
        await _until(lambda: queue.running == 1)
        await stream.aclose()
        await _until(lambda: queue.running == 0)
        assert queue.given_up == 2

    asyncio.run(ask())


def test_owners_take_turns_and_one_without_work_waits_for_nobody():
    """A key with many questions takes the threads; the first one of another key begins at once, beside them."""

    async def ask():
        queue, order, go = a_queue(threads=1, overall=99), [], threading.Event()
        many = [asyncio.create_task(queue.do(group, lambda: go.wait(GENEROUS_S), "hog")) for group in "aaabbbccc"]
        await _until(lambda: queue.running == 1 and queue.waiting == 8)
        assert await asyncio.wait_for(queue.do("x", lambda: "at once", "other"), GENEROUS_S) == "at once"
        for owner in ("hog", "hog", "other", "third", "other"):
            many.append(asyncio.create_task(queue.do("y", lambda owner=owner: order.append(owner), owner)))
        await _until(lambda: order == ["other", "third", "other"])  # and none of the owner that has the thread
        go.set()
        await asyncio.gather(*many)
        assert order[3:] == ["hog", "hog"]

    asyncio.run(ask())


def test_a_full_queue_has_room_for_an_owner_with_less_than_its_share():
    async def ask():
        queue, go = a_queue(per_group=9, overall=4), threading.Event()
        running = [asyncio.create_task(queue.do("x", lambda: go.wait(GENEROUS_S), owner)) for owner in ("hog", "b")]
        await _until(lambda: queue.running == 2)
        hog = [asyncio.create_task(queue.do("x", lambda: "hog", "hog")) for _ in range(4)]
        await _until(lambda: queue.waiting == 4)
        with pytest.raises(BusyError, match="of all"):
            await queue.do("x", lambda: 1, "hog")
        others = [asyncio.create_task(queue.do("y", lambda: "other", owner)) for owner in ("b", "b", "c")]
        await asyncio.wait(hog[1:])  # its newest make room
        assert not hog[0].done()
        assert all(isinstance(task.exception(), BusyError) for task in hog[1:])
        with pytest.raises(BusyError, match="of all"):
            await queue.do("y", lambda: 1, "b")
        go.set()
        assert await asyncio.gather(*running, hog[0], *others) == [True, True, "hog", *["other"] * 3]
        assert queue.refused == 5

    asyncio.run(ask())


def test_jobs_of_an_owner_follow_one_another_beside_those_of_others():
    turns = turns_of({f"a{k}": "a" for k in range(4)}, {})
    assert list(turns.values()) == [0, 1, 2, 3]
    wanted = {"a2": "a", "a3": "a", "b0": "b", "b1": "b", "a4": "a", "c0": None}
    turns = turns_of(wanted, turns)
    assert sorted(wanted, key=lambda job_id: turns[job_id]) == ["a2", "b0", "c0", "a3", "b1", "a4"]
    assert turns_of({"a4": "a", "b2": "b"}, turns) == {"a4": 4, "b2": 4}  # who comes later overtakes nobody for ever
