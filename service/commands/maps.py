"""`joulemap costmap`: from a heightmap to a cost map, here or in a service; `joulemap export`: for other programs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from joulemap.model.errors import TooLargeError
from joulemap.service.commands.answers import say_map, served_map
from joulemap.service.commands.console import (
    RUNNING,
    JsonFile,
    Output,
    check_origin,
    leaves_nothing_behind,
    progress_bar,
    with_option_names,
    write_file,
)
from joulemap.service.commands.options import (
    HeightmapArgument,
    ModelName,
    Overwrite,
    ReadingWithLayers,
    RobotFile,
    png,
    refuse_to_replace,
    robot_of,
    robot_words,
)
from joulemap.service.commands.paths import FROM_DISK
from joulemap.service.commands.remote import MapOrId, Remote, Scheduler, costmap_there, refuse_local, unpack

if TYPE_CHECKING:
    from joulemap.model.frames import GridFrame


MOST_VALUES = 400_000_000
"""Most rows x columns x headings of a cost map unless the user allows more: the limit of `planner.lattice.build` for a
lattice in memory, so that `joulemap path` can read what was made."""

_BYTES_PER_VALUE = 8  # a price and its uncertainty, float32 each
_WORTH_SAYING = 20_000_000  # values: more take longer than some seconds


@dataclass(frozen=True)
class MapFiles:
    """The folder and the files that a cost map is written to."""

    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="MAP.zarr", help="Folder to write the cost map to; optional with --server."),
    ] = None
    geotiff: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also write a GeoTIFF: by heading, energies [J/m] and blocked reasons."),
    ] = None
    npz: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write a NumPy .npz.")] = None
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=png, help="Also draw it, mean over headings (PNG).")
    ] = None
    overwrite: Overwrite = False

    def check(self) -> None:
        """Refuse a folder that is there already, or that none can be made at."""
        from joulemap.planner.lattice.folder import LatticeFolder

        if self.out is not None:
            refuse_to_replace(self.out, overwrite=self.overwrite)
            LatticeFolder(self.out).check_place()

    def others(self, folder: Path) -> None:
        """Write the other files of a cost map; it is only read, as a whole, when one is wanted."""
        if self.geotiff is None and self.npz is None and self.picture is None:
            return
        from joulemap.planner.lattice.loading import load_lattice
        from joulemap.planner.lattice.npz import export_npz
        from joulemap.service.exports.maps import save_map
        from joulemap.service.render.pictures import lattice_image

        lattice = load_lattice(folder)
        if self.geotiff is not None:
            save_map(lattice, self.geotiff, "geotiff")
        for place, make in ((self.npz, export_npz), (self.picture, lattice_image)):
            if place is not None:
                write_file(place, make(lattice))


def costmap(
    heightmap: HeightmapArgument,
    wanted: Annotated[dict[str, Any], "joulemap.service.questions.costmap:CostmapCells"],
    files: MapFiles,
    robot: RobotFile = None,
    model: ModelName = "default",
    max_values: Annotated[
        int,
        typer.Option(
            min=1,
            metavar="N",
            help="Most values (rows x columns x headings) of the cost map, up to 8 bytes each on disk.",
        ),
    ] = MOST_VALUES,
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
    *,
    remote: Remote,
    reading: ReadingWithLayers,
) -> None:
    """Make a **cost map**: energy per metre for every cell and heading, where the robot cannot go, and why.

    Examples:

    `joulemap costmap dem.tif --robot robot.toml --out dem.zarr`

    `joulemap costmap heights.png --resolution 0.5 --scale 0.01 --model physics --out heights.zarr`

    `joulemap costmap dem.tif --layer kinds=land.tif --legend land.toml --layer obstacles=map.yaml --out dem.zarr`
    """
    from joulemap.model.terrain.plausible import heightmap_warnings
    from joulemap.model.terrain.readers import ASKED_FOR, open_ground
    from joulemap.service.storage.stats import frame_values

    output, out = Output(json_file), files.out
    files.check()
    if remote.server is not None:
        refuse_local(geotiff=files.geotiff, npz=files.npz, picture=files.picture, scheduler=scheduler)
        with remote.client() as service, progress_bar("Cost map") as report:
            over = {"layers": _one_of_each(reading.pop("layers")), "legend": reading.pop("legend")}
            sent = service.heightmap(heightmap, **reading)
            output.warn(sent.notes)
            map_there = service.costmap(sent.id, robot=robot, model=model, progress=report, **wanted, **over)
            if out is not None:
                unpack(map_there.data("zarr"), out)
        document = served_map(map_there, out)
        name, by = document["robot"]["name"], document["model"]
        output.say(f"{map_there.id} of {sent.name} for {name}, model {by}", head="Cost map")
        say_map(output, document)
        output.document(document)
        return
    if out is None:
        raise typer.BadParameter("--out is missing: name the folder to write the cost map to")
    ground = open_ground(heightmap, **reading)
    for note in ground.notes:
        if note.startswith(ASKED_FOR):
            output.say(with_option_names(note, RUNNING.get()), head="Heightmap")
        else:
            output.warn([note])
    rover = robot_of(robot)
    with ThreadPoolExecutor(1) as reader:
        warned = reader.submit(heightmap_warnings, ground)
        from joulemap.service.analysis.cost_lattices import (  # slowly; the map is read meanwhile
            load_kernels,
            write_cost_lattice,
        )

        _say_size(output, ground.frame, max_values, **wanted)
        if scheduler is None:
            load_kernels(model, rover)
    output.warn(warned.result())
    with leaves_nothing_behind(), progress_bar("Cost map") as report:
        how: dict[str, Any] = {"model": model, "progress": report, **wanted}
        if scheduler is not None:
            written = costmap_there(scheduler, out, heightmap, reading=reading, robot=rover.as_dict(), **how)
        else:
            written = write_cost_lattice(out, ground, rover, **how)
    frame, provenance = written.frame, written.provenance
    if frame.rows * frame.cols > FROM_DISK:
        from joulemap.planner.stored_planner import StoredPlanner

        with progress_bar("Coarse level") as report:
            StoredPlanner(out).prepare(progress=report)
    files.others(out)
    output.say(f"of {ground.source} for {rover.name}, model {provenance['model']['name']}", head="Cost map")
    document = {
        "heightmap": {**provenance["heightmap"], "rows": ground.frame.rows, "cols": ground.frame.cols},
        **frame_values(frame, side="spacing_m"),
        "headings": wanted["headings"],
        "robot": written.robot.as_dict(),
        "provenance": provenance,
        "warnings": provenance["warnings"],
        "out": str(out),
        **written.figures,
    }
    say_map(output, document, robot=robot_words([rover]))
    output.document(document)


def _one_of_each(layers: dict[str, list[str]] | None) -> dict[str, str]:
    """Layers as a service takes them."""
    several = next((files for files in (layers or {}).values() if len(files) > 1), None)
    if several is not None:
        raise typer.BadParameter(
            f"a service takes one layer of each kind, and got {', '.join(several)}: make the cost map without --server",
            param_hint="--layer",
        )
    return {role: file for role, (file,) in (layers or {}).items()}


def _say_size(output: Output, ground: GridFrame, max_values: int, *, spacing_m: float, headings: int) -> None:
    """Say how large a large cost map will be. Raises TooLargeError above `max_values`."""
    from joulemap.service.analysis.cost_lattices import check_lattice

    tiling = check_lattice(ground, spacing_m=spacing_m, headings=headings)
    size = (
        f"{tiling.frame.rows:,} x {tiling.frame.cols:,} cells of {spacing_m:g} m with {headings} headings: "
        f"{tiling.values:,} values, up to {_BYTES_PER_VALUE * tiling.values / 1e9:.1f} GB on disk"
    )
    if tiling.values > max_values:
        coarser = spacing_m * (tiling.values / max_values) ** 0.5
        raise TooLargeError(
            f"{size}. The limit is {max_values:,} values: choose a coarser --spacing (about {coarser:.2g} m), fewer "
            f"--headings, or allow it with --max-values {tiling.values}",
            values=tiling.values,
            limit=max_values,
        )
    if tiling.values > _WORTH_SAYING:
        output.say(size)


def export(
    costmap: MapOrId,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FILE",
            help="Suffix .tif (GeoTIFF), .cog.tif (cloud-optimised), .yaml (Nav2 map, its image beside it) or "
            ".graph.geojson (Nav2 route graph).",
        ),
    ],
    format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Whatever the suffix: geotiff, cog, nav2-map, nav2-graph."),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            "--origin",
            metavar="X,Y",
            callback=check_origin,
            help="Of Nav2 formats: the place that gets the coordinates 0,0 [m].",
        ),
    ] = None,
    json_file: JsonFile = None,
    *,
    remote: Remote,
) -> None:
    """Write a **cost map for another program**: GIS (GeoTIFF), Nav2 (map, route graph).

    Examples:

    `joulemap export dem.zarr --out site.yaml`

    `joulemap export dem.zarr --out site.cog.tif`
    """
    from joulemap.planner.lattice.loading import load_lattice
    from joulemap.service.exports.formats import format_of
    from joulemap.service.exports.maps import MAP_FORMATS, ZIP, save_map

    output, chosen = Output(json_file), format_of(MAP_FORMATS, out, format)
    if remote.server is not None:
        if chosen.media_type == ZIP and out.suffix != ".zip":
            raise typer.BadParameter(f"a service answers {chosen.name} as a zip: let --out end with .zip")
        with remote.client() as service:
            write_file(out, service.open_costmap(str(costmap)).data(chosen.name, origin=origin))
        written = [out]
    else:
        with progress_bar("Export"):
            written = save_map(load_lattice(costmap), out, chosen.name, origin=origin)
    output.say(f"{', '.join(map(str, written))}: {chosen.words}", head="Written")
    output.document({"format": chosen.name, "written": [str(path) for path in written]})
