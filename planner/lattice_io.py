"""A cost lattice on disk: saved as zarr, exported as npz and GeoTIFF."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from model.errors import InputError, JoulemapError
from model.frames import GridFrame, heading_bins
from model.robot import Robot
from model.terrain.writers import write_bands_geotiff
from planner.lattice import Blocked, CostLattice

FORMAT = "joulemap.cost-lattice/1"
_ARRAYS = ("traction_per_m", "elevation_m", "gradient", "blocked")
_OPTIONAL = ("std_j",)


def save_lattice(lattice: CostLattice, path: str | Path) -> None:
    """Write `path` (a folder, usually NAME.zarr), whole or not at all: it is built beside and moved into place."""
    path = Path(path)
    if path.exists() and not _is_lattice(path):
        raise InputError(f"{path} exists and is not a cost lattice: it will not be overwritten", path=str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    group = zarr.open_group(partial, mode="w")
    for name in (*_ARRAYS, *_OPTIONAL):
        data = getattr(lattice, name)
        if data is None:
            continue
        chunks = tuple(min(256, n) for n in data.shape[:2]) + data.shape[2:]
        group.create_array(name, data=data, chunks=chunks)
    group.attrs.update(_metadata(lattice))
    shutil.rmtree(path, ignore_errors=True)
    partial.rename(path)


def _is_lattice(path: Path) -> bool:
    if not (path / "zarr.json").is_file():
        return False
    node = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
    return str(node.get("attributes", {}).get("format", "")).startswith(FORMAT.split("/")[0])


def load_lattice(path: str | Path) -> CostLattice:
    """Read a folder written by `save_lattice`. Raises InputError when it is not one."""
    path = Path(path)
    if not (path / "zarr.json").is_file():
        raise InputError(
            f"{path} is not a cost lattice, which is a folder written by `joulemap costmap`", path=str(path)
        )
    group = zarr.open_group(path, mode="r")
    meta: dict[str, Any] = dict(group.attrs)
    if meta.get("format") != FORMAT:
        raise InputError(f"{path} holds format {meta.get('format')!r}, expected {FORMAT!r}", path=str(path))
    try:
        arrays = {name: np.ascontiguousarray(group[name][:]) for name in (*_ARRAYS, *_OPTIONAL) if name in group}  # type: ignore[index]
        return CostLattice(
            frame=GridFrame(**meta["frame"]),
            robot=Robot.from_mapping(meta["robot"]),
            provenance=meta["provenance"],
            **arrays,
        )
    except (KeyError, TypeError, JoulemapError) as error:
        raise InputError(f"{path} is a damaged cost lattice: {error}", path=str(path)) from error


def export_npz(lattice: CostLattice) -> bytes:
    """A compressed npz: energy_per_m, blocked (by heading), headings_rad, elevation_m, std_j where it is known, and the
    metadata as JSON."""
    out = io.BytesIO()
    known: dict[str, Any] = {} if lattice.std_j is None else {"std_j": lattice.std_j}
    np.savez_compressed(
        out,
        energy_per_m=lattice.energy_per_m,
        blocked=lattice.blocked_by_heading(),
        headings_rad=heading_bins(lattice.headings),
        elevation_m=lattice.elevation_m,
        metadata=json.dumps(_metadata(lattice)),
        **known,
    )
    return out.getvalue()


def export_geotiff(lattice: CostLattice) -> bytes:
    """A GeoTIFF with one float32 band per heading [J/m]; NaN (nodata) where that heading is blocked."""
    energy = np.where(lattice.blocked_by_heading() == Blocked.FREE, lattice.energy_per_m, np.float32(np.nan))
    headings_deg = np.rad2deg(heading_bins(lattice.headings))
    written = write_bands_geotiff(
        None,
        np.ascontiguousarray(np.moveaxis(energy, 2, 0)),
        lattice.frame,
        descriptions=[f"energy per metre [J/m] at heading {h:g} deg" for h in headings_deg],
        tags={"JOULEMAP": json.dumps(_metadata(lattice))},
    )
    assert written is not None
    return written


def _metadata(lattice: CostLattice) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "frame": asdict(lattice.frame),
        "robot": lattice.robot.as_dict(),
        "provenance": lattice.provenance,
        "blocked_codes": {str(int(reason)): reason.label for reason in Blocked},
        "units": {
            "traction_per_m": "J/m",
            "std_j": "J of a 1 m segment",
            "elevation_m": "m",
            "gradient": "m/m towards east, north",
        },
    }
