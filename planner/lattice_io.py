"""A cost lattice on disk: written as zarr, whole or tile by tile, and exported as npz and GeoTIFF."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from joulemap.model.errors import InputError, JoulemapError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.writers import write_bands_geotiff
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.tiles import TILE_CELLS, Tiling

FORMAT = "joulemap.cost-lattice/1"
_ARRAYS = ("traction_per_m", "elevation_m", "gradient", "blocked")
_OPTIONAL = ("std_j",)
_COMPRESSOR = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")  # noise of the last bits does not compress: be quick


class LatticeFolder:
    """A lattice on its way to disk. It is built beside its place, `path`.partial, and moved there by `finish`.

    Tiles may come in any order, again, and from several processes that share the folder: a tile is whole chunks.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + ".partial")

    def lay_out(self, tiling: Tiling, robot: Robot, *, with_std: bool) -> None:
        """Make the empty arrays, and throw away what an earlier try left.

        Raises InputError where `path` exists and is no lattice.
        """
        if self.path.exists() and not _is_lattice(self.path):
            raise InputError(
                f"{self.path} exists and is not a cost lattice: it will not be overwritten", path=str(self.path)
            )
        self.path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(self.partial, ignore_errors=True)
        group = zarr.open_group(self.partial, mode="w")
        by_heading, side = (tiling.headings,), tiling.side
        arrays: dict[str, tuple[tuple[int, ...], str, float]] = {
            "traction_per_m": (by_heading, "float32", np.nan),
            "elevation_m": ((), "float32", np.nan),
            "gradient": ((2,), "float32", np.nan),
            "blocked": ((), "uint8", int(Blocked.UNKNOWN)),
        }
        if with_std:
            arrays["std_j"] = (by_heading, "float32", np.nan)
        for name, (more, dtype, unknown) in arrays.items():
            shape = (*tiling.frame.shape, *more)
            chunks = (*(min(side, n) for n in tiling.frame.shape), *more)
            group.create_array(
                name, shape=shape, chunks=chunks, dtype=dtype, fill_value=unknown, compressors=_COMPRESSOR
            )
        group.attrs.update(_metadata(tiling.frame, robot))

    def write(self, part: CostLattice, rows: slice, cols: slice) -> None:
        """Keep the cells of one tile."""
        group = zarr.open_group(self.partial, mode="r+")
        for name in (*_ARRAYS, *_OPTIONAL):
            data = getattr(part, name)
            if data is not None:
                group[name][rows, cols] = data  # type: ignore[index]

    def finish(self, provenance: dict[str, Any]) -> None:
        """Say how the lattice was made, and move it into place where it is not there yet."""
        if self.partial.exists():
            for torn in self.partial.rglob("*.partial"):  # a chunk whose writer was killed; it was written again
                torn.unlink()
            zarr.open_group(self.partial, mode="r+").attrs["provenance"] = provenance
            shutil.rmtree(self.path, ignore_errors=True)
            self.partial.rename(self.path)
        else:
            zarr.open_group(self.path, mode="r+").attrs["provenance"] = provenance

    def discard(self) -> None:
        """Remove it, finished or not."""
        for place in (self.partial, self.path):
            shutil.rmtree(place, ignore_errors=True)


def save_lattice(lattice: CostLattice, path: str | Path) -> None:
    """Write `path` (a folder, usually NAME.zarr), whole or not at all: it is built beside and moved into place."""
    folder = LatticeFolder(path)
    tiling = Tiling(lattice.frame, lattice.headings, TILE_CELLS)
    folder.lay_out(tiling, lattice.robot, with_std=lattice.std_j is not None)
    folder.write(lattice, slice(0, lattice.frame.rows), slice(0, lattice.frame.cols))
    folder.finish(lattice.provenance)


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
    metadata as JSON.
    """
    out = io.BytesIO()
    known: dict[str, Any] = {} if lattice.std_j is None else {"std_j": lattice.std_j}
    np.savez_compressed(
        out,
        energy_per_m=lattice.energy_per_m,
        blocked=lattice.blocked_by_heading(),
        headings_rad=heading_bins(lattice.headings),
        elevation_m=lattice.elevation_m,
        metadata=_exported(lattice),
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
        tags={"JOULEMAP": _exported(lattice)},
    )
    assert written is not None
    return written


def _metadata(frame: GridFrame, robot: Robot) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "frame": asdict(frame),
        "robot": robot.as_dict(),
        "blocked_codes": {str(int(reason)): reason.label for reason in Blocked},
        "units": {
            "traction_per_m": "J/m",
            "std_j": "J of a 1 m segment",
            "elevation_m": "m",
            "gradient": "m/m towards east, north",
        },
    }


def _exported(lattice: CostLattice) -> str:
    return json.dumps({**_metadata(lattice.frame, lattice.robot), "provenance": lattice.provenance})
