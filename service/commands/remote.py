"""The option `--server`: a command asks a service instead of computing itself."""

from __future__ import annotations

import io
import re
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import InputError
from joulemap.service.commands.options import there

if TYPE_CHECKING:
    from joulemap.service.client import Client, ServedCostMap

Server = Annotated[
    str | None,
    typer.Option("--server", metavar="URL", help="Ask this service, which keeps what is sent and made."),
]
Key = Annotated[
    str | None,
    typer.Option("--key", metavar="KEY", envvar="JOULEMAP_KEY", help="Key for the service, where it wants one."),
]
_ID = re.compile(r"cm-[0-9a-f]{12}")


def there_or_id(place: Path | None) -> Path | None:
    """The folder of a cost map, or the id of one that a service has. Raises NotFoundError where it is neither."""
    return place if place is not None and _ID.fullmatch(str(place)) else there(place)


MapOrId = Annotated[
    Path,
    typer.Argument(
        metavar="MAP.zarr",
        callback=there_or_id,
        help="A cost map made by `joulemap costmap`; with --server, the id of one.",
    ),
]


@contextmanager
def service_at(url: str, key: str | None) -> Iterator[Client]:
    """A client of a service."""
    from joulemap.service.client import Client

    with Client(url, key=key) as client:
        yield client


@contextmanager
def served(url: str, key: str | None, costmap: Path) -> Iterator[ServedCostMap]:
    """A cost map of a service."""
    with service_at(url, key) as client:
        yield client.open_costmap(str(costmap))


def refuse_local(**options: Any) -> None:
    """Refuse options of what is done in this process. Raises typer.BadParameter."""
    for name, value in options.items():
        if value is not None:
            raise typer.BadParameter(f"--{name.replace('_', '-')} does not go with --server: leave one of them out")


def unpack(zipped: bytes, folder: Path) -> None:
    """Write a zipped cost map into a folder, whole or not at all; a cost map that is there is replaced."""
    from joulemap.planner.lattice.io import LatticeFolder

    made = LatticeFolder(folder)
    with made.whole_or_nothing():
        shutil.rmtree(made.partial, ignore_errors=True)
        try:
            with zipfile.ZipFile(io.BytesIO(zipped)) as archive:
                for name in archive.namelist():
                    if Path(name).is_absolute() or ".." in Path(name).parts:
                        raise InputError(f"the service sent a file outside of the cost map: {name[:80]!r}")
                    below = made.partial.joinpath(*Path(name).parts[1:])  # without the service's name of the map
                    below.parent.mkdir(parents=True, exist_ok=True)
                    below.write_bytes(archive.read(name))
        except zipfile.BadZipFile as error:
            raise InputError(f"the service sent no cost map: {error}") from error
        shutil.rmtree(folder, ignore_errors=True)
        made.partial.rename(folder)
