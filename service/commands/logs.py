"""`joulemap import`: logs of any known format as CSV files in joulemap's columns and units."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from joulemap.model.runs.formats import formats_in_words
from joulemap.service.commands.console import JsonFile, Output, progress_bar, write_file
from joulemap.service.commands.drives import OdometryTrack
from joulemap.service.commands.options import Overwrite, stem_of, there
from joulemap.service.words import duration_words, runs_words


def import_logs(
    logs: Annotated[list[str], typer.Argument(metavar="LOG...", help="Files, folders or patterns like 'logs/*.mcap'.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FOLDER", help="Where to write a CSV file for each log. [default: only look]"),
    ] = None,
    entries: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="COLUMN=SOURCE",
            help="Where a column is taken from, with a unit or factor: 't=timestamp_ms:ms,current=batt_mA:mA'. Several "
            "are summed with signs: 'current=left+right', 'current=-pack'. A field of a message: "
            "'voltage=/battery.voltage'.",
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option("--mapping", metavar="FILE", callback=there, help="TOML file of such entries."),
    ] = None,
    odometry: OdometryTrack = None,
    accept_implausible: Annotated[
        bool,
        typer.Option("--accept-implausible", help="Keep numbers that are hardly in the units that they are read in."),
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            metavar="PNG",
            help="Draw the track of a log and the power along it; of several, name a folder.",
        ),
    ] = None,
    memory: Annotated[float, typer.Option(min=100.0, metavar="MB", help="Memory that a log may take [MB].")] = 4000.0,
    overwrite: Overwrite = False,
    json_file: JsonFile = None,
) -> None:
    """Read **logs of other programs** and write them in joulemap's columns and units, for `--runs`.

    The format is recognised by the content: CSV of any shape, Parquet, MCAP, ROS bags, ArduPilot, MAVLink, PX4, FIT.
    Columns and topics are found by their names, units and types; the answer says what was taken from where. All logs
    are written or none. What is implausible, such as 3,000 A at 24 V, is said before anything is written.

    Examples:

    `joulemap import drive.mcap`

    `joulemap import logs/*.csv --map t=timestamp_ms:ms,current=batt_current_mA:mA --out runs`

    `joulemap import flight.bin --out runs && joulemap evaluate --runs runs --heightmap dem.tif`
    """
    from joulemap.model.errors import ConflictError
    from joulemap.model.runs.files import distinct_names
    from joulemap.model.runs.mapping import read_mapping
    from joulemap.model.runs.odometry import Odometry
    from joulemap.service.intake.importing import import_logs as read_all
    from joulemap.service.intake.limits import RunReading
    from joulemap.service.library.run_files import find_run_files

    output = Output(json_file)
    if wrong := next((entry for entry in entries or () if "=" not in entry), None):
        raise typer.BadParameter(f"{wrong!r} is no COLUMN=SOURCE; a file of them is for --mapping", param_hint="--map")
    wanted = (read_mapping(mapping) if mapping is not None else {}) | read_mapping(entries)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        files = find_run_files(logs, trial=False)
    again = [str(each.message) for each in caught]
    stems = [stem_of(name) for name in distinct_names(files)]
    if len(set(stems)) < len(stems):
        stems = [stem_of(name).replace(".", "_") for name in distinct_names(files)]
        stems = [f"{stem}_{file.suffix[1:]}" for stem, file in zip(stems, files, strict=True)]
    if out is not None and out.is_file():
        raise ConflictError(f"{out} is a file: give a folder for the CSV files", path=str(out))
    if out is not None and not overwrite:
        taken = next((out / f"{stem}.csv" for stem in stems if (out / f"{stem}.csv").exists()), None)
        if taken is not None:
            raise ConflictError(
                f"{taken} is there already: choose another folder, or replace it with --overwrite", path=str(taken)
            )
    with progress_bar("Logs") as report:
        found = read_all(
            list(zip(stems, files, strict=True)),
            out,
            reading=RunReading(Odometry(odometry) if odometry is not None else None, wanted, accept_implausible),
            memory_mb=memory,
            picture=picture is not None,
            report=report,
        )
    for one in found:
        _say(output, one)
    output.warn(again)
    if picture is not None:
        _draw(output, picture, stems, found)
    if out is None:
        output.say(f"Nothing was written: --out FOLDER writes {runs_words(len(found))}")
    output.document({"runs": found})


def _say(output: Output, one: dict[str, Any]) -> None:
    from joulemap.model.runs.consistency import unused_columns
    from joulemap.model.runs.words import count_words

    unit = "J/m" if one["target"] == "energy_j" else "A s/m"
    columns = ", ".join(unused_columns(one["columns"]))[:300]
    by = f", by distance: it has no positions{columns and f' (unused columns: {columns})'}"
    usual = "" if one["per_m"] is None else f" in {one['segments']} segments, median {one['per_m']:.4g} {unit}"
    output.say(f"{one['format']}" + (f" -> {one['out']}" if one["out"] else ""), head=one["name"])
    rows = {
        "rows": f"{one['rows']:,} in {duration_words(one['seconds'])}",
        "driven": f"{one['metres']:.1f} m{usual}" + ("" if one["placed"] else by),
    }
    if one["energy_j"] is not None:
        rounded = f" (standard deviation {one['energy_std_j']:,.0f} J, by rounding)" if one["energy_std_j"] else ""
        rows["energy"] = f"{one['energy_j']:,.0f} J{rounded}"
    if one["unknown_seconds"]:
        rows["not measured"] = f"{one['unknown_seconds']:.1f} s, interpolated"
    sure = one["confidence"]
    rows |= {
        column: f"from {source}" + (f", {sure[column]:.0%} sure" if sure.get(column, 1.0) < 0.9 else "")
        for column, source in one["reading"].items()
    }
    if one["repairs"]:
        rows["repairs"] = count_words(one["repairs"])
    output.table(rows)
    shown = one["first_rows"]
    output.say("  ".join(f"{key:>12}" for key in shown))
    for cells in zip(*shown.values(), strict=True):
        output.say("  ".join(f"{'' if cell is None else f'{cell:.10g}':>12}" for cell in cells))
    output.warn(f"{one['name']}: {warning}" for warning in one["warnings"])


def _draw(output: Output, picture: Path, stems: list[str], found: list[dict[str, Any]]) -> None:
    from joulemap.service.render.run_picture import run_picture

    if len(found) > 1:
        picture.mkdir(parents=True, exist_ok=True)
    for stem, one in zip(stems, found, strict=True):
        place = picture / f"{stem}.png" if picture.is_dir() else picture
        write_file(place, run_picture(one["name"], one.pop("track"), charge=one["target"] != "energy_j"))
        output.say(f"Drawn: {place}")


import_logs.__doc__ = (import_logs.__doc__ or "") + f"\n    Formats: {formats_in_words()}.\n"
