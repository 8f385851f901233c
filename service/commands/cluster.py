"""`--scheduler`: commands whose work is done by the workers of a Dask cluster, which share a file system with them."""

from __future__ import annotations

import os
import shutil
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from joulemap.model.errors import BusyError
from joulemap.service.cluster.address import scheduler_address
from joulemap.service.commands.console import TYPED

if TYPE_CHECKING:
    from distributed import Client

    from joulemap.service.analysis.cost_lattices import Written

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
async def _client_at(address: str) -> AsyncIterator[Client]:
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
