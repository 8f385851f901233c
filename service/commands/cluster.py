"""`--scheduler`: commands whose work is done by the workers of a Dask cluster, which share a file system with them."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import BusyError
from joulemap.service.commands.arguments import TYPED

if TYPE_CHECKING:
    from joulemap.service.cost_lattices import Written

_HELP = "Let workers of a Dask scheduler do it, like tcp://HOST:8786. They must find the same files at the same paths."


def _run_there(context: typer.Context, address: str | None) -> None:
    """Run the whole command on a worker, and end with its exit code."""
    if address is None or context.resilient_parsing:
        return
    typed = list(context.meta[TYPED])
    at = next(at for at, word in enumerate(typed) if word.partition("=")[0] == "--scheduler")
    del typed[at : at + (1 if "=" in typed[at] else 2)]
    raise typer.Exit(_run(address, [str(context.info_name), *typed]))


Scheduler = Annotated[str | None, typer.Option("--scheduler", metavar="URL", help=_HELP)]
"""Of a command that sends its parts off by itself."""
AsOneTask = Annotated[str | None, typer.Option("--scheduler", metavar="URL", help=_HELP, callback=_run_there)]
"""Of a command that runs as a whole on one worker."""


def _run(address: str, arguments: list[str]) -> int:
    from distributed import Client

    from joulemap.service.jobs.cluster import CONNECT_S
    from joulemap.service.work.processes import run_command

    topic = f"joulemap-{secrets.token_hex(6)}"
    try:
        with Client(address, timeout=CONNECT_S, set_as_default=False) as client:
            client.subscribe_topic(topic, lambda event: typer.echo(event[1]))
            return int(client.submit(run_command, arguments, os.getcwd(), topic, key=topic).result())
    except OSError as error:
        raise _no_scheduler(address) from error


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
    """Make a cost map on a cluster, tile by tile.

    Parameters
    ----------
    address : str
        Of the scheduler.
    out : Path
        Folder to write.
    heightmap : Path
        The file.
    reading : mapping
        How it is read.
    robot : mapping
        As `Robot.as_dict`.
    model : str
        Name or folder of the model.
    spacing_m : float
        Side of a cell [m].
    headings : int
        Number of heading bins.
    progress : callable
        Called with the share that is done, 0..1.

    Returns
    -------
    Written
        What was written.

    Raises
    ------
    BusyError
        If no scheduler answers.
    """
    from joulemap.model.energy.predictor import MODEL_NAMES
    from joulemap.model.frames import GridFrame
    from joulemap.model.robot import Robot
    from joulemap.service.cost_lattices import Written
    from joulemap.service.jobs.cluster import connected
    from joulemap.service.jobs.costmaps import make
    from joulemap.service.work.tiles import MapOrder

    named: str | Path = model if model in MODEL_NAMES else Path(model).resolve()
    order = MapOrder(out.resolve(), heightmap.resolve(), reading, robot, named, spacing_m, headings, replace=True)

    async def _report(share: float) -> None:
        progress(share)

    async def _make() -> dict[str, Any]:
        async with connected(address, workers=0) as client:
            return await make(client, order, key=f"joulemap-{secrets.token_hex(6)}", report=_report)

    import asyncio  # loads slowly, and most commands need it not

    order.folder.check_place()
    _clear(order)
    order.notes.mkdir(parents=True)
    try:
        found = asyncio.run(_make())
    except OSError as error:
        raise _no_scheduler(address) from error
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
    return BusyError(f"no Dask scheduler answers at {address}: start one with `dask scheduler`", scheduler=address)
