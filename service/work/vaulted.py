"""Work on workers that share an object store and no file system: what a task needs is fetched, what it makes is kept.

Each machine has a folder of copies, in which the work is done as on one machine. A tile of a cost map is in the object
store when its record is, which is written after its chunks. Who orders a cost map begins its notes, and who deletes it
removes that first: a worker that finds it gone after it sent something removes what it sent.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import zarr

from joulemap.model.energy.predictor import MODEL_NAMES
from joulemap.service.storage.vault import ObjectVault, Part
from joulemap.service.work import calibrations, tiles
from joulemap.service.work.tiles import MapOrder

_SUMMARY = "summary.json"


@dataclass(frozen=True)
class VaultedOrder:
    """What a worker is told of a cost map.

    Attributes
    ----------
    url : str
        Of the object store.
    folder : Path
        Data folder of the service; a worker that has JOULEMAP_DATA_DIR set uses that one.
    order : MapOrder
        As for a worker that shares the folder.
    """

    url: str
    folder: Path
    order: MapOrder

    @property
    def vault(self) -> ObjectVault:
        """The object store."""
        return _vault(self.url)

    @property
    def key(self) -> str:
        """What the object store calls the lattice."""
        return self.order.place.relative_to(self.folder).as_posix()

    def here(self) -> MapOrder:
        """Return the order for this machine, once its heightmap and its model are there."""
        copies = _copies(self.folder)

        def _fetched(place: Path) -> Path:
            within = place.relative_to(self.folder)
            self.vault.fetch(within.as_posix(), _ready(copies / within))
            return copies / within

        reading = dict(self.order.reading)
        if "layers" in reading:
            reading["layers"] = {
                role: _fetched(layer) if isinstance(layer, Path) else layer for role, layer in reading["layers"].items()
            }
        _fetch_model(self.vault, str(self.order.model), copies)
        place = _ready(copies / self.key)
        heightmap = _fetched(self.order.heightmap)
        here = replace(self.order, place=place, heightmap=heightmap, reading=reading, models_dir=copies / "models")
        here.folder.begin()
        return here


def lay_out(order: VaultedOrder) -> tuple[int, list[int]]:
    """Lay a cost map out. Returns `count`: number of its tiles; `missing`: those that are not in the object store."""
    notes = set(order.vault.names(_notes(order)))
    if f"{_notes(order)}/{_SUMMARY}" in notes:
        return 0, []
    count, _ = tiles.lay_out(order.here())
    return count, [number for number in range(count) if _note(order, number) not in notes]


def build(order: VaultedOrder, number: int) -> None:
    """Build one tile, unless it is in the object store."""
    if order.vault.read(_note(order, number)) is not None:
        return
    order.vault.check_begun(_notes(order))
    here = order.here()
    tiles.lay_out(here)
    tiles.build(here, number)
    folder = _folder(here)
    figures = json.loads((here.notes / f"{number}.json").read_text(encoding="utf-8"))
    with _unless_deleted(order):
        sent = order.vault.send(order.key, folder, _chunks(here, folder, number))
        order.vault.write(_note(order, number), json.dumps({"files": sent, "figures": figures}).encode())


def finish(order: VaultedOrder) -> dict[str, Any]:
    """Keep a cost map whose tiles are all there."""
    noted = f"{_notes(order)}/{_SUMMARY}"
    found = order.vault.read(noted)
    if found is None:
        here = order.here()
        count, _ = tiles.lay_out(here)
        parts: dict[str, Part] = {}
        for number in range(count):
            parts |= _take(order, here, number)
        summary = tiles.finish(here)
        found = json.dumps(summary).encode()
        with _unless_deleted(order):
            order.vault.put(order.key, here.place, there=parts, begun=_notes(order))
            order.vault.write(noted, found)
    made: dict[str, Any] = json.loads(found)
    return made


@contextmanager
def _unless_deleted(order: VaultedOrder) -> Iterator[None]:
    """Remove what is sent of a cost map that is deleted at the same time. One that is done keeps all but its notes."""
    try:
        yield
    finally:
        if order.vault.parts(_notes(order)) is None:
            if not order.vault.has(order.key):
                order.vault.remove(order.key)
            order.vault.remove(_notes(order))


def calibrate(order: Mapping[str, Any], topic: str) -> dict[str, Any]:
    """Calibrate; what is in the object store already is not made again."""
    folder = Path(order["data_folder"])
    vault, copies = _vault(order["object_store"]), _copies(folder)

    def _here(place: str) -> str:
        return str(copies / Path(place).relative_to(folder))

    for file in (*order["runs"], *order["base_runs"], *order["test_runs"]):
        runs = Path(file).relative_to(folder).parent
        vault.fetch(runs.as_posix(), _ready(copies / runs))
    mine = dict(order)
    for name in ("runs", "base_runs", "test_runs"):
        mine[name] = [_here(file) for file in order[name]]
    if order["heightmap"] is not None:
        mine["heightmap"] = _here(order["heightmap"])
        vault.fetch(Path(order["heightmap"]).relative_to(folder).as_posix(), _ready(Path(mine["heightmap"])))
    if order["model"] not in MODEL_NAMES:
        _fetch_model(vault, Path(order["model"]).name, copies)
        mine["model"] = str(copies / "models" / Path(order["model"]).name)
    mine["folder"] = _here(order["folder"])
    mine["calibrated"] = str(_ready(copies / "models" / order["id"]))
    key = Path(order["folder"]).relative_to(folder).as_posix()
    if vault.parts(key) is not None:
        vault.fetch(f"models/{order['id']}", Path(mine["calibrated"]))
        vault.fetch(key, _ready(Path(mine["folder"])))
    made = calibrations.calibrate(mine, topic)
    vault.put(f"models/{order['id']}", Path(mine["calibrated"]))
    vault.put(key, Path(mine["folder"]))  # last: what has a report has its model
    return made


@cache
def _vault(url: str) -> ObjectVault:
    return ObjectVault(url)


def _copies(folder: Path) -> Path:
    """The folder of copies on this machine."""
    named = os.environ.get("JOULEMAP_DATA_DIR")
    return Path(named).resolve() if named else folder


def _ready(place: Path) -> Path:
    place.parent.mkdir(parents=True, exist_ok=True)
    return place


def _fetch_model(vault: ObjectVault, model: str, copies: Path) -> None:
    """Models that no calibration made are on every machine, or nowhere."""
    if vault.parts(f"models/{model}") is not None:
        vault.fetch(f"models/{model}", _ready(copies / "models" / model))


def _notes(order: VaultedOrder) -> str:
    return f"{order.key}.tiles"


def _note(order: VaultedOrder, number: int) -> str:
    return f"{_notes(order)}/{number}.json"


def _folder(here: MapOrder) -> Path:
    """Where the lattice is: on its way, or finished by a process that was killed before it was kept."""
    return here.folder.partial if here.folder.partial.exists() else here.place


def _chunks(here: MapOrder, folder: Path, number: int) -> list[str]:
    """The files of one tile; a chunk without a file holds nothing but unknown cells."""
    rows, cols = tiles.Tiles.of(here).tiling[number]
    found = []
    group = zarr.open_group(folder, mode="r", use_consolidated=False)
    for name in sorted(path.name for path in folder.iterdir() if path.is_dir()):
        array = group[name]
        if not isinstance(array, zarr.Array) or array.ndim < 2:
            continue
        at = (rows.start // array.chunks[0], cols.start // array.chunks[1], *(0 for _ in array.shape[2:]))
        chunk = f"{name}/{array.metadata.encode_chunk_key(at)}"
        if (folder / chunk).is_file():
            found.append(chunk)
    return found


def _take(order: VaultedOrder, here: MapOrder, number: int) -> dict[str, Part]:
    """Have a tile on this machine; its parts."""
    content = order.vault.read(_note(order, number))
    if content is None:
        raise RuntimeError(f"tile {number} of {order.key} is not there")
    record = json.loads(content)
    parts = {name: Part(*part) for name, part in record["files"].items()}
    note = here.notes / f"{number}.json"
    if not note.exists():
        order.vault.get(order.key, _folder(here), parts)
        note.write_text(json.dumps(record["figures"]), encoding="utf-8")
    return parts
