"""Measured runs of a Python user: files, folders and patterns, and tables in memory, which become files of Parquet."""

from __future__ import annotations

import atexit
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from glob import glob, has_magic
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.errors import NotFoundError, RunsError
from joulemap.model.recordings.split import is_split
from joulemap.model.runs.files import copies_words, same_content
from joulemap.model.runs.formats import suffixes
from joulemap.model.runs.formats.columns import named
from joulemap.model.runs.mapping import MappingLike, read_mapping
from joulemap.model.runs.run import Run
from joulemap.service.intake.trial import refuse_deadly
from joulemap.service.library.shown import Shown
from joulemap.service.words import duration_words, runs_words

_NUMBERS = count(1)


def is_table(given: Any) -> bool:
    """Decide whether something is a table.

    Result: True for a data frame of pandas or polars, a table of pyarrow, and a mapping.
    """
    return isinstance(given, Mapping) or (hasattr(given, "columns") and hasattr(given, "__getitem__"))


def kept_table(table: Any) -> Path:
    """Write a table to a folder that is gone when the process ends."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    name = f"table_{next(_NUMBERS)}.parquet"
    try:
        if isinstance(table, Mapping):
            found = pa.table({str(key): pa.array(_plain(v), from_pandas=True) for key, v in table.items()})
        elif isinstance(table, pa.Table):
            found = table
        elif hasattr(table, "to_arrow"):  # polars
            found = table.to_arrow()
        else:
            frame = table.set_axis(named([str(key) for key in table.columns]), axis=1)
            objects = frame.select_dtypes("object")
            found = pa.Table.from_pandas(frame.assign(**{key: _plain(objects[key].to_numpy()) for key in objects}))
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise RunsError(f"run {name}: not a readable table: {str(error)[:200]}", run=name) from error
    place = _folder() / name
    pq.write_table(found, place)
    return place


def _plain(values: Any) -> Any:
    """Numbers of an array of objects, such as arrays of one number; what holds other things stays as it is."""
    if getattr(getattr(values, "dtype", None), "kind", "") != "O":
        return values
    try:
        return np.array([np.nan if each is None else float(np.squeeze(each)) for each in values])
    except (TypeError, ValueError):
        return values


def is_kept(path: Path) -> bool:
    """Decide whether a file is one of `kept_table`."""
    return path.parent == _folder()


@cache
def _folder() -> Path:
    set_by_service, tempfile.tempdir = tempfile.tempdir, None  # a service of this process empties its own at its end
    try:
        made = tempfile.TemporaryDirectory(prefix="joulemap-")
    finally:
        tempfile.tempdir = set_by_service
    atexit.register(made.cleanup)
    return Path(made.name)


RUN_SUFFIXES = suffixes()
"""Files that a folder of runs is searched for."""


@dataclass(frozen=True, eq=False, repr=False)
class Runs(Shown):
    """Measured runs, read and repaired.

    Attributes
    ----------
    files : tuple of Path
        Where they were read from.
    runs : tuple of Run
        What was read, in the same order.
    """

    files: tuple[Path, ...]
    runs: tuple[Run, ...]

    @property
    def names(self) -> list[str]:
        """A name of each run, no two alike."""
        return [run.name for run in self.runs]

    @property
    def repairs(self) -> dict[str, dict[str, int]]:
        """Rows that were repaired or dropped, by run and rule."""
        return {run.name: run.repairs for run in self.runs if run.repairs}

    @property
    def reading(self) -> dict[str, dict[str, str]]:
        """What was taken from columns of other names, in other units, or from messages, by run and column."""
        return {run.name: run.reading for run in self.runs if run.reading}

    def __len__(self) -> int:
        return len(self.runs)

    def _title(self) -> str:
        return runs_words(len(self))

    def _rows(self) -> dict[str, str]:
        def _repaired(run: Run) -> int:  # what a slow sensor writes again is no fault
            return sum(count for rule, count in run.repairs.items() if not rule.startswith("held_"))

        return {
            run.name: f"{len(run):,} rows, {duration_words(float(run.t[-1] - run.t[0]))}, "
            f"{'voltage and current' if run.voltage_v is not None else 'current without voltage'}, "
            f"{_repaired(run):,} rows repaired or dropped"
            for run in self.runs
        }

    def __repr__(self) -> str:
        return f"<Runs: {runs_words(len(self))}, {sum(len(run) for run in self.runs):,} rows>"


RunsLike = Any
"""Runs; a file, a folder, a pattern such as "logs/*.csv"; a table in memory; or several of these. A table is a data
frame of pandas or polars, a table of pyarrow, or a mapping from names to arrays."""


def read_runs(files: RunsLike, *, crs: str | None = None, mapping: MappingLike | None = None) -> Runs:
    """Read measured runs.

    Parameters
    ----------
    files : str, Path, table or iterable of these
        Files (CSV, JSON, GPX, Parquet, MCAP, ROS bags, flight logs, FIT), folders, or patterns such as "logs/*.csv".
        A table is a data frame of pandas or polars, a table of pyarrow, or a mapping from names to arrays.
    crs : str, optional
        Coordinate system of the heightmap, for logs that have `lat` and `lon` instead of `x` and `y`.
    mapping : mapping, sequence of str, str or Path, optional
        Where joulemap's columns are taken from, with their units: `{"t": "timestamp_ms:ms"}`, `["t=timestamp_ms:ms"]`,
        or a TOML file. Usual names and units are recognised without it; `Runs.reading` says what was taken.

    Returns
    -------
    Runs
        One for each file.

    Raises
    ------
    NotFoundError
        If a file, folder or pattern names no file.
    RunsError
        If a file is no usable run. The message names the file, the column and the row.

    Warns
    -----
    UserWarning
        If numbers are hardly in the units that they are read in, or if a log was cut off.
    """
    from joulemap.model.runs.cutting import cut_segments
    from joulemap.model.runs.files import distinct_names
    from joulemap.model.runs.plausible import doubtful, implausible
    from joulemap.model.runs.reader import read_run

    if isinstance(files, Runs):
        return files
    entries = read_mapping(mapping)
    paths = find_run_files(files, mapping=entries)
    names = distinct_names(paths)
    runs = tuple(read_run(path, name=name, crs=crs, mapping=entries) for path, name in zip(paths, names, strict=True))
    for run in runs:
        segments = cut_segments(run, charge=not run.has_energy)
        for found in (*run.notes, *implausible(run, segments), *doubtful(run, segments)):
            warnings.warn(f"run {run.name}: {found}", stacklevel=2)
    return Runs(tuple(paths), runs)


def find_run_files(
    files: RunsLike | None, *, mapping: Mapping[str, str] | None = None, trial: bool = True
) -> list[Path]:
    """Return the files that are meant, each once.

    `files`: None means no file. Result: in the order given, sorted within each pattern; of files with one content the
    first. Raises NotFoundError if one of them names no file.
    """
    if files is None:
        return []
    if isinstance(files, Runs):
        return list(files.files)
    found: dict[Path, Path] = {}
    for each in [files] if isinstance(files, str | Path) or is_table(files) else files:
        place = kept_table(each) if is_table(each) else Path(each)
        if place.is_file() or is_split(place):
            here = [place]
        elif place.is_dir():
            here = sorted(path for path in place.iterdir() if path.suffix.lower() in RUN_SUFFIXES or is_split(path))
        else:
            here = sorted(Path(name) for name in glob(str(each)))
        if not here:
            where = f"the folder {each} holds no" if place.is_dir() else f"{str(each)!r} names no"
            if not place.is_dir() and not has_magic(str(each)):
                raise NotFoundError(f"there is no file {each} (looked for from {Path.cwd()})", pattern=str(each))
            raise NotFoundError(
                f"{where} log: {', '.join(RUN_SUFFIXES)} (looked for from {Path.cwd()})", pattern=str(each)
            )
        found |= {path.resolve(): path for path in here if path.resolve() not in found}
    copies = same_content(list(found.values()))
    for words in copies_words(copies):
        warnings.warn(words, stacklevel=2)
    files_found = [path for path in found.values() if path not in copies]
    if trial:
        refuse_deadly([path for path in files_found if not is_kept(path)], mapping=mapping)
    return files_found
