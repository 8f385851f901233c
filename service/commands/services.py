"""`joulemap serve`, `demo`, `warmup` and `openapi`: the HTTP service and what goes with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, parse_point, progress_bar, write_file
from joulemap.service.commands.data_directory import opened_store, settings_of, writable
from joulemap.service.commands.options import Reading, there

_SWITCH_S = 0.001
"""How long the event loop waits for a thread that computes in Python; Python's own is 5 ms, for each thread."""


def serve(
    host: Annotated[
        str | None,
        typer.Option(help="Address to listen at; 0.0.0.0 for every one. [default: JOULEMAP_HOST, else 127.0.0.1]"),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, metavar="N", help="Port to listen at. [default: JOULEMAP_PORT, else 8000]"),
    ] = None,
    data_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of everything that is kept. [default: data]")
    ] = None,
) -> None:
    """Start the **HTTP service** (Ctrl-C stops it). Its description is /openapi.json, its readiness /readyz.

    Everything else is set by environment variables `JOULEMAP_...`, for example `JOULEMAP_MODELS_DIR` (trained models),
    `JOULEMAP_DATABASE_URL` and `JOULEMAP_MAX_LATTICE_VALUES` (largest cost map); `make docs` makes a page of all.

    Example: `joulemap serve --host 0.0.0.0 --port 8080 --data-dir /var/lib/joulemap`
    """
    import signal
    import socket
    import sys

    import uvicorn

    from joulemap.service.http.app import create_app
    from joulemap.service.http.logs import log_config
    from joulemap.service.http.middleware import FILES_EACH, most_connections
    from joulemap.service.storage.database import check_pages
    from joulemap.service.storage.files import others_get_nothing

    settings = writable(settings_of(host=host, port=port, data_dir=data_dir))
    with opened_store(settings) as store:  # what is wrong with the database is said here, and not by the server
        if store.engine.dialect.name == "sqlite":
            check_pages(store.engine)
    others_get_nothing()
    sys.setswitchinterval(_SWITCH_S)
    settings = settings.model_copy(update={"max_connections": most_connections(settings.max_connections)})
    app = create_app(settings)
    signal.signal(signal.SIGTERM, _end)  # uvicorn sends it once more when the service has stopped

    class _Server(uvicorn.Server):
        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            app.state.service.end_events()  # which would go on until they are cancelled
            await super().shutdown(sockets)

    config = uvicorn.Config(
        app,
        ws="none",
        limit_concurrency=FILES_EACH * settings.max_connections,
        host=settings.host,
        port=settings.port,
        access_log=False,  # the service writes a line of its own, with the id of the request
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=",".join(settings.trusted_proxies),
        log_config=log_config(settings.log_format),
        timeout_graceful_shutdown=settings.shutdown_s,
    )
    server = _Server(config)
    server.run()
    if not server.started:
        raise typer.Exit(1)


def _end(number: int, _frame: object) -> None:
    """Write the last lines of the log, then let the signal end this process, whatever its threads are at."""
    import logging
    import signal

    logging.shutdown()
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)


def demo(
    exit_after: Annotated[bool, typer.Option("--exit", help="Stop the service at the end.")] = False,
    heightmap: Annotated[
        Path | None,
        typer.Option(metavar="FILE", callback=there, help="Another heightmap than the sample."),
    ] = None,
    start: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to start [m].")] = None,
    goal: Annotated[Any, typer.Option(metavar="X,Y", parser=parse_point, help="Where to go [m].")] = None,
    model: Annotated[str, typer.Option(metavar="M", help="`default` or `physics`.")] = "default",
    host: Annotated[
        str | None, typer.Option(help="Address to listen at. [default: JOULEMAP_HOST, else 127.0.0.1]")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            metavar="N",
            help="Port; another one is taken if it is in use. [default: JOULEMAP_PORT, else 8000]",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the picture and the service's data.")] = Path(
        "demo"
    ),
    json_file: JsonFile = None,
    *,
    reading: Reading,
) -> None:
    """Show the whole **in a minute**: start a service, send it a heightmap, ask for a cost map, a path and a verdict.

    The service runs until Ctrl-C, unless `--exit` is given.

    Examples: `joulemap demo --exit`, `joulemap demo --heightmap dem.tif --start 12,40 --goal 180,95`
    """
    from joulemap.service.commands.demo import run_demo

    output = Output(json_file)
    settings = settings_of(host=host, port=port)
    run_demo(
        output,
        heightmap=heightmap,
        start=start,
        goal=goal,
        model=model,
        host=settings.host,
        port=settings.port,
        out=out,
        keep=not exit_after,
        reading=reading,
    )


def warmup(json_file: JsonFile = None) -> None:
    """Compile every kernel **once and keep it**, so that no request waits for the compiler (after an installation)."""
    from joulemap.service.work.warm_up import warm_up

    output = Output(json_file)
    output.say("kernels are compiled once, which takes one to three minutes; later calls take seconds")
    with progress_bar("Compiling") as _:
        seconds = warm_up()
    output.say(f"ready: kernels and the default model loaded in {seconds:.1f} s")
    output.document({"seconds": seconds})


def openapi(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Where to write it; - is standard output.", allow_dash=True)
    ] = Path("openapi/openapi.json"),
) -> None:
    """Write the service's **OpenAPI document**."""
    import json

    from joulemap.service.http.app import openapi_document

    text = json.dumps(openapi_document(), indent=2, ensure_ascii=False) + "\n"
    if str(out) == "-":
        typer.echo(text, nl=False)
    else:
        write_file(out, text.encode())
        typer.echo(f"written: {out}")
