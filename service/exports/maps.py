"""The formats of whole cost maps: name, suffix and function of each. Adding one is a module and a line here."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from joulemap.planner.lattice import CostLattice
from joulemap.service.exports.formats import Format, check_origin, format_of, lattice_from

ZIP = "application/zip"
MAP_FORMATS: dict[str, Format] = {
    known.name: known
    for known in (
        Format(
            "geotiff", ".tif", "image/tiff", "energies, blocked reasons, deviations by heading", "costmap_raster:write"
        ),
        Format("cog", ".cog.tif", "image/tiff", "the same, cloud-optimised", "costmap_raster:write_cloud_optimised"),
        Format("nav2-map", ".yaml", ZIP, "map for Nav2's map server (YAML and PGM)", "nav2_map:write"),
        Format(
            "nav2-graph", ".graph.geojson", "application/geo+json", "graph for Nav2's route server", "nav2_graph:write"
        ),
    )
}
"""Name -> format, in the order of documents."""


def map_files(lattice: CostLattice, chosen: Format, *, origin: str | Sequence[float] | None = None) -> dict[str, bytes]:
    """Return a cost map in a format.

    Result: suffix -> content of each file. "{stem}" in a text stands for their common name.
    """
    check_origin(origin, chosen.name)
    if origin is not None:
        lattice = lattice_from(lattice, origin)
    found: dict[str, bytes] = chosen.write(lattice)
    return found


def save_map(
    lattice: CostLattice,
    file: str | Path,
    name: str | None = None,
    *,
    origin: str | Sequence[float] | None = None,
) -> list[Path]:
    """Write a cost map for another program."""
    chosen, path = format_of(MAP_FORMATS, file, name), Path(file)
    files = map_files(lattice, chosen, origin=origin)
    path.parent.mkdir(parents=True, exist_ok=True)
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


class _Sink(bytearray):
    """What a zip file is written to that nobody seeks in."""

    def write(self, data: bytes) -> int:
        self.extend(data)
        return len(data)

    def flush(self) -> None:
        pass


def zip_folder(folder: Path) -> Iterator[bytes]:
    """Yield a folder as a zip file, chunk by chunk, without a second copy on disk or in memory.

    Files are stored, not compressed: the chunks of a lattice are compressed already.
    """
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_STORED) as archive:  # type: ignore[call-overload]
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(path, path.relative_to(folder.parent))
            yield bytes(sink)
            sink.clear()
    yield bytes(sink)
