"""What the commands share that work on a service's data folder, beside a service that may be running."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import InputError, NotFoundError

if TYPE_CHECKING:
    from joulemap.service.settings import Settings
    from joulemap.service.storage.store import Store

_PASSWORD = re.compile(r"(://[^:@/]*:)[^@]*@")
DataDir = Annotated[
    Path | None,
    typer.Option(
        "--data-dir", metavar="DIR", help="The service's data folder. [default: JOULEMAP_DATA_DIR, else data]"
    ),
]


def settings_of(**given: Any) -> Settings:
    """The settings of the options that are given, and of the environment. A wrong one is wrong usage."""
    from pydantic import ValidationError
    from pydantic_settings import SettingsError

    from joulemap.service.settings import Settings

    try:
        return Settings(**{key: value for key, value in given.items() if value is not None})
    except ValidationError as error:
        raise typer.BadParameter("; ".join(map(_wrong, error.errors()))) from error
    except SettingsError as error:
        raise typer.BadParameter(f"{error}: it is a list in JSON") from error


def _wrong(found: Any) -> str:
    """One of pydantic's findings in words."""
    words = str(found["msg"]).removeprefix("Value error, ")
    given = _PASSWORD.sub(r"\1***@", repr(found["input"]))
    return f"JOULEMAP_{found['loc'][0]!s}".upper() + f" is {given}: {words}"


def writable(settings: Settings) -> Settings:
    """The same settings, with a data folder. Raises OSError where it cannot be written."""
    from joulemap.service.storage.private import FOLDER_MODE

    settings.data_dir.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
    if not os.access(settings.data_dir, os.W_OK):
        raise PermissionError(errno.EACCES, "no right to write there", str(settings.data_dir))
    return settings


def used(settings: Settings) -> Settings:
    """The same settings, of a service that was started before. Raises NotFoundError where nothing was ever kept."""
    if settings.database_url is None and not (settings.data_dir / "joulemap.db").is_file():
        words = f"{settings.data_dir} is no data directory of joulemap: it has no joulemap.db"
        raise NotFoundError(words, data_dir=str(settings.data_dir))
    return settings


@contextmanager
def opened_store(settings: Settings, *, alone: bool = False) -> Iterator[Store]:
    """The store of a data folder; what is written meanwhile is for this account alone.

    alone : no service may use it meanwhile. Raises ConflictError, InputError.
    """
    from sqlalchemy.exc import DatabaseError

    from joulemap.service.storage.private import private_files
    from joulemap.service.storage.store import Store

    store = Store(settings.data_dir, settings.resolved_database_url, objects=settings.store)
    try:
        with private_files():
            store.open(as_service=alone, alone=alone)
            yield store
    except DatabaseError as error:
        where = _PASSWORD.sub(r"\1***@", settings.resolved_database_url)
        raise InputError(f"the database {where} cannot be used: {' '.join(str(error.orig).split())}") from error
    finally:
        store.close()
