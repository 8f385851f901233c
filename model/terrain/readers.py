"""Read a heightmap from a file or from bytes, in any of the formats of the registry."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.cut_out import PartReader, cells_of, transform_of
from joulemap.model.terrain.decoded import MAX_SIDE, check_cells
from joulemap.model.terrain.formats import FORMATS, formats_in_words
from joulemap.model.terrain.formats.contract import HeightmapFormat
from joulemap.model.terrain.formats.zipped import unpacked
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.reproject import reproject_file
from joulemap.model.terrain.stated_frame import Reading, stated_frame
from joulemap.model.terrain.windows import Ground, HeightmapFile

MAX_CELLS = 400_000_000
"""Default limit of declared cells: 1.6 GB of float32."""

ASKED_FOR = ("reprojected from", "a window")
"""What notes begin with that tell of what the user asked for."""

LayerFiles = Mapping[str, str | Path | bytes | Sequence[str | Path]]
"""Files of layers, or the bytes of one, by what they are of."""

_HEAD_BYTES = 512
_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # a Path has lost one of the slashes


def read_sent(
    source: str | Path | bytes, *, max_cells: int = MAX_CELLS, alone: bool = True, **options: Any
) -> Heightmap:
    """Read a heightmap that somebody else sent: no other file is opened, whatever it names, and nobody is warned.

    Parameters
    ----------
    source : str, Path or bytes
        The file, or all its bytes.
    max_cells : int, optional
        Largest number of cells.
    alone : bool, optional
        Whether files that lie beside it, or that it names, stay closed.
    **options
        Fields of `Reading`, and `filename`, `layers` and `legend`, as `joulemap.read_heightmap` takes them.

    Returns
    -------
    Heightmap
        Heights and their place; what is to be known of them is in its `notes`.

    Raises
    ------
    HeightmapError
        If the file cannot be read, is no heightmap, does not lie on a north-up square grid of true metres, or holds no
        known cell.
    TooLargeError
        If it declares more than `max_cells` cells; no memory is allocated for them.
    """
    over = {key: options.pop(key, None) for key in ("layers", "legend", "layer_names")}
    file = source_of(source, options.pop("filename", None), alone=alone)
    ground = _with_layers(_ground(file, max_cells, max_cells, Reading(**options)), **over)
    if isinstance(ground, Heightmap):
        return ground
    rows, cols = ground.frame.shape
    heights = ground.window(0, rows, 0, cols).heights
    same = ("source", "notes", "given_noise_m", "given_noise_length_m", "layers")
    return Heightmap(heights, ground.frame, **{name: getattr(ground, name) for name in same})


def open_ground(path: str | Path, *, alone: bool = False, **options: Any) -> Ground:
    """Open a heightmap of any size: read by windows where its format can, and as a whole otherwise.

    Parameters
    ----------
    path : str or Path
        The file.
    alone : bool, optional
        Whether files that lie beside it, or that it names, stay closed.
    **options
        As of `read_sent`.

    Returns
    -------
    Ground
        A `Heightmap`, or a `HeightmapFile`.

    Raises
    ------
    HeightmapError
        As `read_sent`. What only the heights show is found when they are read.
    TooLargeError
        If the file is read as a whole and declares more than `MAX_CELLS` cells.
    """
    over = {key: options.pop(key, None) for key in ("layers", "legend", "layer_names")}
    source = source_of(path, options.pop("filename", None), alone=alone)
    return _with_layers(_ground(source, MAX_SIDE * MAX_SIDE, MAX_CELLS, Reading(**options)), **over)


def _with_layers(
    ground: Heightmap | HeightmapFile,
    layers: LayerFiles | None,
    legend: str | Path | Mapping[str, Any] | None,
    layer_names: Mapping[str, str] | None,
) -> Heightmap | HeightmapFile:
    if not layers and legend is None:
        return ground
    from joulemap.model.terrain.layers.reading import read_layers  # which builds on this module

    return ground.with_layers(read_layers(layers or {}, ground.frame, legend=legend, names=layer_names or {}))


def _ground(source: SourceFile, max_cells: int, max_cells_whole: int, reading: Reading) -> Heightmap | HeightmapFile:
    """A file of up to `max_cells` cells, of `max_cells_whole` where its format is only read as a whole."""
    scaling, window, noise = reading.scaling, reading.window, (reading.noise_m, reading.noise_length_m)
    file, kind = recognised(source)
    if reading.nearest and reading.reproject is None:  # a layer lies as it likes: in degrees, rotated
        try:
            return _ground(source, max_cells, max_cells_whole, replace(reading, nearest=False))
        except HeightmapError as error:
            try:
                return _ground(source, max_cells, max_cells_whole, replace(reading, reproject="auto"))
            except HeightmapError:
                raise error from None
    if reading.reproject is not None:
        warped, scaling = reproject_file(
            file, kind, reading, reading.reproject, max_cells=max_cells, max_cells_whole=max_cells_whole
        )
        return HeightmapFile(warped, scaling, stated_frame(warped, Reading()), file.name, warped.notes, *noise)
    most = max_cells if window is None else MAX_SIDE * MAX_SIDE
    reader = kind.open_windows(file, scaling, band=reading.band, max_cells=most)
    whole = reader or kind.code.decode(file, scaling, max_cells=max_cells_whole, band=reading.band)
    frame, part, notes = stated_frame(whole, reading), whole, whole.notes
    if window is not None:
        cells = cells_of(window, frame.crs, transform_of(frame), frame.shape)
        part, frame = PartReader(whole, cells), frame.window(cells.row0, cells.row1, cells.col0, cells.col1)
        check_cells(frame.rows, frame.cols, max_cells, what=f"the window of {file.name}")
        notes = (*notes, _window_note(frame))
    if reader is not None:
        return HeightmapFile(part, scaling, frame, file.name, notes, *noise)
    heights = part.read(scaling, slice(0, frame.rows), slice(0, frame.cols)).copy()
    return Heightmap(heights, frame, file.name, notes=notes, given_noise_m=noise[0], given_noise_length_m=noise[1])


def _window_note(frame: GridFrame) -> str:
    west, south, east, north = frame.bounds
    return f"{ASKED_FOR[1]} of the file was read: x {west:.2f}..{east:.2f}, y {south:.2f}..{north:.2f}"


def recognised(source: SourceFile) -> tuple[SourceFile, HeightmapFormat]:
    """Return a file, out of its archive where it is in one, and its format.

    Parameters
    ----------
    source : SourceFile
        The file.

    Returns
    -------
    tuple of SourceFile and HeightmapFormat
        Unpacked, and how it is read.
    """
    file = unpacked(source, tuple(suffix for each in FORMATS for suffix in each.suffixes))
    return file, _format_of(file)


def source_of(source: str | Path | bytes, filename: str | None, *, alone: bool) -> SourceFile:
    """Return a file, or bytes, to be read.

    Parameters
    ----------
    source : str, Path or bytes
        The file, or its bytes.
    filename : str or None
        Its name, where it has another one.
    alone : bool
        Whether it may open no other file.

    Returns
    -------
    SourceFile
        Not read yet.
    """
    if isinstance(source, bytes):
        return SourceFile(source, filename or "bytes", source[:_HEAD_BYTES], alone=True)
    if _URL.match(str(source)):
        raise HeightmapError(
            f"{str(source)[:200]} is a URL: joulemap reads files and asks no other machine. Download it "
            f"(curl -L -o dem.tif '{str(source)[:200]}'), and give the file; `window` (--window) reads a part of it",
            url=str(source)[:200],
        )
    place = Path(source).resolve()
    if place.is_dir():
        raise HeightmapError(f"{source} is a folder: a heightmap is one file, such as dem.tif", path=str(source))
    if not place.is_file():
        raise HeightmapError(f"there is no file {source}", path=str(source))
    try:
        with place.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        raise HeightmapError(f"the file {source} cannot be read: {error.strerror}", path=str(source)) from error
    return SourceFile(place, filename or place.name, head, alone=alone)


def _format_of(file: SourceFile) -> HeightmapFormat:
    if not file.head:
        raise HeightmapError(f"{file.name} is empty", name=file.name)
    for each in FORMATS:  # the last of which takes any file
        if each.code.recognise(file.head, file.name):
            return each
    raise HeightmapError(f"{file.name} is not a heightmap: {formats_in_words()} are read", name=file.name)
