"""A cost map that is deleted while workers make it: whatever they are at, nothing of it is left."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from joulemap.model.errors import NotFoundError
from joulemap.planner.lattice import folder as lattice_folder
from joulemap.planner.lattice import tiles as tiling
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.service.jobs.costmaps import order_of
from joulemap.service.jobs.engine import Jobs
from joulemap.service.storage.store import Store
from joulemap.service.storage.vault import ObjectVault
from joulemap.service.work import tiles, vaulted
from tests.service.conftest import hill, settings_for
from tests.service.workers import asked, made_here

STEPS = [
    (LatticeFolder, "lay_out"),
    (LatticeFolder, "write"),
    (LatticeFolder, "finish"),
    (lattice_folder, "_describe"),
    (tiles, "_write"),
    (Path, "rename"),
    (Path, "replace"),
    (Store, "status"),
]


@contextmanager
def opened(folder: Path, objects: str | None = None) -> Iterator[Store]:
    store = Store(folder, f"sqlite:///{folder / 'test.db'}", objects=objects)
    store.open()
    try:
        yield store
    finally:
        store.close()


def before_and_after(
    monkeypatch: pytest.MonkeyPatch, seen: Callable[[], None], steps: Sequence[tuple[Any, str]] = STEPS
) -> None:
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

    for owner, name in steps:
        monkeypatch.setattr(owner, name, watched(getattr(owner, name)))


def at_each_moment(
    store: Store,
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[[str], object],
    *,
    steps: Sequence[tuple[Any, str]] = STEPS,
    vanished: tuple[type[Exception], ...] = (Exception,),
) -> Iterator[tuple[str, bool]]:
    """Make cost maps, and delete each a step later than the one before, until one is done: id, and whether deleted.

    vanished : what may be raised then; by default that of zarr, too.
    """
    monkeypatch.setattr(tiling, "TILE_CELLS", 32)
    heightmap = store.add_heightmap(hill(), name="hill", stats={}).id
    wanted, deleted, moment = "", True, -1

    def seen() -> None:
        nonlocal moment, deleted
        if moment == 0:
            store.delete_costmap(wanted)
            deleted = True
        moment -= 1

    before_and_after(monkeypatch, seen, steps)
    for nth in itertools.count():
        wanted, deleted, moment = asked(store, heightmap), False, -1
        moment = nth
        try:
            make(wanted)
        except vanished:
            if not deleted:
                raise
        moment = -1
        yield wanted, deleted
        if not deleted:
            assert nth > 20
            return


def test_nothing_is_left_whenever_it_is_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(tmp_path) as store:
        for wanted, deleted in at_each_moment(store, monkeypatch, lambda one: made_here(store, one, tmp_path)):
            left = [path.name for path in (tmp_path / "costmaps").iterdir()]
            assert left == ([] if deleted else [f"{wanted}.zarr"])


VAULT_STEPS = [
    (ObjectVault, name) for name in ("begin", "send", "write", "read", "remove", "names", "has", "parts")
] + [
    (vaulted, "_chunks"),
    (Store, "status"),
]


def made_there(store: Store, costmap_id: str, models_dir: Path) -> None:
    """Make a cost map as workers do that share nothing but an object store."""
    order: Any = order_of(store, costmap_id, models_dir)
    for number in vaulted.lay_out(order)[1]:
        vaulted.build(order, number)
    store.finish(costmap_id, vaulted.finish(order))
    store.tidy(costmap_id)


@pytest.mark.slow
def test_nothing_is_left_in_an_object_store_whenever_it_is_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("obstore")
    with opened(tmp_path, objects=f"file://{tmp_path}/objects") as store:
        how: Any = {"steps": VAULT_STEPS, "vanished": (OSError, NotFoundError, RuntimeError)}
        for wanted, deleted in at_each_moment(store, monkeypatch, lambda one: made_there(store, one, tmp_path), **how):
            left = [name for name in store.vault.names("") if "costmaps/" in name]  # type: ignore[union-attr]
            assert deleted != (f"records/costmaps/{wanted}.zarr.json" in left)
            assert not [name for name in left if deleted or ".tiles" in name]


def test_who_sends_on_after_a_cost_map_is_done_changes_nothing(tmp_path: Path) -> None:
    pytest.importorskip("obstore")
    with opened(tmp_path, objects=f"file://{tmp_path}/objects") as store:
        wanted = asked(store, store.add_heightmap(hill(), name="hill", stats={}).id)
        order: Any = order_of(store, wanted, tmp_path)
        made_there(store, wanted, tmp_path)
        before = {path: path.read_bytes() for path in (tmp_path / "objects").rglob("*") if path.is_file()}
        for late in (lambda: vaulted.build(order, 0), lambda: vaulted.finish(order)):
            with pytest.raises((OSError, RuntimeError), match=r"nobody waits for|is not there"):
                late()
        assert {path: path.read_bytes() for path in (tmp_path / "objects").rglob("*") if path.is_file()} == before


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


def test_what_a_worker_says_of_a_job_that_was_deleted_is_no_error(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with opened(tmp_path) as store:
        heightmap = store.add_heightmap(hill(), name="hill", stats={}).id
        kept, deleted = asked(store, heightmap), asked(store, heightmap)
        store.delete_costmap(deleted)
        jobs = Jobs(store, settings_for(tmp_path))
        for job_id in (deleted, kept):
            jobs._failed(job_id, FileNotFoundError("the folder vanished"), lost=False)
    assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == [f"job {kept} failed"]
