"""A cost map by tiles: it is laid out, built tile by tile wherever a worker is free, and finished.

The store says how far it is: a tile is there when its figures are, which are written after it. Every function may be
called again, by another process, after one that was killed; what is there already is not made again. Who orders a cost
map makes the folder of its notes, and who deletes it removes them first: without them nothing is left of the rest.
"""

from __future__ import annotations

import errno
import json
import secrets
import shutil
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import Predictor
from joulemap.model.errors import DamagedError, InputError, NegativeCycleError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.readers import open_ground
from joulemap.planner.figures import figures_of, joined_figures
from joulemap.planner.lattice.build import build_tile, knows_spread, provenance_of, squares_of
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.planner.lattice.loading import open_group
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.service.analysis.cost_lattices import prepare_build
from joulemap.service.storage.stats import frame_values


class StoredBase:
    """A base model that reads its answers for the cells of a lattice from a finished cost map.

    Everything else is asked of the base model itself.
    """

    def __init__(self, base: Predictor, place: Path, tiling: Tiling) -> None:
        self._base, self._place, self._tiling = base, place, tiling

    def __getattr__(self, name: str) -> Any:
        return getattr(self._base, name)

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Return the base's answer, bit by bit the same.

        Read from the cost map; computed where `frame` is not a part of it, or where it was deleted or is damaged.

        `headings_rad` (K,): clockwise from north [rad]. Returns `traction_per_m` (rows, cols, K): traction [J/m];
        `std_j` (rows, cols, K): standard deviation [J] of a segment of 1 m, where the base knows it.
        """
        place = _place_in(self._tiling.frame, frame)
        if place is not None:
            rows, cols = place
            try:
                found = StoredLattice(self._place, kept_bytes=0).window(
                    rows.start, rows.stop, cols.start, cols.stop, what=("traction_per_m", "std_j")
                )
            except (InputError, DamagedError, OSError):  # it was deleted, is deleted at this moment, or is damaged
                pass
            else:
                return found.traction_per_m, found.std_j
        return self._base.traction_and_std(heightmap, robot, frame, headings_rad)


def with_stored_base(source: Predictor, robot: Robot, tiling: Tiling, finished: Iterable[Path]) -> Predictor:
    """Return the model of a cost map that is to be made, reading its base's answers where they are stored.

    `finished`: cost maps of the same robot. Result: `source` itself where it is not calibrated, where it asks its base
    of another robot, or where no finished cost map fits.
    """
    if not isinstance(source, CalibratedPredictor) or source.robot_of_base(robot) != robot:
        return source
    base = json.loads(json.dumps(source.base.provenance()))
    for place in finished:
        try:
            made: Any = open_group(place).attrs["provenance"]
        except (InputError, DamagedError, OSError, KeyError):  # it was deleted meanwhile, or is damaged
            continue
        if made["model"] == base:
            stored: Any = StoredBase(source.base, place, tiling)
            return CalibratedPredictor(stored, source.correction, name=source.name, version=source.version)
    return source


def _place_in(whole: GridFrame, part: GridFrame) -> tuple[slice, slice] | None:
    """The rows and columns of a part within the whole grid; None where it is not a part of it."""
    row, col = (round(float(at)) for at in whole.rowcol(*(float(c[0]) for c in part.centres())))
    inside = row >= 0 and col >= 0 and row + part.rows <= whole.rows and col + part.cols <= whole.cols
    if not inside or whole.window(row, row + part.rows, col, col + part.cols) != part:
        return None
    return slice(row, row + part.rows), slice(col, col + part.cols)


_LAYOUT, _PROVENANCE, _SUMMARY = "layout.json", "provenance.json", "summary.json"
_KEPT = threading.local()  # of the latest order, for each thread: an open file is read by one thread at a time


@dataclass(frozen=True)
class MapOrder:
    """What a worker is told of a cost map.

    Attributes
    ----------
    place : Path
        Folder of the lattice, on a file system that service and workers share.
    heightmap : Path
        Its file, there too.
    reading : mapping
        How it is read: arguments of `open_ground`.
    robot : mapping
        As `Robot.as_dict`.
    model : str or Path
        See `find_predictor`, as is `models_dir`.
    models_dir : Path or None
        Folder of trained models.
    spacing_m : float
        Side of a cell [m].
    headings : int
        Number of heading bins.
    finished : tuple of Path
        Folders of finished cost maps that differ in nothing but the model.
    replace : bool
        Whether a lattice that is at `place` is replaced.
    """

    place: Path
    heightmap: Path
    reading: Mapping[str, Any]
    robot: Mapping[str, Any]
    model: str | Path
    spacing_m: float
    headings: int
    models_dir: Path | None = None
    finished: tuple[Path, ...] = ()
    replace: bool = False

    @property
    def notes(self) -> Path:
        """Folder of what is known of the tiles that are there; it goes when the cost map is done, or deleted."""
        return self.folder.notes

    @property
    def folder(self) -> LatticeFolder:
        """The lattice."""
        return LatticeFolder(self.place)


class Tiles:
    """The ground, the model and the tiles of an order, which are read once and not for every tile."""

    def __init__(self, order: MapOrder) -> None:
        self.order = order
        self.ground = open_ground(order.heightmap, **order.reading)
        self.robot, source, self.tiling = prepare_build(
            self.ground,
            Robot.from_mapping(order.robot),
            model=order.model,
            spacing_m=order.spacing_m,
            headings=order.headings,
            models_dir=order.models_dir,
        )
        alike = () if self.ground.layers else order.finished  # prices of a finished map have costs of layers in them
        self.source = with_stored_base(source, self.robot, self.tiling, alike)

    @classmethod
    def of(cls, order: MapOrder) -> Tiles:
        """Return what was opened for the order before by this thread, or open it.

        Kept until this thread is given another order.
        """
        kept: Tiles | None = getattr(_KEPT, "tiles", None)
        if kept is None or kept.order != order:
            _KEPT.tiles = None  # before the next is opened, so that never two are held
            _KEPT.tiles = kept = cls(order)
        return kept


def lay_out(order: MapOrder) -> tuple[int, list[int]]:
    """Lay a cost map out where that is not done yet.

    Returns `count`: number of its tiles; `missing`: those that are not there.
    """
    tiles = Tiles.of(order)
    if not order.notes.exists():
        raise FileNotFoundError(errno.ENOENT, "the cost map was deleted, or is done", str(order.place))
    if (order.notes / _SUMMARY).exists():
        return len(tiles.tiling), []
    if not (order.notes / _LAYOUT).exists():
        std = knows_spread(tiles.source, tiles.robot)
        with _unless_deleted(order):
            squares = squares_of(tiles.tiling, tiles.ground, tiles.robot)
            order.folder.lay_out(tiles.tiling, tiles.robot, with_std=std, squares=squares, again=False)
            _write(order.notes / _LAYOUT, {})
    count = len(tiles.tiling)
    return count, [number for number in range(count) if not _note(order, number).exists()]


def build(order: MapOrder, number: int) -> None:
    """Build one tile, unless it is there. The first one's worker notes how the map is made, others build theirs."""
    if _note(order, number).exists():
        return
    tiles = Tiles.of(order)
    place = tiles.tiling[number]
    part = build_tile(tiles.ground, tiles.robot, tiles.source, tiles.tiling, *place)
    with _unless_deleted(order):
        order.folder.write(part, *place)
        if number == 0:
            _provenance(tiles)
        _write(_note(order, number), figures_of(part))


def finish(order: MapOrder) -> dict[str, Any]:
    """Put a cost map whose tiles are all there into its place.

    Result: JSON-able: robot, frame, provenance, prices and what is blocked.
    """
    noted = order.notes / _SUMMARY
    with _unless_deleted(order):
        if not noted.exists():
            _write(noted, _summary(Tiles.of(order)))
        summary: dict[str, Any] = json.loads(noted.read_text(encoding="utf-8"))
        if order.replace or not order.folder.is_whole:
            order.folder.finish(summary["provenance"], replace=order.replace)
    return summary


@contextmanager
def _unless_deleted(order: MapOrder) -> Iterator[None]:
    """Remove what is written of a cost map that is deleted at the same time."""
    try:
        yield
    except Exception:
        if not order.notes.exists():
            shutil.rmtree(order.folder.partial, ignore_errors=True)
        raise


def _summary(tiles: Tiles) -> dict[str, Any]:
    order = tiles.order
    provenance = _provenance(tiles)
    notes = [_note(order, number).read_text(encoding="utf-8") for number in range(len(tiles.tiling))]
    figures = joined_figures([json.loads(note) for note in notes])
    if figures["energy_per_m"] is not None and figures["energy_per_m"]["min"] < 0.0:
        from joulemap.planner.route_planner import RoutePlanner  # loads slowly

        try:
            RoutePlanner(order.folder.read_unfinished(provenance)).prepare()
        except NegativeCycleError as error:  # the map is good to look at, every question will say the same
            provenance["warnings"].append(error.message)
    return {
        "robot": tiles.robot.as_dict(),
        "frame": frame_values(tiles.tiling.frame, side="spacing_m"),
        "provenance": provenance,
        **figures,
    }


def _provenance(tiles: Tiles) -> dict[str, Any]:
    """How the map is made; the whole heightmap is read for it, where that is not noted yet."""
    noted = tiles.order.notes / _PROVENANCE
    if not noted.exists():
        _write(noted, provenance_of(tiles.ground, tiles.robot, tiles.source, tiles.tiling))
    found: dict[str, Any] = json.loads(noted.read_text(encoding="utf-8"))
    return found


def _note(order: MapOrder, number: int) -> Path:
    return order.notes / f"{number}.json"


def _write(path: Path, document: dict[str, Any]) -> None:
    """Whole or not at all. The folder is not made: that of a job which was deleted stays away."""
    begun = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    try:
        begun.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
        begun.replace(path)
    finally:
        begun.unlink(missing_ok=True)
