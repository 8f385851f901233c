"""`joulemap check`, `backup`, `restore` and `keys`: what a service keeps and who may use it, beside one that runs."""

from __future__ import annotations

import errno
import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import InputError, NotFoundError
from joulemap.service.commands.console import Command, JsonFile, Output, progress_bar
from joulemap.service.commands.options import there

if TYPE_CHECKING:
    from joulemap.service.hosting.settings import Settings
    from joulemap.service.storage.check import Finding
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

    from joulemap.service.hosting.settings import Settings

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
    from joulemap.service.storage.files import FOLDER_MODE

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

    from joulemap.service.storage.files import private_files
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


_LEFT = 1  # exit code of a check that leaves something wrong


def check(
    repair: Annotated[
        bool, typer.Option("--repair", help="Put right what can be put right; no service may run meanwhile.")
    ] = False,
    data_dir: DataDir = None,
    json_file: JsonFile = None,
) -> None:
    """**Verify a data directory**: the database, and that rows and files belong together and can be read.

    `--repair` deletes what killed processes left, has damaged cost maps and calibrations made again at the next start,
    reads heightmaps again whose rows are damaged, and moves what belongs to nothing, and damaged heightmaps and runs,
    into the folder `removed`: the latter are answered as gone, and what was made from them stays. The exit code is 1
    where something stays wrong.

    Example: `joulemap check --repair --data-dir /var/lib/joulemap`
    """
    from joulemap.service.schemas.kept import ANSWERS
    from joulemap.service.storage.check import LEFT_BY_KILLED, Check, Finding

    output, settings = Output(json_file), settings_of(data_dir=data_dir)
    used(settings)
    found: list[dict[str, Any]] = []
    if repair:  # a service that starts alone deletes them
        with opened_store(writable(settings)) as store:
            left = [str(path.relative_to(settings.data_dir)) for path in store.leftovers()]
        found = [_document(Finding("partial", what, LEFT_BY_KILLED, "delete it"), repaired=True) for what in left]
    with opened_store(writable(settings), alone=repair) as store, progress_bar("Check") as report:
        looking = Check(store, settings.data_dir, settings.resolved_models_dir, answers=ANSWERS)
        for finding in looking.findings(report):
            if repair and finding.repair is not None:
                finding.repair()
            found.append(_document(finding, repaired=repair and finding.repair is not None))
    for one in found:
        output.say(f"{one['what']}: {one['words']}{_after(one, repair)}", head=one["kind"])
    counts = Counter(one["kind"] for one in found)
    wrong = sum(not one["repaired"] for one in found)
    output.say(", ".join(f"{count} {kind}" for kind, count in sorted(counts.items())) or "nothing is wrong")
    output.document({"findings": found, "left": wrong})
    if wrong:
        raise typer.Exit(_LEFT)


def _document(finding: Finding, *, repaired: bool) -> dict[str, Any]:
    return {name: getattr(finding, name) for name in ("kind", "what", "words", "remedy")} | {"repaired": repaired}


def _after(one: dict[str, Any], repair: bool) -> str:
    if one["repaired"]:
        return f" -> {one['remedy']}: done"
    if one["remedy"] is None:
        return " -> restore it from a backup, or delete it"
    return "" if repair else f" -> --repair will: {one['remedy']}"


def backup(
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="Folder of the copy, which is not there yet.")],
    data_dir: DataDir = None,
    json_file: JsonFile = None,
) -> None:
    """**Copy everything that is kept** while the service runs: database, files and models, with their checksums.

    The database is copied as it is at one moment, also a PostgreSQL. What is being made is asked for again after a
    `restore`.

    Example: `joulemap backup /backups/joulemap-monday`
    """
    from joulemap.service.storage.backup import back_up

    output, settings = Output(json_file), settings_of(data_dir=data_dir)
    used(settings)
    with opened_store(settings) as store, progress_bar("Backup") as report:
        manifest = back_up(store, target, models_dir=settings.resolved_models_dir, progress=report)
    _say_copied(output, manifest, f"written: {target}")


def restore(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", callback=there, help="A folder made by `joulemap backup`.")
    ],
    data_dir: DataDir = None,
    json_file: JsonFile = None,
) -> None:
    """**Put a copy into an empty data directory** and its database, after every file was compared with its checksum.

    Example: `joulemap restore /backups/joulemap-monday --data-dir /var/lib/joulemap`
    """
    from joulemap.service.storage.backup import restore as put_back

    output, settings = Output(json_file), writable(settings_of(data_dir=data_dir))
    with opened_store(settings, alone=True) as store, progress_bar("Restore") as report:
        manifest = put_back(source, store, settings.data_dir, models_dir=settings.resolved_models_dir, progress=report)
    _say_copied(output, manifest, f"restored into {settings.data_dir}")


def _say_copied(output: Output, manifest: dict[str, Any], words: str) -> None:
    rows, files = manifest["rows"], manifest["files"].values()
    kept = ", ".join(f"{count} {name}" for name, count in rows.items() if count)
    output.say(f"{kept or 'nothing was kept'}; {len(files)} files, {sum(size for size, _ in files) / 1e6:.1f} MB")
    output.say(words)
    output.document({key: manifest[key] for key in ("format", "joulemap", "created_at", "rows")} | {"words": words})


keys = typer.Typer(
    name="keys",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="**Who may use a service**: add, list and revoke its keys.",
)


@keys.command(cls=Command)
def add(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Owner of what is sent and made with the key.")],
    operator: Annotated[bool, typer.Option("--operator", help="It sees everything, and /metrics.")] = False,
    adopt: Annotated[
        bool, typer.Option("--adopt", help="Give this name what was kept before there were keys.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Most jobs that wait or run. [default: JOULEMAP_KEY_JOBS, else 8]"),
    ] = None,
    gb: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="GB", help="Most that it keeps. [default: JOULEMAP_KEY_GB, else 100]"),
    ] = None,
    requests_per_s: Annotated[
        float | None,
        typer.Option(
            min=0.001, metavar="N", help="Most requests per second. [default: JOULEMAP_KEY_REQUESTS_PER_S, else 300]"
        ),
    ] = None,
    data_dir: DataDir = None,
    json_file: JsonFile = None,
) -> None:
    """Add a key and **show it once**: only a hash of it is kept. From the first key on, every request needs one.

    A name owns what is sent and made with its keys, and sees nothing else. Another key for the same name sees the same.
    A running service knows the key within two seconds.

    Example: `joulemap keys add survey-team --jobs 4`
    """
    from joulemap.service.storage.owners import add_key

    output = Output(json_file)
    with opened_store(writable(settings_of(data_dir=data_dir))) as store:
        key = add_key(
            store.sessions, name, operator=operator, adopt=adopt, jobs=jobs, gb=gb, requests_per_s=requests_per_s
        )
    output.say(head=key)
    output.say(f"the key of {name}: it is shown only now. Send it as the header Authorization: Bearer KEY")
    output.document({"name": name, "key": key, "operator": operator})


@keys.command("list", cls=Command)
def list_keys(data_dir: DataDir = None, json_file: JsonFile = None) -> None:
    """List all keys: the beginning of each, its owner, its limits, and since when.

    Example: `joulemap keys list --json -`
    """
    from joulemap.service.storage.owners import all_keys, kept_bytes

    output = Output(json_file)
    found: list[dict[str, Any]] = []
    with opened_store(writable(settings_of(data_dir=data_dir))) as store:
        rows = all_keys(store.sessions)
        with store.sessions() as session:
            kept = {name: kept_bytes(session, name) for name in {row.name for row in rows}}
    for row in rows:
        at = {"created_at": row.created_at, "revoked_at": row.revoked_at}
        times = {name: moment and moment.isoformat(timespec="seconds") for name, moment in at.items()}
        known = {name: getattr(row, name) for name in ("prefix", "name", "operator", *_LIMITS)}
        found.append(known | times | {"kept_bytes": kept[row.name]})
    if found:
        output.table({key["prefix"]: _words(key) for key in found})
    else:
        output.say("there are no keys: the service is open")
    output.document({"keys": found})


def _words(key: dict[str, Any]) -> str:
    limits = [f"{key[name]:g} {unit}" for name, unit in _LIMITS.items() if key[name] is not None]
    return ", ".join(
        (
            f"{key['name']}{' (operator)' if key['operator'] else ''}",
            f"since {key['created_at']}",
            f"revoked {key['revoked_at']}" if key["revoked_at"] else f"keeps {key['kept_bytes'] / 1e9:.3g} GB",
            *limits,
        )
    )


_LIMITS = {"jobs": "jobs at most", "gb": "GB at most", "requests_per_s": "requests/s at most"}


@keys.command(cls=Command)
def revoke(
    which: Annotated[
        str, typer.Argument(metavar="NAME", help="Whose keys; or the beginning of one key, as `list` shows it.")
    ],
    data_dir: DataDir = None,
    json_file: JsonFile = None,
) -> None:
    """Revoke all keys of a name, or one key. A running service refuses them within two seconds.

    What the name owns is kept: a new key for the name sees it again. A service whose last key was revoked stays closed.

    Example: `joulemap keys revoke survey-team`
    """
    from joulemap.service.storage.owners import revoke_keys

    output = Output(json_file)
    with opened_store(writable(settings_of(data_dir=data_dir))) as store:
        count = revoke_keys(store.sessions, which)
    output.say(f"revoked: {count} key{'' if count == 1 else 's'}")
    output.document({"revoked": count})
