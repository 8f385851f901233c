"""`python -m tests.fuzz.damages --count 200`: bits flipped and files deleted in what is kept; no answer may change.

Each damage is done to a copy of its own. A cost map is asked in memory and from disk. One that was written by an older
version has no checksums: they are taken when it is first opened, before the damage. Of a data directory every object is
asked for, then `joulemap check` repairs it. Of its database whole pages are lost, too.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

import joulemap as jm
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS
from joulemap.model.errors import JoulemapError
from joulemap.model.frames import GridFrame
from joulemap.model.loop.calibration_file import save_calibrated
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.forms.baseline_change import RollingResistance
from joulemap.model.loop.forms.climbing import Climbing
from joulemap.model.loop.terms import Term
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.folder import LatticeFolder
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.service.loop.calibration import BASE_FOLDER
from joulemap.service.models import load_model
from joulemap.service.schemas.kept import ANSWERS, shown
from joulemap.service.storage.check import Check
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import CalibrationRow, HeightmapRow, RunsRow
from tests.reference.lattices import surface_lattice
from tests.service.conftest import hill, settings_for

START, GOAL = (3.2, 4.1), (35.7, 28.3)
_ROWS, _COLS, _TILE = 33, 40, 16
_PAGE = 4096  # bytes


@dataclass
class Damages:
    """What came of them."""

    outcomes: Counter[str] = field(default_factory=Counter)
    others: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    def line(self) -> str:
        """The figures in a line."""
        kinds = {"error": "errors", "same": "same answers", "other": "other numbers"}
        count = sum(self.outcomes[one] for one in kinds)
        said = ", ".join(f"{self.outcomes[one]} {kinds.get(one, one)}" for one in {**kinds, **self.outcomes})
        return f"{count} damages: {said}"


def make_map(folder: Path) -> None:
    """Write a hill in nine tiles, one of them unknown, with standard deviations and a coarse level."""
    frame = GridFrame(0.0, float(_ROWS), 1.0, _ROWS, _COLS)
    x, y = np.meshgrid(*frame.centres())
    height = 2.0 * np.sin(x / 6.0) * np.cos(y / 7.0)
    gradient = np.cos(x / 6.0) * np.cos(y / 7.0) / 3.0, -2.0 / 7.0 * np.sin(x / 6.0) * np.sin(y / 7.0)
    lattice = surface_lattice(frame, height, gradient, jm.Robot(max_grade_deg=30.0, max_cross_slope_deg=30.0), 8)
    blocked = lattice.blocked.copy()
    unknown = np.s_[:_TILE, :_TILE]
    blocked[unknown] = Blocked.UNKNOWN
    for values in (lattice.traction_per_m, lattice.elevation_m, lattice.gradient):
        values[unknown] = np.nan
    blocked[20, 18:30] = Blocked.STEP
    rng = np.random.default_rng(3)
    std = rng.uniform(1.0, 3.0, lattice.traction_per_m.shape).astype(np.float32)
    lattice = replace(lattice, blocked=blocked, std_j=std, provenance={"model": {"name": "physics"}, "warnings": []})
    written = LatticeFolder(folder)
    written.lay_out(Tiling(frame, lattice.headings, _TILE), lattice.robot, with_std=True)
    written.write(lattice, slice(0, _ROWS), slice(0, _COLS))
    written.finish(lattice.provenance)
    answers(folder)  # which makes the coarse level


def make_older(folder: Path) -> None:
    """Make what the version before wrote of a cost map: neither checksums nor the attribute that asks for them."""
    (folder / "checksums").unlink()
    root = folder / "zarr.json"
    node = json.loads(root.read_text(encoding="utf-8"))
    del node["attributes"]["checksums"]
    root.write_text(json.dumps(node, indent=2), encoding="utf-8")


def answers(folder: Path) -> list[Any]:
    """All numbers of a map in memory, and those of routes in memory and from disk."""
    lattice = load_lattice(folder)
    arrays = lattice.traction_per_m, lattice.elevation_m, lattice.gradient, lattice.blocked, lattice.std_j
    found: list[Any] = [
        lattice.frame,
        lattice.robot,
        lattice.provenance,
        *(np.asarray(each).tobytes() for each in arrays),
    ]
    for how in ({}, {"memory_gb": 0.1}):
        route = jm.open_costmap(folder, **how).plan(START, GOAL)
        found.append((route.energy_j, route.shortest.energy_j, route.bound_j, route.points.tobytes()))
    return found


def make_network(folder: Path) -> None:
    """Write a copy of the shipped network."""
    shutil.copytree(str(SHIPPED_WEIGHTS), folder)


def make_calibrated(folder: Path) -> None:
    """Write a model that a calibration adds two effects to, with its base."""
    make_network(folder / BASE_FOLDER)
    terms = Term(RollingResistance(), (0.03,)), Term(Climbing(), (0.2,))
    version = load_model(folder / BASE_FOLDER).provenance()["version"]
    save_calibrated(folder, Correction(terms, terms), {"folder": BASE_FOLDER, "version": version})


def model_answers(folder: Path) -> list[Any]:
    """What a model says of itself and of a hill."""
    model, ground = load_model(folder), hill()
    found = model.traction_and_std(ground, jm.Robot(), ground.frame.window(13, 15, 18, 20), np.array([0.0, 1.0]))
    return [
        model.provenance(),
        getattr(model, "costs", None),
        *(None if one is None else one.tobytes() for one in found),
    ]


def make_directory(folder: Path) -> None:
    """Let a service keep a heightmap, runs, a cost map, and a calibration of a trained model."""
    from fastapi.testclient import TestClient  # with the test session's workers

    from joulemap.model.terrain.writers import write_geotiff
    from joulemap.service.http.app import create_app
    from tests.service.test_calibrations import ROBOT, hills, run_csv, send

    shutil.copytree(str(SHIPPED_WEIGHTS), folder / "models" / "mine")
    folder.chmod(0o700)
    wait = {"Prefer": "wait=300"}
    settings = settings_for(folder, read_seconds=100.0)  # on a busy machine too
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client:
        sent = client.post("/v1/heightmaps", content=write_geotiff(None, hills()))
        assert sent.status_code == 201, sent.text
        ground = sent.json()["id"]
        runs = send(client, *(run_csv(seed) for seed in range(4)), heightmap_id=ground).json()["id"]
        asked = {"heightmap_id": ground, "robot": ROBOT, "model": "mine"}
        made = client.post("/v1/calibrations", json={**asked, "runs": [runs], "quick": True}, headers=wait)
        assert made.status_code == 201, made.text
        made = client.post("/v1/costmaps", json={**asked, "model": "physics"}, headers=wait)
        assert made.status_code == 201, made.text


def _store(folder: Path) -> Store:
    return Store(folder, f"sqlite:///{folder / 'joulemap.db'}")


def _asked(store: Store, table: Any, row_id: str) -> list[Any]:
    """What is said of an object, and the files that are read of it."""
    found: list[Any] = [shown(store._row(table, "is no", id=row_id), ANSWERS[table]).model_dump(mode="json")]
    if table is HeightmapRow:
        found.append(store.intact_heightmap(row_id).read_bytes())
    elif table is RunsRow:
        found += [path.read_bytes() for path in store.run_files(row_id)]
    elif table is CalibrationRow:
        found += [
            path.read_bytes() for path in sorted(store.intact(table, row_id, store.path(table, row_id)).iterdir())
        ]
        found.append(load_model(store.folder / "models" / row_id).provenance())
    return found


def directory_answers(folder: Path, ids: dict[Any, list[str]]) -> dict[str, Any]:
    """What is said of each object: its answer, or None for an error."""
    store, found = _store(folder), dict[str, Any]()
    try:
        store.open()
        for table, row_id in ((table, row_id) for table, of_table in ids.items() for row_id in of_table):
            try:
                found[row_id] = _asked(store, table, row_id)
            except JoulemapError:
                found[row_id] = None
    finally:
        store.close()
    return found


def repaired(folder: Path) -> list[str]:
    """Repair a directory. Returns what a second check still finds that is neither left to a person nor to a backup."""
    store = _store(folder)
    try:
        store.open(alone=True)
        for last in (False, True):
            found = list(Check(store, folder, folder / "models", answers=ANSWERS).findings())
            if last:
                return [f"{one.kind} {one.what}: {one.words}" for one in found]
            for one in found:
                if one.repair is not None:
                    one.repair()
    finally:
        store.close()
    return []


def damage(folder: Path, rng: np.random.Generator, within: str = "**/*") -> str:
    """Flip one bit of a file, or delete it; of a database a page is overwritten. Returns what was done."""
    files = sorted(path for path in folder.glob(within) if path.is_file())
    chosen = files[rng.integers(len(files))]
    words, content = chosen.relative_to(folder).as_posix(), bytearray(chosen.read_bytes())
    if rng.random() < 0.25:
        if chosen.suffix != ".db":
            chosen.unlink()
            return f"{words} deleted"
        page = int(rng.integers(len(content) // _PAGE))
        content[page * _PAGE : (page + 1) * _PAGE] = bytes(_PAGE)
        chosen.write_bytes(content)
        return f"page {page} of {words} lost"
    at, bit = int(rng.integers(len(content))), int(rng.integers(8))
    content[at] ^= 1 << bit
    chosen.write_bytes(content)
    return f"bit {bit} of byte {at} of {words}"


def fuzz(
    count: int, seed: int, place: Path, make: Callable[[Path], None], ask: Callable[[Path], Any] = answers
) -> Damages:
    """Damage copies of what is made, and ask each."""
    whole, rng, found = place / "whole", np.random.default_rng(seed), Damages()
    make(whole)
    wanted = ask(whole)
    for _ in range(count):
        copy = place / "copy" / whole.name  # whose name answers have in them
        shutil.copytree(whole, copy)
        done = damage(copy, rng)
        try:
            same = ask(copy) == wanted
        except JoulemapError:
            found.outcomes["error"] += 1
        else:
            found.outcomes["same" if same else "other"] += 1
            if not same:
                found.others.append(done)
        shutil.rmtree(copy)
    return found


def fuzz_directory(count: int, seed: int, place: Path, within: str) -> Damages:
    """Damage copies of a data directory, ask each for all its objects, and repair it."""
    whole, rng, found = place / "whole", np.random.default_rng(seed), Damages()
    make_directory(whole)
    store = _store(whole)
    store.open()
    with store.sessions() as session:
        ids = {table: list(session.scalars(select(table.id))) for table in ANSWERS}
    store.close()
    wanted = directory_answers(whole, ids)
    assert None not in wanted.values(), wanted
    for number in range(count):
        copy = place / str(number)
        shutil.copytree(whole, copy)
        done = damage(copy, rng, within)
        try:
            said = directory_answers(copy, ids)
        except JoulemapError:
            found.outcomes["error"] += 1
            found.outcomes["refused at the start"] += 1
        except SQLAlchemyError as error:
            found.outcomes["other"] += 1
            found.others.append(f"{done}: {str(error)[:200]}")
        else:
            others = [row_id for row_id, one in said.items() if one not in (None, wanted[row_id])]
            found.others += [f"{done}: {row_id}: {_difference(said[row_id], wanted[row_id])}" for row_id in others]
            found.outcomes["other" if others else "same" if said == wanted else "error"] += 1
            left = repaired(copy)
            found.outcomes["left after a repair"] += bool(left)
            found.left += [f"{done}: {one}" for one in left]
        shutil.rmtree(copy)
    return found


def _difference(said: list[Any], wanted: list[Any]) -> str:
    now, then = said[0], wanted[0]
    return ", ".join(f"{k}: {now.get(k)} for {then[k]}" for k in then if now.get(k) != then[k]) or "its files"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.damages", description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="damages of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--of", choices=KINDS, action="append", help="default: all")
    wanted = parser.parse_args()
    others = 0
    for name in wanted.of or KINDS:
        with tempfile.TemporaryDirectory() as folder:
            found = KINDS[name](wanted.count, wanted.seed, Path(folder))
        print(f"{name}: {found.line()}", *found.others, sep="\n  ", flush=True)
        print(*found.left, sep="\n  left: ", flush=True)
        others += len(found.others)
    return 1 if others else 0


KINDS: dict[str, Callable[[int, int, Path], Damages]] = {
    "map": lambda *how: fuzz(*how, make_map),
    "older-map": lambda *how: fuzz(*how, lambda folder: (make_map(folder), make_older(folder))[0]),
    "network": lambda *how: fuzz(*how, make_network, model_answers),
    "calibrated": lambda *how: fuzz(*how, make_calibrated, model_answers),
    "database": lambda *how: fuzz_directory(*how, "joulemap.db"),
    "runs": lambda *how: fuzz_directory(*how, "runs/**/*"),
    "heightmaps": lambda *how: fuzz_directory(*how, "heightmaps/*"),
    "calibrations": lambda *how: fuzz_directory(*how, "[cm][ao][ld][ie][bl]*/cal-*/**/*"),
}


if __name__ == "__main__":
    sys.exit(main())
