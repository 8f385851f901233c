"""Who does a command's work: the service of `--server`, or the workers of `--scheduler`, which share a file system."""

from __future__ import annotations

import inspect
import io
import os
import re
import shutil
import zipfile
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from joulemap.model.errors import BusyError, InputError
from joulemap.service.cluster.address import scheduler_address
from joulemap.service.commands.console import TYPED, Output, progress_bar, write_file
from joulemap.service.commands.options import there
from joulemap.service.words import capital

if TYPE_CHECKING:
    from distributed import Client as DaskClient

    from joulemap.model.frames import GridFrame
    from joulemap.service.analysis.cost_lattices import Written
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


_HELP = "Let workers of a Dask scheduler do it, like tcp://HOST:8786. They must find the same files at the same paths."


def _checked(address: str | None) -> str | None:
    """The address that was typed. Raises typer.BadParameter where it is none."""
    try:
        return None if address is None else scheduler_address(address)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def _run_there(context: typer.Context, typed_address: str | None) -> None:
    """Run the whole command on a worker, and end with its exit code."""
    address = _checked(typed_address)
    if address is None or context.resilient_parsing:
        return
    typed = list(context.meta[TYPED])
    at = next(at for at, word in enumerate(typed) if word.partition("=")[0] == "--scheduler")
    del typed[at : at + (1 if "=" in typed[at] else 2)]
    raise typer.Exit(_run(address, [str(context.info_name), *typed]))


Scheduler = Annotated[str | None, typer.Option("--scheduler", metavar="URL", help=_HELP, callback=_checked)]
"""Of a command that sends its parts off by itself."""
AsOneTask = Annotated[str | None, typer.Option("--scheduler", metavar="URL", help=_HELP, callback=_run_there)]
"""Of a command that runs as a whole on one worker."""


@asynccontextmanager
async def _client_at(address: str) -> AsyncIterator[DaskClient]:
    """A client of the scheduler, which is said to have no workers. Raises BusyError where none answers."""
    from joulemap.service.cluster.connection import connected

    async with AsyncExitStack() as stack:
        try:
            client = await stack.enter_async_context(connected(address, workers=0))
        except OSError as error:
            raise _no_scheduler(address) from error
        if not await client.nthreads():  # some clusters start workers only when there is work
            words = f"the scheduler at {address} has no workers: the work waits for one, of `dask worker {address}`"
            Console(stderr=True, soft_wrap=True).print(f"[bold yellow]warning:[/] {escape(words)}", highlight=False)
        yield client


def _run(address: str, arguments: list[str]) -> int:
    from joulemap.service.work.processes import run_command

    topic = f"joulemap-{os.urandom(6).hex()}"

    async def _there() -> int:
        async with _client_at(address) as client:
            client.subscribe_topic(topic, lambda event: typer.echo(event[1]))
            return int(await client.submit(run_command, arguments, os.getcwd(), topic, key=topic))

    import asyncio  # loads slowly, and most commands need it not

    return asyncio.run(_there())


def costmap_there(
    address: str,
    out: Path,
    heightmap: Path,
    *,
    reading: Mapping[str, Any],
    robot: Mapping[str, Any],
    model: str,
    spacing_m: float,
    headings: int,
    progress: Callable[[float], None],
) -> Written:
    """Make a cost map on a cluster, tile by tile. Raises BusyError if no scheduler answers."""
    from joulemap.model.energy.predictor import MODEL_NAMES
    from joulemap.model.frames import GridFrame
    from joulemap.model.robot import Robot
    from joulemap.service.analysis.cost_lattices import Written
    from joulemap.service.jobs.costmaps import make
    from joulemap.service.work.tiles import MapOrder

    named: str | Path = model if model in MODEL_NAMES else Path(model).resolve()
    files = {role: [str(Path(file).resolve()) for file in some] for role, some in (reading.get("layers") or {}).items()}
    reading = {**reading, "layers": files}  # a worker runs in another folder
    order = MapOrder(out.resolve(), heightmap.resolve(), reading, robot, named, spacing_m, headings, replace=True)

    async def _report(share: float) -> None:
        progress(share)

    async def _make() -> dict[str, Any]:
        async with _client_at(address) as client:
            return await make(client, order, key=f"joulemap-{os.urandom(6).hex()}", report=_report)

    import asyncio  # loads slowly, and most commands need it not

    order.folder.check_place()
    _clear(order)
    order.notes.mkdir(parents=True)
    try:
        found = asyncio.run(_make())
    finally:
        _clear(order)
    west, _, _, north = found["frame"]["bounds"]
    frame = GridFrame(west, north, *(found["frame"][key] for key in ("spacing_m", "rows", "cols", "crs")))
    figures = {key: found[key] for key in ("energy_per_m", "blocked")}
    return Written(frame, Robot.from_mapping(found["robot"]), found["provenance"], figures)


def _clear(order: Any) -> None:
    for place in (order.notes, order.folder.partial):
        shutil.rmtree(place, ignore_errors=True)


def _no_scheduler(address: str) -> BusyError:
    from joulemap.service.cluster.connection import CONNECT_S

    words = f"no Dask scheduler answers at {address} within {CONNECT_S:g} s: start one with `dask scheduler`"
    return BusyError(f"{words}, or name another one", scheduler=address)
