"""Read a heightmap from a file or from bytes, in any of the formats of the registry."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.cut_out import PartReader, WindowLike, cells_of, transform_of
from joulemap.model.terrain.decoded import MAX_SIDE, Scaling, check_cells
from joulemap.model.terrain.formats import FORMATS, formats_in_words
from joulemap.model.terrain.formats.contract import HeightmapFormat
from joulemap.model.terrain.formats.zipped import unpacked
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.plausible import heightmap_warnings
from joulemap.model.terrain.reproject import reproject_file
from joulemap.model.terrain.stated_frame import stated_frame
from joulemap.model.terrain.windows import Ground, HeightmapFile

MAX_CELLS = 400_000_000
"""Default limit of declared cells: 1.6 GB of float32."""

ASKED_FOR = ("reprojected from", "a window")
"""What notes begin with that tell of what the user asked for."""

LayerFiles = Mapping[str, str | Path | bytes | Sequence[str | Path]]
"""Files of layers, or the bytes of one, by what they are of."""

_HEAD_BYTES = 512
_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # a Path has lost one of the slashes


def read_heightmap(
    source: str | Path | bytes,
    *,
    filename: str | None = None,
    resolution_m: float | None = None,
    west_m: float = 0.0,
    north_m: float | None = None,
    crs: str | None = None,
    scale_m: float | None = None,
    offset_m: float = 0.0,
    nodata: float | None = None,
    band: int | None = None,
    reproject: str | None = None,
    window: WindowLike | None = None,
    noise_m: float | None = None,
    noise_length_m: float = 0.0,
    layers: LayerFiles | None = None,
    legend: str | Path | Mapping[str, Any] | None = None,
    max_cells: int = MAX_CELLS,
) -> Heightmap:
    """Read a heightmap from a file of any known format.

    The format is recognised by the content first, then by the name. Row 0 of the answer is north and unknown cells are
    NaN, whatever the file's own way.

    Parameters
    ----------
    source : str, Path or bytes
        The file, or all its bytes.
    filename : str, optional
        The name of `source` where it is bytes.
    resolution_m : float, optional
        Side of a cell [m]. Required where the file does not say; refused where it differs from the file's by more than
        0.1 %.
    west_m : float, optional
        Western edge [m], used where the file does not say.
    north_m : float, optional
        Northern edge [m], used where the file does not say. Without it the southern edge is at y = 0.
    crs : str, optional
        Coordinate reference system, "EPSG:n" or WKT, where the file does not say. Its unit is the metre.
    scale_m, offset_m : float, optional
        height = stored value * scale_m + offset_m. A picture (PNG) needs `scale_m`, unless its colours are heights.
    nodata : float, optional
        Stored value of unknown cells, in addition to those that the file declares.
    band : int, optional
        Number of the band with the heights, from 1, or of the variable, for a file with several.
    reproject : str, optional
        "auto", "EPSG:n" or WKT: resample a map in degrees, feet or Web Mercator, a rotated one or one whose cells are
        not square, to a north-up grid of true metres. "auto" takes the UTM zone, or keeps a CRS in true metres.
        `resolution_m` is then the side of the new cells.
    window : str or sequence of float, optional
        Two opposite corners of the part that is read: x, y of the map's CRS, or latitude, longitude. Of a GeoTIFF only
        that part is read from the file.
    noise_m : float, optional
        Standard deviation of the survey's noise [m]; 0 for a map to be taken as it is. Estimated from the map where
        None, as noise that is independent from cell to cell.
    noise_length_m : float, optional
        Length over which that noise is alike [m], its correlation is exp(-d^2 / 2 length^2) at a distance d: some cells
        where heights are of photogrammetry or were resampled.
    layers : dict of str to str, Path or list of these, optional
        Files of what is known of the ground beside its height, by what they are of: `kinds`, `obstacles`, `free`,
        `factor` or `cost`, see `with_layers`.
    legend : str, Path or dict, optional
        Which kinds of ground there are, and which values of `kinds` mean them: a TOML file, or its tables.
    max_cells : int, optional
        Largest number of cells.

    Returns
    -------
    Heightmap
        Heights and their place.

    Raises
    ------
    HeightmapError
        If the file cannot be read, is no heightmap, does not lie on a north-up square grid of true metres, or holds no
        known cell.
    TooLargeError
        If it declares more than `max_cells` cells; no memory is allocated for them.

    Warns
    -----
    UserWarning
        Of what was done to the heights by itself (their unit, colours), and of heights that are hardly in metres.
    """
    options: Any = dict(locals())
    heightmap = read_sent(options.pop("source"), alone=False, **options)
    for words in (*heightmap.notes, *heightmap_warnings(heightmap)):
        if not words.startswith(ASKED_FOR):
            warnings.warn(words, stacklevel=2)
    return heightmap


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
        The others of `read_heightmap`.

    Returns
    -------
    Heightmap
        Heights and their place; what is to be known of them is in its `notes`.

    Raises
    ------
    HeightmapError
        As `read_heightmap`.
    TooLargeError
        As `read_heightmap`.
    """
    over = {key: options.pop(key, None) for key in ("layers", "legend")}
    ground = _ground(source_of(source, options.pop("filename", None), alone=alone), max_cells, max_cells, **options)
    ground = _with_layers(ground, **over)
    if isinstance(ground, Heightmap):
        return ground
    rows, cols = ground.frame.shape
    heights = ground.reader.read(ground.scaling, slice(0, rows), slice(0, cols))
    same = ("source", "notes", "given_noise_m", "noise_length_m", "layers")
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
        As in `read_heightmap`, but for `max_cells`.

    Returns
    -------
    Ground
        A `Heightmap`, or a `HeightmapFile`.

    Raises
    ------
    HeightmapError
        As `read_heightmap`. What only the heights show is found when they are read.
    TooLargeError
        If the file is read as a whole and declares more than `MAX_CELLS` cells.
    """
    over = {key: options.pop(key, None) for key in ("layers", "legend")}
    source = source_of(path, options.pop("filename", None), alone=alone)
    return _with_layers(_ground(source, MAX_SIDE * MAX_SIDE, MAX_CELLS, **options), **over)


def _with_layers(
    ground: Heightmap | HeightmapFile, layers: LayerFiles | None, legend: str | Path | Mapping[str, Any] | None
) -> Heightmap | HeightmapFile:
    if not layers and legend is None:
        return ground
    from joulemap.model.terrain.layers.reading import read_layers  # which builds on this module

    return replace(ground, layers=read_layers(layers or {}, ground.frame, legend=legend))


def _ground(
    source: SourceFile,
    max_cells: int,
    max_cells_whole: int,
    *,
    resolution_m: float | None = None,
    west_m: float = 0.0,
    north_m: float | None = None,
    crs: str | None = None,
    scale_m: float | None = None,
    offset_m: float = 0.0,
    nodata: float | None = None,
    band: int | None = None,
    reproject: str | None = None,
    window: WindowLike | None = None,
    noise_m: float | None = None,
    noise_length_m: float = 0.0,
) -> Heightmap | HeightmapFile:
    """A file of up to `max_cells` cells, of `max_cells_whole` where its format is only read as a whole."""
    scaling = Scaling(scale_m, offset_m, nodata, resolution_m)
    file, kind = recognised(source)
    if reproject is not None:
        warped, scaling = reproject_file(
            file,
            kind,
            scaling,
            to=reproject,
            resolution_m=resolution_m,
            west_m=west_m,
            north_m=north_m,
            crs=crs,
            band=band,
            window=window,
            max_cells=max_cells,
            max_cells_whole=max_cells_whole,
        )
        frame = stated_frame(warped, None, 0.0, None, None)
        return HeightmapFile(warped, scaling, frame, file.name, warped.notes, noise_m, noise_length_m)
    most = max_cells if window is None else MAX_SIDE * MAX_SIDE
    reader = kind.open_windows(file, scaling, band=band, max_cells=most)
    whole = reader or kind.code.decode(file, scaling, max_cells=max_cells_whole, band=band)
    frame, part, notes = stated_frame(whole, resolution_m, west_m, north_m, crs), whole, whole.notes
    if window is not None:
        cells = cells_of(window, frame.crs, transform_of(frame), frame.shape)
        part, frame = PartReader(whole, cells), frame.window(cells.row0, cells.row1, cells.col0, cells.col1)
        check_cells(frame.rows, frame.cols, max_cells, what=f"the window of {file.name}")
        notes = (*notes, _window_note(frame))
    if reader is not None:
        return HeightmapFile(part, scaling, frame, file.name, notes, noise_m, noise_length_m)
    heights = part.read(scaling, slice(0, frame.rows), slice(0, frame.cols)).copy()
    return Heightmap(heights, frame, file.name, notes=notes, given_noise_m=noise_m, noise_length_m=noise_length_m)


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
