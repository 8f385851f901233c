"""`joulemap keys`: who may use a service."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from joulemap.service.commands.arguments import Command
from joulemap.service.commands.console import JsonFile, Output
from joulemap.service.commands.data_directory import DataDir, opened_store, settings_of, writable

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
    from joulemap.service.storage.keys import add_key

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
    from joulemap.service.storage.keys import all_keys
    from joulemap.service.storage.owners import kept_bytes

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
    from joulemap.service.storage.keys import revoke_keys

    output = Output(json_file)
    with opened_store(writable(settings_of(data_dir=data_dir))) as store:
        count = revoke_keys(store.sessions, which)
    output.say(f"revoked: {count} key{'' if count == 1 else 's'}")
    output.document({"revoked": count})
