"""Verifies a data directory: database, rows and files belong together, can be read, and nothing else lies there."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy import delete, select, text, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from joulemap.model.errors import DamagedError, JoulemapError
from joulemap.model.terrain.readers import read_sent
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.loading import open_group
from joulemap.service.storage.files import MODEL_SUMS, bytes_of, changed, remove, sums_of
from joulemap.service.storage.stats import heightmap_stats
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import (
    CALIBRATION,
    DONE,
    QUEUED,
    CalibrationRow,
    CostmapRow,
    HeightmapRow,
    RunsRow,
    now,
)
from joulemap.service.storage.vault import LOST, ObjectVault

REMOVED = "removed"
"""Folder of the data directory into which a repair moves what belongs to nothing; nothing reads it."""

LEFT_BY_KILLED = "left by a process that was killed"
_TABLES: tuple[Any, ...] = (HeightmapRow, RunsRow, CostmapRow, CalibrationRow)
_SENDING = dt.timedelta(days=1)  # longer than sending anything takes


@dataclass(frozen=True)
class Finding:
    """Something that is wrong in a data directory.

    Attributes
    ----------
    kind : str
        unreadable (a row), missing, damaged, orphan (files without a row), partial (left by a process that was
        killed), or database.
    what : str
        Id of the row, or the file within the data directory.
    words : str
        What is wrong with it.
    remedy : str or None
        What a repair does; None where only a person can help.
    repair : callable or None
        Does it.
    """

    kind: str
    what: str
    words: str
    remedy: str | None = None
    repair: Callable[[], object] | None = field(default=None, compare=False, repr=False)


class Check:
    """Looks through a data directory; nothing is changed but by the repairs of its findings."""

    def __init__(
        self,
        store: Store,
        data_dir: Path,
        models_dir: Path,
        *,
        answers: Mapping[Any, Callable[[Any], Any]],
    ) -> None:
        self._store, self._dir, self._models, self._answers = store, data_dir, models_dir, answers

    def findings(self, progress: Callable[[float], object] = lambda _: None) -> Iterator[Finding]:
        """Look at everything. A repair may be done before the next is asked for."""
        yield from self._database()
        ids = {table: self._ids(table) for table in _TABLES}
        done, count = 0, max(1, sum(map(len, ids.values())))
        for table in _TABLES:
            for row_id in ids[table]:
                yield from self._row(table, row_id)
                done += 1
                progress(done / count)
        yield from self._strangers({row_id for found in ids.values() for row_id in found})

    def _database(self) -> Iterator[Finding]:
        with self._store.sessions() as session:
            if session.get_bind().dialect.name != "sqlite":
                return
            for (found,) in session.execute(text("pragma integrity_check")):
                if found != "ok":
                    yield Finding("database", "joulemap.db", str(found))

    def _ids(self, table: Any) -> list[str]:
        with self._store.sessions() as session:
            return list(session.scalars(select(table.id).order_by(table.id)))

    def _row(self, table: Any, row_id: str) -> Iterator[Finding]:
        why = self._unreadable(table, row_id)
        if why is not None:
            yield self._poisoned(table, row_id, why)
            return
        with self._store.sessions() as session:
            row = session.get(table, row_id)
        if row is not None and (row.gone is None if table in (HeightmapRow, RunsRow) else row.status == DONE):
            yield from self._files(table, row)

    def _unreadable(self, table: Any, row_id: str, instead: Mapping[str, Any] | None = None) -> str | None:
        """Why a row cannot be answered; None where it can, or was deleted meanwhile. instead : of what is stored."""
        others = instead or {}
        columns = [column for column in table.__table__.columns if column.name not in others]
        try:
            with self._store.sessions() as session:
                found = session.execute(select(*columns).where(table.id == row_id)).mappings().one_or_none()
            return None if found is None else self._unanswerable(table, table(**found, **others))
        except (ValueError, TypeError, SQLAlchemyError) as error:  # text that is no JSON, no time, no number
            return _short(error)

    def _unanswerable(self, table: Any, row: Any) -> str | None:
        try:
            json.dumps(self._answers[table](row).model_dump(mode="json"), allow_nan=False)
        except (ValueError, TypeError, LookupError, AttributeError, JoulemapError) as error:
            return _short(error)
        return None

    def _poisoned(self, table: Any, row_id: str, why: str) -> Finding:
        if table is HeightmapRow:
            try:
                stats = _read_stats(self._store.path(table, row_id), f"{row_id}.tif")
            except (JoulemapError, OSError):
                return Finding("unreadable", row_id, f"its row cannot be read ({why}), and its file neither")

            def _again() -> None:
                self._change(table, row_id, stats=stats, created_at=now(), bytes=None, used_at=None)

            return Finding("unreadable", row_id, f"its row cannot be read: {why}", "read its file again", _again)
        if table in (CostmapRow, CalibrationRow) and self._unreadable(table, row_id, _ASKED_AGAIN) is None:
            return Finding(
                "unreadable",
                row_id,
                f"what came out cannot be read: {why}",
                "make it again",
                lambda: self._ask_again(table, row_id),
            )
        return Finding(
            "unreadable",
            row_id,
            f"its row cannot be read: {why}",
            f"remove the row; its files go to {REMOVED}/",
            lambda: self._remove(table, row_id),
        )

    def _files(self, table: Any, row: Any) -> Iterator[Finding]:
        place = self._store.path(table, row.id)
        wrong, remedy = None, None
        repair: Callable[[], object] | None = None
        try:
            self._store.here(place)
            size = self._verify(table, row, place)
            try:
                unlike = [str(path.relative_to(self._dir)) for path in self._store.unlike(table, row.id, place)]
            except DamagedError as error:
                yield self._without_sums(table, row.id, place, error)
                return
        except (JoulemapError, OSError, ValueError) as error:
            if getattr(error, "errno", None) == LOST:  # the object store is away, which says nothing of what it keeps
                raise
            wrong = f"{place.relative_to(self._dir)}: {_short(error)}"
        else:
            if self._store.vault.size(str(place.relative_to(self._dir)), place) == 0:
                wrong = f"{place.relative_to(self._dir)} is not in the object store"
            elif row.bytes is not None and size < row.bytes:
                wrong = f"{place.relative_to(self._dir)} has {size} bytes, {row.bytes} were kept"
            elif unlike:
                more = f" and {len(unlike) - 3} more" if len(unlike) > 3 else ""
                wrong = f"{', '.join(unlike[:3])}{more}: the content is not what was kept"
        if wrong is not None:
            in_store = isinstance(self._store.vault, ObjectVault) and place.exists()
            if in_store and any(self._store.unlike(table, row.id, place)):
                remedy, repair = "delete the copy; the object store has it", partial(remove, place)
            elif table in (CostmapRow, CalibrationRow):
                remedy, repair = "make it again", lambda: self._ask_again(table, row.id)
            else:
                remedy = f"move what is there to {REMOVED}/, and answer that it is to be sent again"
                repair = partial(self._quarantine, table, row.id, place, wrong)
            yield Finding("damaged" if place.exists() else "missing", row.id, wrong, remedy, repair)

    def _without_sums(self, table: Any, row_id: str, place: Path, error: DamagedError) -> Finding:
        """Files that can be read, of which the database has lost the checksums."""

        def _note() -> None:
            self._change(table, row_id, sums=sums_of(place))

        return Finding("unreadable", row_id, f"its checksums: {_short(error)}", "take them of its files again", _note)

    def _verify(self, table: Any, row: Any, place: Path) -> int:
        """Read the files of a row. Returns their size; raises what reading them raises."""
        if table is HeightmapRow:
            stats = _read_stats(place, row.name)
            if stats["hash"] != row.stats["hash"]:
                raise ValueError("its heights are not those that were sent")
        elif table is RunsRow:
            there = {path.name for path in place.iterdir()}
            lost = sorted({run["name"] for run in row.stats} - there)
            if lost:
                raise FileNotFoundError(f"there is no {lost[0]}")
        elif table is CostmapRow:
            folder = self._store.lattice_folder(row.id)
            CheckedStore.of(open_group(folder)).checksums.verify()
        else:
            json.loads((place / "report.json").read_text(encoding="utf-8"))
            model = self._models / row.id
            self._store.model_here(row.id, self._models)
            if not model.is_dir() or not any(model.iterdir()):
                raise FileNotFoundError(f"its model is not in {self._models}")
            sums = place / MODEL_SUMS  # not there in what an older version kept
            kept = json.loads(sums.read_text(encoding="utf-8")) if sums.exists() else {}
            if unlike := [path.name for path in changed(model, kept)]:
                raise ValueError(f"{', '.join(unlike)} of its model: the content is not what was kept")
        return bytes_of(place)

    def _strangers(self, known: set[str]) -> Iterator[Finding]:
        """Files that belong to no row, and what killed processes left."""
        for path in self._store.leftovers():
            what = str(path.relative_to(self._dir))
            yield Finding("partial", what, LEFT_BY_KILLED, "delete it", partial(remove, path))
        for folder in (table.__tablename__ for table in _TABLES):
            for path in sorted((self._dir / folder).iterdir()):
                if path.name.partition(".")[0] not in known and not path.name.endswith((".partial", ".tiles")):
                    yield self._orphan(path, f"{folder}/{path.name}")
        if self._models.is_dir():
            for path in sorted(self._models.glob(f"{CALIBRATION}-*")):
                if path.name not in known:
                    yield self._orphan(path, f"models/{path.name}")
        yield from self._strange_objects(known)

    def _strange_objects(self, known: set[str]) -> Iterator[Finding]:
        """Objects that belong to no row; other services may be sending those of the last day."""
        vault = self._store.vault
        if not isinstance(vault, ObjectVault):
            return
        found = set()
        for name in vault.names("", before=dt.datetime.now(dt.UTC) - _SENDING):
            kind, _, rest = name.removeprefix("records/").partition("/")
            owner = rest.split("/")[0].removesuffix(".json")
            if owner.partition(".")[0] not in known:
                found.add(f"{kind}/{owner}")
        for key in sorted(found):
            words = "it belongs to no row"
            yield Finding("orphan", f"object {key}", words, "delete it", partial(vault.remove, key))

    def _orphan(self, path: Path, what: str) -> Finding:
        return Finding(
            "orphan", what, "it belongs to no row", f"move it to {REMOVED}/", lambda: self._put_away(path, what)
        )

    # repairs

    def _change(self, table: Any, row_id: str, **values: Any) -> None:
        with self._store.sessions.begin() as session:
            session.execute(update(table).where(table.id == row_id).values(**values))

    def _ask_again(self, table: Any, row_id: str) -> None:
        """Let a job wait as when it was asked for; the next service makes it."""
        self._store.discard(row_id, self._models)
        self._change(table, row_id, **_ASKED_AGAIN)

    def _quarantine(self, table: Any, row_id: str, place: Path, wrong: str) -> None:
        """Put away what was sent and is damaged; its row stays for what was made from it, and says what was wrong."""
        self._change(table, row_id, gone=wrong, bytes=0)
        with self._store.sessions() as session:
            self._record(session, table, row_id)
        if place.exists():
            self._put_away(place, str(place.relative_to(self._dir)))

    def _record(self, session: Session, table: Any, row_id: str) -> None:
        """Write a row beside what is put away."""
        query = text(f"select * from {table.__tablename__} where id = :id")
        raw = dict(session.execute(query, {"id": row_id}).mappings().one())
        folder = self._dir / REMOVED
        folder.mkdir(exist_ok=True)
        (folder / f"{row_id}.json").write_text(json.dumps(raw, default=str), encoding="utf-8")

    def _remove(self, table: Any, row_id: str) -> None:
        """Remove a row that nobody can read, and keep its text and its files."""
        with self._store.sessions.begin() as session:
            self._record(session, table, row_id)
            session.execute(delete(table).where(table.id == row_id))
        place = self._store.path(table, row_id)
        with suppress(JoulemapError, OSError):  # an object that is damaged, or a store that is away
            self._store.here(place)
        if place.exists():
            self._put_away(place, str(place.relative_to(self._dir)))
        if (self._models / row_id).is_dir():
            self._put_away(self._models / row_id, f"models/{row_id}")

    def _put_away(self, path: Path, what: str) -> None:
        place = self._dir / REMOVED / what
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.exists():
            place = place.with_name(f"{place.name}.{now():%Y%m%dT%H%M%S%f}")
        shutil.move(path, place)


_ASKED_AGAIN: dict[str, Any] = {
    "status": QUEUED,
    "progress": 0.0,
    "finished_at": None,
    "summary": None,
    "problem": None,
    "bytes": None,
    "sums": None,
}


def _read_stats(path: Path, name: str) -> dict[str, Any]:
    return heightmap_stats(read_sent(path, filename=name))


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
