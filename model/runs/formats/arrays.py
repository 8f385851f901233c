"""Arrays of numerical programs, side by side: MATLAB files before version 7.3, archives of NumPy, and netCDF 3."""

from __future__ import annotations

import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import named
from joulemap.model.runs.formats.contract import Log, Stream
from joulemap.model.runs.formats.messages import reading
from joulemap.model.runs.names import NEEDED, candidate
from joulemap.model.runs.table import LEAST_ROWS, TableLimits, usable
from joulemap.model.source_file import SourceFile

_MATLAB, _ZIP = b"MATLAB 5.0 MAT-file", b"PK\x03\x04"
_NETCDF = (b"CDF\x01", b"CDF\x02")
_DEEPEST = 8


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of MATLAB or netCDF, or of a zip that is called .npz."""
    return head.startswith((_MATLAB, *_NETCDF)) or (head.startswith(_ZIP) and name.lower().endswith(".npz"))


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the arrays that have the usual length."""
    name, found, said, objects = source.name, dict[str, Any](), dict[str, str](), set[str]()
    with reading("file of arrays", name, lambda: "in one of its arrays"), source.open() as stream:
        if source.head.startswith(_MATLAB):
            from scipy.io import loadmat

            found = loadmat(stream, simplify_cells=True)
        elif source.head.startswith(_NETCDF):
            from scipy.io import netcdf_file

            with netcdf_file(stream, mmap=False) as file:
                found = {key: np.array(each[:]) for key, each in file.variables.items() if each.shape}
                units = {key: getattr(each, "units", b"") for key, each in file.variables.items()}
                said = {key: unit.decode("utf-8", "replace") for key, unit in units.items() if isinstance(unit, bytes)}
        else:
            with zipfile.ZipFile(stream) as archive:
                limits.check(sum(each.file_size for each in archive.infolist()) // 8, 1, name)
                names = [each.filename for each in archive.infolist() if each.filename.endswith(".npy")]
                objects = {each for each in names if _holds_objects(archive, each)}
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as arrays:
                found = {each.removesuffix(".npy"): arrays[each] for each in names if each not in objects}
    notes = []
    if objects:
        listed = ", ".join(sorted(each.removesuffix(".npy") for each in objects))[:200]
        notes.append(
            f"{listed} {'hold' if len(objects) > 1 else 'holds'} objects of Python, which could run code and are not "
            "read: save numbers, array.astype(float)"
        )
        if any(candidate(key, each.removesuffix(".npy")) for key in NEEDED for each in objects):
            raise RunsError.of_run(name, notes[0])
    columns = [(path, values) for path, values in _columns(found, "", 0) if len(values) >= LEAST_ROWS]
    if not columns:
        raise RunsError.of_run(name, f" holds no array of {LEAST_ROWS} numbers or more")
    (rows, _), *_ = Counter(len(values) for _, values in columns).most_common(1)
    same = [(path, values) for path, values in columns if len(values) == rows]
    limits.check(rows, len(same), name)
    paths = [path for path, _ in same]
    while len({path.partition(".")[0] for path in paths}) == 1 and all("." in path for path in paths):
        paths = [path.partition(".")[2] for path in paths]  # of a structure that holds all
    names = named(paths)
    numbers = {key: np.asarray(values, dtype=np.float64) for key, (_, values) in zip(names, same, strict=True)}
    return Log(
        (
            Stream(
                "",
                {key: usable(each) for key, each in numbers.items()},
                units={key: unit for key, unit in said.items() if unit},
            ),
        ),
        notes=tuple(notes),
    )


def _holds_objects(archive: zipfile.ZipFile, name: str) -> bool:
    """Whether an array of an archive holds objects of Python, which are no numbers and could run code."""
    with archive.open(name) as file:
        first = np.lib.format.read_magic(file) == (1, 0)
        header = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        return bool(header(file)[2].hasobject)


def _columns(value: Any, path: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of one dimension by their paths, and the columns of those of two."""
    if isinstance(value, dict) and depth < _DEEPEST:
        for key, inner in value.items():
            if not str(key).startswith("__"):
                yield from _columns(inner, f"{path}.{key}" if path else str(key), depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind == "M":
        seconds = value.astype("datetime64[us]").astype(np.float64) / 1e6
        yield from _columns(np.where(np.isnat(value), np.nan, seconds), path, depth)
    elif isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 1:  # cells of MATLAB
        if all(np.ndim(each) == 0 and np.asarray(each).dtype.kind in "fiub" for each in value):
            yield path, value.astype(np.float64)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        if value.ndim == 1:
            yield path, value
        elif value.ndim == 2:
            high = value if value.shape[0] >= value.shape[1] else value.T
            single = 1 in high.shape
            yield from ((path if single else f"{path} {k}", column) for k, column in enumerate(high.T))
