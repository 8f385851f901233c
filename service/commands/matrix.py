"""`joulemap matrix`: what it takes to drive between many places."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.options import there
from joulemap.service.commands.remote import Key, MapOrId, Server, served
from joulemap.service.words import energy_words

_SHOWN = 12  # rows of the table

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
    server: Server = None,
    key: Key = None,
    json_file: JsonFile = None,
) -> None:
    """Find the **energies between many places**, each to each other one, or from starts to goals.

    The energies are those of paths over grid moves, as of `joulemap path --no-refine`: one search for each start or
    goal, not one for each pair.

    Examples:

    `joulemap matrix dem.zarr stations.csv --out energies.csv`

    `joulemap matrix dem.zarr robots.csv --goals chargers.csv --only-cheapest --charge 0.4 --reserve 0.1`
    """
    from joulemap.service.commands.path_files import read_path
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.matrix import MatrixRequest, answer, ask

    output = Output(json_file)
    if goals is None and "only_cheapest" in wanted:
        raise typer.BadParameter("--only-cheapest needs --goals: of the starts each is its own cheapest goal")

    def _asked(frame: Any) -> dict[str, Any]:
        values, notes = wanted.on(frame)
        for name, file in (("starts", points), ("goals", goals or points)):
            values[name], more = read_path(file, frame)
            notes += more
        output.warn(dict.fromkeys(notes))
        return values

    if server is not None:
        with served(server, key, costmap) as map_there:
            found = map_there.matrix(**_asked(map_there.grid)).model_dump(mode="json")
    else:
        ground = open_costmap(costmap)
        with progress_bar("Matrix") as report:
            asked = MatrixRequest.of(**_asked(ground.lattice.frame))
            found = answer(ask(ground.planner, asked, progress=report), ground.warnings)
    if goals is None:  # a place is no goal of itself
        found["cheapest"] = [_cheapest_other(row, k) for k, row in enumerate(found["energies_j"])]
    if out is not None:
        write_file(out, _table(found).encode())
    energies = found["energies_j"]
    ways = sum(energy is not None for row in energies for energy in row)
    output.say(f"{ways} ways between {len(energies)} starts and {len(energies[0])} goals", head="Matrix")
    rows = {
        f"from {i}": "no goal is reached" if j is None else f"goal {j} takes least, {energy_words(energies[i][j])}"
        for i, j in list(enumerate(found["cheapest"]))[:_SHOWN]
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
