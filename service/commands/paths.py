"""`joulemap path`, `feasibility`, `tour`, `charging`, `speeds` and `matrix`: routes over a cost map, what they take."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.service.commands.answers import say_feasibility, say_path, say_verdict
from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, write_file
from joulemap.service.commands.options import ModelName, ReadingWithLayers, png, there
from joulemap.service.commands.remote import MapOrId, Remote, refuse_local
from joulemap.service.commands.route_files import PlannedFiles, RouteFiles
from joulemap.service.words import duration_words, energy_words, route_words

if TYPE_CHECKING:
    from joulemap.model.frames import GridFrame


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


def tour(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.tour:TourRequest"],
    json_file: JsonFile = None,
    *,
    route_files: PlannedFiles,
    remote: Remote,
) -> None:
    """Find the **tour of least energy** over several places: the order, the legs, and whether the battery lasts.

    It returns to the first place, unless it is one way; the places keep their order where you ask for it.

    The best order needs the extra `tours` (OR-tools).

    Example:

    `joulemap tour dem.zarr --stop 12,40 180,95 90,20 --charge 0.8 --out tour.geojson`

    `joulemap tour dem.zarr --stop 12,40 180,95 90,20 --charge 0.8 --reserve 0.2 --battery pack.toml`

    `joulemap tour dem.zarr --stop 12,40 180,95 90,20 --in-order --one-way`
    """
    from joulemap.service.questions import tour as question

    output = Output(json_file)
    said = remote.answer(question, costmap, wanted, output, files=route_files.wanted())
    _say_tour(output, said.values, said.robot)


def _say_tour(output: Output, found: dict[str, Any], robot: str) -> None:
    order = found["order"]
    hops = list(zip(order, (*order[1:], order[0]), strict=True))[: len(found["legs"])]
    way = " -> ".join(str(k) for k in (order[0], *(there for _, there in hops)))
    output.say(f"for {robot}: {way}{'' if found['proven'] else ' (not proven the best)'}", head="Tour")
    output.table(
        {f"{here} to {there}": route_words(leg) for (here, there), leg in zip(hops, found["legs"], strict=True)}
        | {"all": route_words(found)}
    )
    say_verdict(output, found["battery"])
    output.warn(found["warnings"])
    output.document(found)


def charging(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.charging:ChargingRequest"],
    json_file: JsonFile = None,
    *,
    remote: Remote,
) -> None:
    """Find the **cheapest way with charging stops**, on which the battery never falls below its reserve.

    At each place is charged what the way to the next one needs, or the battery is swapped for a full one.

    Examples:

    `joulemap charging dem.zarr --start 12,40 --goal 980,950 --at 300,310 --at 620,640 --power 150 --charge 0.4`

    `joulemap charging dem.zarr --start 12,40 --goal 980,950 --at 300,310 --swap 90 --least time`
    """
    from joulemap.service.questions import charging as question

    output = Output(json_file)
    _say_charging(output, remote.answer(question, costmap, wanted, output).values)


def _say_charging(output: Output, found: dict[str, Any]) -> None:
    output.say(head=found["text"], style="bold green" if found["feasible"] else "bold red")
    rows = {}
    for k, leg in enumerate(found["legs"], 1):
        start = "the start" if leg["charger"] is None else f"place {leg['charger'] + 1}"
        charged = ""
        if leg["charged_j"] > 0.0:
            charged = f", charged with {energy_words(leg['charged_j'])} in {duration_words(leg['waits_s'])}"
        rows[f"{k}. from {start}"] = (
            f"{energy_words(leg['energy_j'])}, {leg['length_m']:.0f} m, charge {leg['charge_at_start']:.1%} to "
            f"{leg['charge_at_end']:.1%}{charged}"
        )
    output.table(rows)
    output.warn(found["warnings"])
    output.document(found)


_SPEEDS_SHOWN = 9  # rows of the table, of all speeds


def speeds(
    costmap: MapOrId,
    wanted: Annotated[Wanted, "joulemap.service.questions.speeds:SpeedsRequest"],
    heightmap: Annotated[
        Path | None,
        typer.Argument(metavar="[HEIGHTMAP]", callback=there, help="What the cost map was made of; not with --server."),
    ] = None,
    model: ModelName = "default",
    json_file: JsonFile = None,
    *,
    route_files: RouteFiles,
    remote: Remote,
    reading: ReadingWithLayers,
) -> None:
    """Find the **cheapest cruising speed** of a route, and what time costs in energy.

    Only speeds that the model learned from are tried. `--model` is that of the cost map.

    Examples:

    `joulemap speeds dem.zarr dem.tif --start 12,40 --goal 180,95`

    `joulemap speeds dem.zarr dem.tif --path survey.geojson --model calibrated/ --json -`

    `joulemap speeds dem.zarr dem.tif --start 12,40 --goal 180,95 --deadline 300 --out hurried.plan`
    """
    from joulemap.model.terrain.readers import open_ground
    from joulemap.service.models import find_predictor
    from joulemap.service.questions import speeds as question

    output, files = Output(json_file), route_files.wanted()
    ends = wanted.changed & {"start", "goal"}
    if ("path" in wanted) == bool(ends) or len(ends) == 1:
        raise typer.BadParameter("give either --path, or --start and --goal")
    if remote.server is not None and heightmap is not None:
        raise typer.BadParameter("the service has the heightmap of its cost map: leave it out with --server")
    if remote.server is None and heightmap is None:
        raise typer.BadParameter("name the heightmap that the cost map was made of after the cost map")

    def _ask(planner: Any, asked: Any) -> Any:
        return question.ask(planner, asked, open_ground(heightmap or "", **reading), find_predictor(model))

    _say_speeds(output, remote.answer(question, costmap, wanted, output, files=files, ask=_ask).values)


def _say_speeds(output: Output, found: dict[str, Any]) -> None:
    output.say(found["text"])
    curve = found["curve"]
    step = max(1, (len(curve) - 1) // (_SPEEDS_SHOWN - 1))
    output.table(
        {
            f"{one['speed_mps']:.2f} m/s": f"{energy_words(one['energy_j'])}, {duration_words(one['duration_s'])}"
            for one in curve[::step]
        }
    )
    if (profile := found["profile"]) is not None:
        begins = [0.0, *profile["until_m"]]
        shown = zip(begins, profile["until_m"], profile["speed_mps"], strict=False)
        output.table({f"{begin:.0f} to {end:.0f} m": f"{speed:.2f} m/s" for begin, end, speed in shown})
    output.warn(found["warnings"])
    output.document(found)


_STARTS_SHOWN = 12  # rows of the table

_KINDS = "CSV with columns x_m,y_m, or latitude and longitude, or lines x,y; or another file that --path takes"


def matrix(
    costmap: MapOrId,
    points: Annotated[Path, typer.Argument(metavar="POINTS.csv", callback=there, help=f"The starts: {_KINDS}.")],
    wanted: Annotated[Wanted, "joulemap.service.questions.matrix:MatrixRequest -starts -goals"],
    goals: Annotated[
        Path | None,
        typer.Option(metavar="FILE", callback=there, help="The goals, as the starts. [default: the starts]"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.csv", help="Write a line for each start and goal.")
    ] = None,
    json_file: JsonFile = None,
    *,
    remote: Remote,
) -> None:
    """Find the **energies between many places**, each to each other one, or from starts to goals.

    The energies are those of paths over grid moves, as of `joulemap path --no-refine`: one search for each start or
    goal, not one for each pair.

    Examples:

    `joulemap matrix dem.zarr stations.csv --out energies.csv`

    `joulemap matrix dem.zarr robots.csv --goals chargers.csv --only-cheapest --charge 0.4 --reserve 0.1`
    """
    from joulemap.service.commands.path_files import read_path
    from joulemap.service.questions import matrix as question

    output = Output(json_file)
    if goals is None and "only_cheapest" in wanted:
        raise typer.BadParameter("--only-cheapest needs --goals: of the starts each is its own cheapest goal")

    def _read(values: dict[str, Any], frame: GridFrame) -> list[str]:
        values["starts"], notes = read_path(points, frame)
        values["goals"], more = read_path(goals or points, frame)
        return [*notes, *more]

    found = remote.answer(question, costmap, wanted, output, also=_read).values
    if goals is None:  # a place is no goal of itself
        found["cheapest"] = [_cheapest_other(row, k) for k, row in enumerate(found["energies_j"])]
    if out is not None:
        write_file(out, _table(found).encode())
    energies = found["energies_j"]
    ways = sum(energy is not None for row in energies for energy in row)
    output.say(f"{ways} ways between {len(energies)} starts and {len(energies[0])} goals", head="Matrix")
    rows = {
        f"from {i}": "no goal is reached" if j is None else f"goal {j} takes least, {energy_words(energies[i][j])}"
        for i, j in list(enumerate(found["cheapest"]))[:_STARTS_SHOWN]
    }
    output.table(rows | ({} if out is None else {"written": str(out)}))
    output.warn(found["warnings"])
    output.document({**found, "out": None if out is None else str(out)})


def _cheapest_other(energies: list[float | None], own: int) -> int | None:
    known = [(energy, k) for k, energy in enumerate(energies) if energy is not None and k != own]
    return min(known)[1] if known else None


def _table(found: dict[str, Any]) -> str:
    """A line for each start and goal; what is not known is left empty."""
    columns = {"energies_j": "energy_j", "lengths_m": "length_m", "energies_p05_j": "energy_p05_j"}
    columns |= {"energies_p95_j": "energy_p95_j", "probabilities": "probability", "reasons": "reason"}
    known = [name for name in columns if found[name] is not None]
    text = StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(["start", "goal", *(columns[name] for name in known)])
    for i, row in enumerate(found["energies_j"]):
        lines.writerows([i, j, *(found[name][i][j] for name in known)] for j in range(len(row)))
    return text.getvalue()
