"""A cost map that is deleted while workers make it: whatever they are at, nothing of it is left."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from joulemap.model.errors import NotFoundError
from joulemap.planner import lattice_io
from joulemap.planner import tiles as tiling
from joulemap.planner.lattice_io import LatticeFolder
from joulemap.service.jobs.costmaps import order_of
from joulemap.service.storage.store import Store
from joulemap.service.work import tiles
from tests.service.conftest import hill
from tests.service.workers import asked, made_here

STEPS = [
    (LatticeFolder, "lay_out"),
    (LatticeFolder, "write"),
    (LatticeFolder, "finish"),
    (lattice_io, "_describe"),
    (tiles, "_write"),
    (Path, "rename"),
    (Path, "replace"),
    (Store, "status"),
]


@contextmanager
def opened(folder: Path) -> Iterator[Store]:
    store = Store(folder, f"sqlite:///{folder / 'test.db'}")
    store.open()
    try:
        yield store
    finally:
        store.close()


def before_and_after(monkeypatch: pytest.MonkeyPatch, seen: Callable[[], None]) -> None:
    """Call `seen` before and after each step of making a cost map, but not within itself."""
    busy = False

    def watched(do: Any) -> Any:
        def _watched(*arguments: Any, **options: Any) -> Any:
            _see()
            try:
                return do(*arguments, **options)
            finally:
                _see()

        return _watched

    def _see() -> None:
        nonlocal busy
        if not busy:
            busy = True
            seen()
            busy = False

    for owner, name in STEPS:
        monkeypatch.setattr(owner, name, watched(getattr(owner, name)))


def test_nothing_is_left_whenever_it_is_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiling, "TILE_CELLS", 32)
    moments = itertools.count()
    with opened(tmp_path) as store:
        heightmap = store.add_heightmap(hill(), name="hill", stats={}).id
        wanted, deleted = "", True

        def seen() -> None:
            nonlocal moment, deleted
            if moment == 0:
                store.delete_costmap(wanted)
                deleted = True
            moment -= 1

        before_and_after(monkeypatch, seen)
        while deleted:
            wanted, deleted, moment = asked(store, heightmap), False, -1
            nth = moment = next(moments)
            try:
                made_here(store, wanted, tmp_path)
            except Exception:  # of zarr, too: what it writes vanishes
                if not deleted:
                    raise
            left = [path.name for path in (tmp_path / "costmaps").iterdir()]
            assert left == ([] if deleted else [f"{wanted}.zarr"]), f"at moment {nth}"
    assert nth > 20


def test_who_works_on_after_a_cost_map_is_done_changes_nothing(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        heightmap = store.add_heightmap(hill(), name="hill", stats={}).id
        wanted = asked(store, heightmap)
        order = order_of(store, wanted, tmp_path)
        made_here(store, wanted, tmp_path)
        place = store.lattice_path(wanted)
        before = {path: path.stat().st_mtime_ns for path in place.rglob("*")}
        for late in (tiles.lay_out, tiles.finish, lambda it: tiles.build(it, 0)):
            with pytest.raises(OSError, match=r"not exist|No such file|deleted"):
                late(order)
        with pytest.raises(NotFoundError, match="nobody waits"):
            order_of(store, wanted, tmp_path)
        assert {path: path.stat().st_mtime_ns for path in place.rglob("*")} == before
        assert list((tmp_path / "costmaps").iterdir()) == [place]
