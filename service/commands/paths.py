"""`joulemap path` and `feasibility`: a route over a cost map, and whether the battery lasts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.answers import say_feasibility, say_path
from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, write_file
from joulemap.service.commands.options import png
from joulemap.service.commands.remote import MapOrId, Remote, refuse_local
from joulemap.service.commands.route_files import PlannedFiles

FROM_DISK = 2_000_000
"""Cells above which one question is answered from the cost map's folder: reading all of it would take longer."""

Memory = Annotated[
    float | None,
    typer.Option(
        min=0.05,
        metavar="GB",
        help=f"Plan on the map from disk, in so much memory. [default: 1.5 for maps above {FROM_DISK:,} cells]",
    ),
]


def _memory_for(costmap: Path, wanted: Wanted) -> float | None:
    """Memory [GB] for a question to a map that is better not read as a whole; None for others."""
    from joulemap.planner.lattice.stored_lattice import StoredLattice
    from joulemap.planner.on_disk.tiled_table import DEFAULT_MEMORY
    from joulemap.service.schemas.base import WholeMap

    fields = wanted.request.model_fields
    if any(WholeMap() in fields[name].metadata for name in wanted.changed if name in fields):
        return None
    return DEFAULT_MEMORY / 1e9 if StoredLattice(costmap).cells > FROM_DISK else None


def path(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.path:PathRequest -battery"],
    memory: Memory = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=png,
            help="Draw all paths, and the profiles of the energy-optimal and the shortest one (PNG).",
        ),
    ] = None,
    json_file: JsonFile = None,
    *,
    route_files: PlannedFiles,
    remote: Remote,
) -> None:
    """Find the **energy-optimal path** on a cost map, and what it saves against the shortest path.

    Examples:

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --picture path.png`

    `joulemap path dem.zarr --start 36.7201,-4.4903 --goal 36.7215,-4.4871 --out path.gpx --out path.plan`

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --objective quantile --quantile 0.95 --max-power 250`

    `joulemap path dem.zarr --start 12.5,40 --goal 180,95 --planner bitstar --time-limit 10 --json -`
    """
    from joulemap.service.questions import path as question

    output, files = Output(json_file), route_files.wanted()
    _check_objective(wanted)
    if wanted.typed["objective"] == "arrival":
        raise typer.BadParameter("arriving depends on the battery: ask `joulemap feasibility --objective arrival`")
    if remote.server is not None:
        refuse_local(memory=memory, picture=picture)
    elif memory is None and picture is None:
        memory = _memory_for(costmap, wanted)
    said = remote.answer(question, costmap, wanted, output, files=files, memory_gb=memory)
    say_path(output, said.values, said.robot, bound=wanted.typed["bound"])
    output.document(said.values)
    if picture is not None:
        from joulemap.service.render.pictures import route_picture

        plan, lattice = said.found.plan, said.ground.lattice
        source = lattice.provenance.get("heightmap", {}).get("source")
        title = f"Path for {said.robot}" + (f" on {source}" if source not in (None, "memory") else "")
        drawn = route_picture(lattice, plan.route, plan.shortest, title=title, alternatives=plan.others)
        write_file(picture, drawn)


def _check_objective(wanted: Wanted) -> None:
    """Refuse a quantile that would not count."""
    if "quantile" in wanted and "objective" not in wanted:
        raise typer.BadParameter(
            f"a quantile of {wanted.typed['quantile']:g} counts with --objective quantile only: give both",
            param_hint="--quantile",
        )


def feasibility(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.feasibility:FeasibilityRequest"],
    memory: Memory = None,
    json_file: JsonFile = None,
    *,
    remote: Remote,
) -> None:
    """Say whether the **battery lasts**, for the best route between two points or for a given path.

    The verdict is yes (95 % likely, or more), likely (two thirds), marginal (one third) or no. The exit code is 0 for
    all of them: "no" is an answer, not an error (`verdict` and `feasible` in the JSON).

    Examples:

    `joulemap feasibility dem.zarr --start 12,40 --goal 180,95 --round-trip --charge 0.6 --reserve 0.2`

    `joulemap feasibility dem.zarr --path survey.geojson --charge 0.8`

    `joulemap feasibility dem.zarr --path survey.geojson --charge 0.8 --battery pack.toml`

    `joulemap feasibility dem.zarr --start 12,40 --goal 180,95 --charge 0.3 --objective arrival`
    """
    from joulemap.service.questions import feasibility as question

    output = Output(json_file)
    _check_objective(wanted)
    if remote.server is not None:
        refuse_local(memory=memory)
    elif memory is None:
        memory = _memory_for(costmap, wanted)
    said = remote.answer(question, costmap, wanted, output, memory_gb=memory)
    say_feasibility(output, said.values)
    output.document({**said.values, "round_trip": wanted.typed["round_trip"]})
