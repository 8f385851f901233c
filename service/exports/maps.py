"""The formats of whole cost maps: name, suffix and function of each. Adding one is a module and a line here."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from joulemap.model.errors import InputError, nearest_name
from joulemap.planner.lattice import CostLattice


@dataclass(frozen=True)
class MapFormat:
    """A format that cost maps are written in.

    Attributes
    ----------
    name : str
        Value of `format`.
    suffix : str
        How its file ends, or the first of its files.
    media_type : str
        For HTTP; of several files, a zip.
    words : str
        What it is for.
    home : str
        Module and function, "module:function".
    """

    name: str
    suffix: str
    media_type: str
    words: str
    home: str


ZIP = "application/zip"
MAP_FORMATS: dict[str, MapFormat] = {
    known.name: known
    for known in (
        MapFormat(
            "geotiff", ".tif", "image/tiff", "energies, blocked reasons, deviations by heading", "costmap_raster:write"
        ),
        MapFormat("cog", ".cog.tif", "image/tiff", "the same, cloud-optimised", "costmap_raster:write_cloud_optimised"),
        MapFormat("nav2-map", ".yaml", ZIP, "map for Nav2's map server (YAML and PGM)", "nav2_map:write"),
        MapFormat(
            "nav2-graph", ".graph.geojson", "application/geo+json", "graph for Nav2's route server", "nav2_graph:write"
        ),
    )
}
"""Name -> format, in the order of documents."""


def map_format_of(file: str | Path, name: str | None = None) -> MapFormat:
    """Return the format of a file that is to be written."""
    if name is not None:
        if name in MAP_FORMATS:
            return MAP_FORMATS[name]
        near = nearest_name(name, MAP_FORMATS)
        hint = f"; did you mean {near}?" if near else "."
        raise InputError(f"there is no map format {name!r}{hint} Known are {', '.join(MAP_FORMATS)}", format=name)
    found = [known for known in MAP_FORMATS.values() if str(file).lower().endswith(known.suffix)]
    if not found:
        suffixes = ", ".join(f"{known.suffix} ({known.words})" for known in MAP_FORMATS.values())
        raise InputError(
            f"the name {Path(file).name!r} does not say what to write: let it end with one of {suffixes}, or give "
            "`format`",
            path=str(file),
        )
    return max(found, key=lambda known: len(known.suffix))


def map_files(lattice: CostLattice, chosen: MapFormat) -> dict[str, bytes]:
    """Return a cost map in a format.

    Result: suffix -> content of each file. "{stem}" in a text stands for their common name.
    """
    module, function = chosen.home.split(":")
    found: dict[str, bytes] = getattr(import_module(f"{__package__}.{module}"), function)(lattice)
    return found


def save_map(lattice: CostLattice, file: str | Path, name: str | None = None) -> list[Path]:
    """Write a cost map for another program."""
    chosen, path = map_format_of(file, name), Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    files = map_files(lattice, chosen)
    first = next(iter(files))
    written = [path if suffix == first else path.with_suffix(suffix) for suffix in files]
    for place, content in zip(written, files.values(), strict=True):
        place.write_bytes(named(content, path.stem) if len(files) > 1 else content)
    return written


def named(content: bytes, stem: str) -> bytes:
    """Return the content of one of several files, with their common name in it."""
    return content.replace(b"{stem}", stem.encode()) if content.startswith(b"#") else content


def zipped(files: Mapping[str, bytes], stem: str) -> bytes:
    """Return files as one zip file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for suffix, content in files.items():
            archive.writestr(f"{stem}{suffix}", named(content, stem))
    return out.getvalue()
