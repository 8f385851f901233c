"""The command `joulemap`: every command's name and place. The commands themselves are in `service.commands`."""

from __future__ import annotations

import gc
import os
from typing import Annotated, Any

import typer

from joulemap.service.commands import (
    area_questions,
    calibration,
    data_directory,
    doctor,
    following,
    heightmaps,
    logs,
    maps,
    models,
    paths,
    services,
    simulation,
)
from joulemap.service.commands.asked import Commands, listed
from joulemap.service.commands.console import Command

_NEW_OBJECTS = 50_000
"""After so many new objects cycles are looked for: what libraries make while they load stays, and to look through it
time and again took a sixth of the start-up."""
_SMALL_PAGES = "NUMPY_MADVISE_HUGEPAGE", "0"
"""NumPy asks Linux for pages of 2 MB. A virtual machine may have to fetch such a page from its host, which takes 5 to
16 ms, and 4.5 times as long as the same memory in small pages; whatever waits for this processor or for the interpreter
waits with it."""


class Joulemap(Commands):
    """The commands, in a process that is made ready for them."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the context names."""
        os.environ.setdefault(*_SMALL_PAGES)  # NumPy reads it once, when a command imports it
        gc.set_threshold(_NEW_OBJECTS, *gc.get_threshold()[1:])
        return super().invoke(ctx)


app = typer.Typer(
    name="joulemap",
    cls=Joulemap,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=(
        "Begin with `joulemap demo --exit`. "
        "On your own map: `joulemap costmap dem.tif --robot robot.toml --out dem.zarr`, then "
        "`joulemap path dem.zarr --start X,Y --goal X,Y`. "
        "Exit codes: 0 answered, 2 wrong usage, 3 unusable input, 4 no answer (blocked, no route), 5 not there, "
        "6 conflict, 7 too large, 8 busy, 9 no key, 10 not allowed, 11 too many at once, 12 no room, 13 damaged, "
        "130 stopped by Ctrl-C, 1 anything else."
    ),
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # loads slowly

        typer.echo(f"joulemap {version('joulemap')}")
        raise typer.Exit


@app.callback()
def joulemap(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Energy planner for ground robots.

    From a heightmap: a directional cost map, the energy-optimal path, and whether the battery lasts. From measured
    runs: a model of your robot, and what it lacks.
    """


for _panel, _commands in (
    (
        "Plan",
        (
            heightmaps.info,
            maps.costmap,
            paths.path,
            paths.feasibility,
            following.follow,
            paths.tour,
            paths.matrix,
            paths.charging,
            area_questions.field,
            area_questions.reach,
            paths.speeds,
            maps.export,
        ),
    ),
    ("Serve", (services.demo, services.serve, services.warmup, services.openapi)),
    ("Keep", (data_directory.check, data_directory.backup, data_directory.restore, doctor.doctor)),
    (
        "Learn",
        (
            simulation.simulate,
            heightmaps.heightmap,
            models.train,
            models.evaluate,
            models.distill,
            calibration.calibrate,
            calibration.suggest_drive,
        ),
    ),
):
    for _command in _commands:
        app.command(cls=Command, rich_help_panel=_panel)(listed(_command))
app.command("return", cls=Command, rich_help_panel="Plan")(listed(area_questions.point_of_no_return))
app.command("import", cls=Command, rich_help_panel="Learn")(listed(logs.import_logs))
app.add_typer(data_directory.keys, rich_help_panel="Serve")


def main() -> None:
    """Entry point of the distribution."""
    app()


if __name__ == "__main__":
    main()
