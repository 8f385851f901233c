"""The option `--server`: a command asks a service instead of computing itself."""

from __future__ import annotations

import inspect
import io
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import InputError
from joulemap.service.commands.console import Output, progress_bar, write_file
from joulemap.service.commands.options import there
from joulemap.service.words import capital

if TYPE_CHECKING:
    from joulemap.model.frames import GridFrame
    from joulemap.service.client import Client
    from joulemap.service.commands.asked import Wanted
    from joulemap.service.exports.routes import RouteFile

Server = Annotated[
    str | None,
    typer.Option("--server", metavar="URL", help="Ask this service, which keeps what is sent and made."),
]
Key = Annotated[
    str | None,
    typer.Option("--key", metavar="KEY", envvar="JOULEMAP_KEY", help="Key for the service, where it wants one."),
]


@dataclass(frozen=True)
class Remote:
    """The service that is asked in place of this process, where one is named."""

    server: Server = None
    key: Key = None

    @contextmanager
    def client(self) -> Iterator[Client]:
        """A client of it."""
        from joulemap.service.client import Client

        assert self.server is not None
        with Client(self.server, key=self.key) as client:
            yield client

    def answer(
        self,
        question: Any,
        costmap: Path,
        wanted: Wanted,
        output: Output,
        *,
        files: Sequence[tuple[Path, RouteFile]] = (),
        memory_gb: float | None = None,
        ask: Callable[..., Any] | None = None,
        also: Callable[[dict[str, Any], GridFrame], list[str]] = lambda _values, _frame: [],
    ) -> Answered:
        """Answer a question of `service.questions` here or by the service, and write the files of its routes.

        `ask` is in place of that of the question; `also` adds values to those of the options, and says notes on them.
        """
        name = question.__name__.rpartition(".")[2]

        def _request(frame: GridFrame) -> Any:
            values, notes = wanted.on(frame)
            notes += also(values, frame)
            output.warn(dict.fromkeys(notes))
            return wanted.request.of(**values)

        if self.server is not None:
            with self.client() as client, progress_bar(capital(name)) as report:
                there = client.open_costmap(str(costmap))
                for _, file in files:
                    file.check(there.crs)
                asked = _request(there.grid)
                said = there.ask(name, asked, progress=report)
                for path, file in files:
                    write_file(path, there.file(name, asked, **file.query))
            return Answered(said.model_dump(mode="json"), there.about.robot.name)
        from joulemap.service.library.costmaps import open_costmap

        ground = open_costmap(costmap, memory_gb=memory_gb)
        for _, file in files:
            file.check(ground.crs)
        asked, ask = _request(ground.planner.lattice.frame), ask or question.ask
        with progress_bar(capital(name)) as report:
            reported = {"progress": report} if "progress" in inspect.signature(ask).parameters else {}
            found = ask(ground.planner, asked, **reported)
        for path, file in files:
            write_file(path, file.written(question.track(found, ground.warnings)))
        said = question.answer(found, ground.warnings)
        return Answered(
            said if isinstance(said, dict) else said.model_dump(mode="json"), ground.robot.name, found, ground
        )


@dataclass(frozen=True)
class Answered:
    """An answer as JSON and the robot's name; where it was found here, what was found, and on which cost map."""

    values: dict[str, Any]
    robot: str
    found: Any = None
    ground: Any = None


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


def refuse_local(**options: Any) -> None:
    """Refuse options of what is done in this process. Raises typer.BadParameter."""
    for name, value in options.items():
        if value is not None:
            raise typer.BadParameter(f"--{name.replace('_', '-')} does not go with --server: leave one of them out")


def unpack(zipped: bytes, folder: Path) -> None:
    """Write a zipped cost map into a folder, whole or not at all; a cost map that is there is replaced."""
    from joulemap.planner.lattice.folder import LatticeFolder

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
