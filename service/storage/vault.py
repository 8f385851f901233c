"""Where everything that is finished is kept: the data folder itself, or an object store of which it has copies.

In an object store a file or a folder is there when the record that names its files is, which is written last and
removed first: whoever looks finds all of it or nothing. Nothing that is there is ever changed.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from joulemap.model.errors import DamagedError, InputError
from joulemap.service.storage.files import bytes_of

LOST = errno.EHOSTUNREACH  # of an object store that does not answer: answered with 503, and jobs wait
_AT_ONCE = 8  # transfers
SHOWN = "the object store"
"""What messages call it."""


def obstore_library() -> Any:
    """Return obstore, which is an extra."""
    import obstore

    return obstore


def for_all(do: Callable[[str], object], names: list[str]) -> None:
    """Do something for every name, some at a time; raises what the first failure raises."""
    if len(names) <= 1:
        for name in names:
            do(name)
        return
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for done in [pool.submit(partial(do, name)) for name in names]:
            done.result()


@contextmanager
def as_file_errors() -> Iterator[None]:
    """Raise the errors of an object store as those of a file system."""
    from obstore.exceptions import BaseError, NotFoundError

    try:
        yield
    except (NotFoundError, FileNotFoundError) as error:
        raise FileNotFoundError(errno.ENOENT, f"{SHOWN} has no such object: {first_line(error)}") from error
    except BaseError as error:
        raise OSError(LOST, f"{SHOWN} does not answer as it should: {first_line(error)}") from error


def first_line(error: BaseException) -> str:
    """Return the first line of an error; below it obstore repeats itself for its developers."""
    return (str(error).splitlines() or [type(error).__name__])[0][:300]


_RECORDS = "records"
_RECORD_S, _CONTENT_S = 5.0, 20.0
"""Longest time of one request for a record, and for a piece of a file; a connection that hangs is then given up."""
_RETRIES = 2  # of one request, each over another connection where the one before hung
PIECE_BYTES = 5 << 20  # the smallest piece that S3 takes
_PIECES_AT_ONCE = 2  # of one file: 16 pieces within `_CONTENT_S` are 4 MB a second
_TRANSFERS = 2  # of one file, before it is taken for damaged
FETCHED = ".fetched.partial"
"""End of the name of a copy in the data folder that is on its way."""


class Part(NamedTuple):
    """A file of what is kept.

    Attributes
    ----------
    size : int
        Length [bytes].
    sha256 : str
        Of its content.
    """

    size: int
    sha256: str


class ObjectVault:
    """An object store that is named by a URL."""

    def __init__(self, url: str) -> None:
        try:
            from obstore import store  # only here: it is an extra
            from obstore.exceptions import BaseError
        except ImportError:
            words = f"the object store {url} needs obstore: pip install 'joulemap[objects]'"
            raise InputError(words, url=url) from None
        self.url = url
        try:
            self._records, self._store = (_opened(store.from_url, url, limit_s) for limit_s in (_RECORD_S, _CONTENT_S))
        except (BaseError, ValueError) as error:
            raise InputError(f"{url} is no object store that can be used: {first_line(error)}", url=url) from error

    def begin(self, key: str) -> None:
        """Say that something is on its way. `remove` removes this first, and looks for what was sent after it."""
        self._record(key, {})

    def put(self, key: str, place: Path, *, there: Mapping[str, Part] | None = None, begun: str | None = None) -> None:
        """Keep a file or a folder, whole or not at all."""
        if begun is not None:
            self.check_begun(begun)
        sent = there or {}
        files = {_below(file, place): _part(file) for file in _files(place)}
        self.send(key, place, [name for name, part in files.items() if sent.get(name) != part])
        if begun is not None:  # once more: sending takes its time
            self.check_begun(begun)
        self._record(key, files)

    def check_begun(self, key: str) -> None:
        """Refuse to go on with what nobody waits for any more."""
        if self.parts(key) is None:
            raise FileNotFoundError(errno.ENOENT, f"nobody waits for {key} any more: it was deleted, or is done")

    def _record(self, key: str, files: Mapping[str, Part]) -> None:
        record = {"files": {name: list(part) for name, part in sorted(files.items())}}
        self.write(f"{_RECORDS}/{key}.json", json.dumps(record).encode())

    def send(self, key: str, place: Path, names: list[str]) -> dict[str, Part]:
        """Send files without keeping them yet."""

        def _send(name: str) -> None:
            with as_file_errors(), (place / name).open("rb") as file:
                obstore_library().put(
                    self._store, _object(key, name), file, chunk_size=PIECE_BYTES, max_concurrency=_PIECES_AT_ONCE
                )

        for_all(_send, names)
        return {name: _part(place / name) for name in names}

    def get(self, key: str, place: Path, parts: Mapping[str, Part]) -> None:
        """Copy files that were sent, each whole or not at all."""

        def _get(name: str) -> None:
            target = place / name if name else place
            target.parent.mkdir(parents=True, exist_ok=True)
            begun = target.with_name(f"{target.name}.{secrets.token_hex(4)}.partial")
            try:
                for _ in range(_TRANSFERS):
                    self._copy(_object(key, name), begun)
                    if _part(begun) == parts[name]:
                        begun.replace(target)
                        return
                raise damaged(f"{SHOWN} has not what was kept as {_object(key, name)}", key)
            finally:
                begun.unlink(missing_ok=True)

        for_all(_get, list(parts))

    def _copy(self, name: str, target: Path) -> None:
        """Copy an object piece by piece, so that the limit of a request is of a piece and not of the whole."""
        with as_file_errors(), target.open("wb") as file:
            size = obstore_library().head(self._store, name)["size"]
            for start in range(0, size, PIECE_BYTES):
                end = min(start + PIECE_BYTES, size)
                file.write(obstore_library().get_range(self._store, name, start=start, end=end))

    def fetch(self, key: str, place: Path) -> None:
        """Have a copy in the data folder, whole or not at all."""
        for last in (False, True):
            if place.exists():
                return
            parts = self.parts(key)
            if parts is None:
                raise FileNotFoundError(errno.ENOENT, f"{SHOWN} has no {key}", str(place))
            begun = place.with_name(f"{place.name}.{secrets.token_hex(4)}{FETCHED}")
            try:
                self.get(key, begun, parts)
                with _if_not(place):  # another process may have been quicker
                    begun.rename(place)
                return
            except FileNotFoundError as error:  # it is deleted at this moment, here or there; or a file of it is lost
                if last:
                    raise damaged(f"{SHOWN} has lost a part of {key}: {error.strerror}", key) from error
            finally:
                shutil.rmtree(begun, ignore_errors=True)
                if begun.is_file():
                    begun.unlink()

    def size(self, key: str, place: Path) -> int:
        """Return how much is kept."""
        return sum(part.size for part in (self.parts(key) or {}).values())

    def parts(self, key: str) -> dict[str, Part] | None:
        """Return the record of what is kept. Result: a part by the name of each file; None where nothing is kept."""
        found = self.read(f"{_RECORDS}/{key}.json")
        if found is None:
            return None
        return {name: Part(*part) for name, part in json.loads(found)["files"].items()}

    def remove(self, key: str) -> None:
        """Keep something no longer: its record goes first, so that nobody takes a part for the whole.

        It goes once more at the end: who kept the same thing at this moment may have written it meanwhile.
        """
        self._remove_record(key)
        names = list(self.names(key))  # of a folder
        with as_file_errors(), suppress(FileNotFoundError):
            if not names:
                obstore_library().head(self._store, key)  # a single file; in a folder of files, no empty folder
                names = [key]
            obstore_library().delete(self._store, names)
        self._remove_record(key)

    def _remove_record(self, key: str) -> None:
        with as_file_errors(), suppress(FileNotFoundError):
            obstore_library().delete(self._records, f"{_RECORDS}/{key}.json")

    def has(self, key: str) -> bool:
        """Return whether something is kept.

        Result: False for a record whose files were removed before it was written.
        """
        parts = self.parts(key)
        if not parts:
            return False
        try:
            with as_file_errors():
                obstore_library().head(self._store, _object(key, min(parts)))
        except FileNotFoundError:
            return False
        return True

    def write(self, name: str, content: bytes) -> None:
        """Write a small object."""
        with as_file_errors():
            obstore_library().put(self._records, name, content)

    def read(self, name: str) -> bytes | None:
        """Read a small object. Result: None where there is none."""
        try:
            with as_file_errors():
                return bytes(obstore_library().get(self._records, name).bytes())
        except FileNotFoundError:
            return None

    def names(self, prefix: str, *, before: dt.datetime | None = None) -> Iterator[str]:
        """Yield the names of objects in a folder."""
        with as_file_errors():
            for found in obstore_library().list(self._store, prefix):
                yield from (each["path"] for each in found if before is None or each["last_modified"] < before)

    def check(self) -> None:
        """Raise OSError where the object store does not answer."""
        self.read(f"{_RECORDS}/none.json")


def damaged(words: str, key: str) -> DamagedError:
    """Return the error of something that the object store keeps no longer as it was sent, with what to do."""
    return DamagedError(
        f"{words}. `joulemap check --repair` makes cost maps and calibrations again; take others from a backup",
        file=key,
    )


def _opened(open_url: Any, url: str, limit_s: float) -> Any:
    """The object store of a URL, whose requests end after so many seconds."""
    if url.startswith("file:"):
        return open_url(url, mkdir=True)
    options: dict[str, Any] = {"timeout": dt.timedelta(seconds=limit_s), "connect_timeout": "5s"}
    if os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://"):
        options["allow_http"] = True
    retries = {"max_retries": _RETRIES, "retry_timeout": dt.timedelta(seconds=(_RETRIES + 1) * limit_s)}
    return open_url(url, client_options=options, retry_config=retries)


def _object(key: str, name: str) -> str:
    return f"{key}/{name}" if name else key


def _files(place: Path) -> list[Path]:
    return [path for path in place.rglob("*") if path.is_file()] if place.is_dir() else [place]


def _below(file: Path, place: Path) -> str:
    return "" if file == place else file.relative_to(place).as_posix()


def _part(file: Path) -> Part:
    with file.open("rb") as content:
        return Part(file.stat().st_size, hashlib.file_digest(content, "sha256").hexdigest())


@contextmanager
def _if_not(place: Path) -> Iterator[None]:
    """Let an OSError pass where something is at a place."""
    try:
        yield
    except OSError:
        if not place.exists():
            raise


class FolderVault:
    """The data folder: what lies in it is kept. A key is a path like ``costmaps/cm-0123456789ab.zarr``."""

    def put(self, key: str, place: Path) -> None:
        """Do nothing: it is there."""

    def fetch(self, key: str, place: Path) -> None:
        """Do nothing: it is there, or its reader will say that it is not."""

    def size(self, key: str, place: Path) -> int:
        """Return how much is kept."""
        return bytes_of(place)

    def remove(self, key: str) -> None:
        """Do nothing: who removes the file removes it."""

    def check(self) -> None:
        """Do nothing: the disk has a check of its own."""


def vault_of(url: str | None) -> FolderVault | ObjectVault:
    """Return where everything is kept.

    `url`: of an object store, None for the data folder. Result: ready; nothing is asked of it yet.
    """
    return FolderVault() if url is None else ObjectVault(url)
