"""`python -m tests.fuzz.damages --count 200`: bits flipped and files deleted in cost maps; no answer may change.

Each damage is done to a copy of its own, which is asked in memory and from disk. One that was written by an older
version has no checksums: they are taken when it is first opened, before the damage.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import joulemap as jm
from joulemap.model.errors import DamagedError
from joulemap.model.frames import GridFrame
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.io import LatticeFolder, load_lattice
from joulemap.planner.lattice.tiles import Tiling
from tests.reference.lattices import surface_lattice

START, GOAL = (3.2, 4.1), (35.7, 28.3)
_ROWS, _COLS, _TILE = 33, 40, 16


@dataclass
class Damages:
    """What came of them."""

    outcomes: Counter[str] = field(default_factory=Counter)
    others: list[str] = field(default_factory=list)

    def line(self) -> str:
        """The figures in a line."""
        count = sum(self.outcomes.values())
        return (
            f"{count} damages: {self.outcomes['error']} errors, {self.outcomes['same']} same answers, "
            f"{len(self.others)} other numbers"
        )


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


def damage(folder: Path, rng: np.random.Generator) -> str:
    """Flip one bit of a file, or delete it. Returns what was done."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    chosen = files[rng.integers(len(files))]
    words = chosen.relative_to(folder).as_posix()
    if rng.random() < 0.25:
        chosen.unlink()
        return f"{words} deleted"
    content = bytearray(chosen.read_bytes())
    at, bit = int(rng.integers(len(content))), int(rng.integers(8))
    content[at] ^= 1 << bit
    chosen.write_bytes(content)
    return f"bit {bit} of byte {at} of {words}"


def fuzz(count: int, seed: int, place: Path, *, older: bool) -> Damages:
    """Damage copies of a map, and ask each."""
    whole, rng, found = place / "whole.zarr", np.random.default_rng(seed), Damages()
    make_map(whole)
    if older:
        make_older(whole)
    wanted = answers(whole)
    for number in range(count):
        copy = place / f"{number}.zarr"
        shutil.copytree(whole, copy)
        done = damage(copy, rng)
        try:
            same = answers(copy) == wanted
        except DamagedError:
            found.outcomes["error"] += 1
        else:
            found.outcomes["same" if same else "other"] += 1
            if not same:
                found.others.append(done)
        shutil.rmtree(copy)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.damages", description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="damages of each map")
    parser.add_argument("--seed", type=int, default=0)
    wanted = parser.parse_args()
    others = 0
    for name, older in (("a new map", False), ("a map of the version before", True)):
        with tempfile.TemporaryDirectory() as folder:
            found = fuzz(wanted.count, wanted.seed, Path(folder), older=older)
        print(f"{name}: {found.line()}", *found.others, sep="\n  ", flush=True)
        others += len(found.others)
    return 1 if others else 0


if __name__ == "__main__":
    sys.exit(main())
