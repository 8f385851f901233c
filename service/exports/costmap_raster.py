"""GeoTIFF of a whole cost map, plain or cloud-optimised: energies, why headings are blocked, deviations."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.transform import Affine

from joulemap.model.frames import heading_bins
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.npz import metadata_json

_TILE = 256  # pixels: a window of a big map is read without the rest of its rows
_Band = tuple[NDArray[np.float32], str, str, dict[str, str]]


def write(lattice: CostLattice) -> dict[str, bytes]:
    """Return a cost map as a GeoTIFF.

    Result: with K headings, float32 bands 1 to K are the energy per metre [J/m], NaN (nodata) where the heading is
    blocked; K + 1 to 2 K why it is blocked, a `Blocked` code; 2 K + 1 to 3 K, where the model knows it, the standard
    deviation of the energy of a metre [J]. Each has a description, a unit and the tags KIND and HEADING_DEG.
    """
    return {".tif": _file(lattice, cloud_optimised=False)}


def write_cloud_optimised(lattice: CostLattice) -> dict[str, bytes]:
    """Return the same as a cloud-optimised GeoTIFF: tiled, with overviews, to be read in parts over HTTP.

    Result: ".tif" -> the file, bands as in `write`.
    """
    return {".tif": _file(lattice, cloud_optimised=True)}


def _file(lattice: CostLattice, *, cloud_optimised: bool) -> bytes:
    frame, parts = lattice.frame, 2 if lattice.std_j is None else 3
    profile: dict[str, Any] = {
        "driver": "GTiff",
        "width": frame.cols,
        "height": frame.rows,
        "count": parts * lattice.headings,
        "dtype": "float32",
        "crs": frame.crs,
        "transform": Affine(frame.resolution_m, 0.0, frame.west_m, 0.0, -frame.resolution_m, frame.north_m),
        "nodata": float("nan"),
        "compress": "deflate",
        "predictor": 3,
        "interleave": "band",
        "bigtiff": "if_safer",
        **({"tiled": True, "blockxsize": _TILE, "blockysize": _TILE} if min(frame.shape) > 2 * _TILE else {}),
    }
    with tempfile.TemporaryDirectory() as folder, rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_CACHEMAX=128):
        place = Path(folder) / "map.tif"
        with rasterio.open(place, "w", **profile) as file:
            for number, (values, words, unit, tags) in enumerate(_bands(lattice), start=1):
                file.write(values, number)
                file.set_band_description(number, words)
                file.set_band_unit(number, unit)
                file.update_tags(number, **tags)
            file.update_tags(JOULEMAP=metadata_json(lattice))
        if cloud_optimised:  # nearest: codes have no mean
            how = {"compress": "deflate", "predictor": "yes", "overview_resampling": "nearest", "bigtiff": "if_safer"}
            rasterio.shutil.copy(place, Path(folder) / "cog.tif", driver="COG", blocksize=_TILE, **how)
            place = Path(folder) / "cog.tif"
        return place.read_bytes()


def _bands(lattice: CostLattice) -> Iterator[_Band]:
    """Values, words, unit and tags of each band, one after another: all at once would be a second map in memory."""
    headings = heading_bins(lattice.headings)
    degrees = [f"{value:g}" for value in np.rad2deg(headings)]

    def _tags(kind: str, k: int) -> dict[str, str]:
        return {"KIND": kind, "HEADING_DEG": degrees[k]}

    for k in range(lattice.headings):
        free = lattice.blocked_at(headings[k : k + 1])[..., 0] == Blocked.FREE
        energy = np.where(free, lattice.energy_per_m[..., k], np.float32(np.nan))
        yield energy, f"energy per metre [J/m] at heading {degrees[k]} deg", "J/m", _tags("energy_per_m", k)
    codes = {str(int(reason)): reason.label for reason in Blocked}
    for k in range(lattice.headings):
        why = lattice.blocked_at(headings[k : k + 1])[..., 0].astype(np.float32)
        tags = _tags("blocked", k) | {"BLOCKED_CODES": json.dumps(codes)}
        yield why, f"why heading {degrees[k]} deg is blocked, a code", "1", tags
    if lattice.std_j is not None:
        for k in range(lattice.headings):
            words = f"standard deviation of the energy of a metre [J] at heading {degrees[k]} deg"
            yield lattice.std_j[..., k], words, "J", _tags("std_j", k)
