"""The row of a finished cost map is read from the database once in two seconds, and nobody sees what is not theirs."""

from __future__ import annotations

import copy
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from joulemap.model.errors import ConflictError, NotFoundError
from joulemap.service.http import service
from joulemap.service.http.service import KNOWN_S, Service
from joulemap.service.storage.owners import Caller
from joulemap.service.storage.store import Store
from tests.service.workers import asked, rolling


class Maps(Service):
    def __init__(self, store: Store) -> None:
        self._known = {}
        self.store = store
        self.retention = cast(Any, SimpleNamespace(saw=lambda _id: None))
        self.maps = cast(Any, SimpleNamespace(forget=lambda _id: None))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path, f"sqlite:///{tmp_path / 'test.db'}")
    store.open()
    return store


@pytest.fixture
def finished(store: Store) -> str:
    costmap_id = asked(store, store.add_heightmap(rolling(12), name="rolling", stats={}).id)
    store.finish(costmap_id, {"provenance": {}})
    return costmap_id


def test_what_is_not_done_is_not_kept_in_mind(store: Store) -> None:
    costmap_id = asked(store, store.add_heightmap(rolling(12), name="rolling", stats={}).id)
    maps = Maps(store)
    with pytest.raises(ConflictError, match="queued"):
        maps.done_costmap(costmap_id)
    store.finish(costmap_id, {"provenance": {}})
    assert maps.done_costmap(costmap_id).status == "done"


def test_others_do_not_see_a_map_because_its_owner_asked(store: Store, finished: str) -> None:
    maps = Maps(store)
    assert maps.done_costmap(finished).id == finished
    other = copy.copy(maps)
    other.store = store.seen_by(Caller(name="other", sees_all=False))
    with pytest.raises(NotFoundError):
        other.done_costmap(finished)


def test_a_map_that_was_deleted_here_is_gone_at_once(store: Store, finished: str) -> None:
    maps = Maps(store)
    maps.done_costmap(finished)
    maps.delete_costmap(finished)
    with pytest.raises(NotFoundError):
        maps.done_costmap(finished)


def test_a_map_that_another_service_deleted_is_gone_soon(
    store: Store, finished: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps, now = Maps(store), 100.0
    monkeypatch.setattr(service, "time", SimpleNamespace(monotonic=lambda: now))
    maps.done_costmap(finished)
    store.delete_costmap(finished)
    now += 0.9 * KNOWN_S
    assert maps.done_costmap(finished).id == finished
    now += 0.2 * KNOWN_S
    with pytest.raises(NotFoundError):
        maps.done_costmap(finished)
