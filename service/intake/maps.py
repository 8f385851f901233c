"""Reads a heightmap that was sent, and writes it as the service keeps it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from joulemap.model.terrain.plausible import heightmap_warnings
from joulemap.model.terrain.readers import read_sent
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.intake.guard import Guard
from joulemap.service.storage.stats import heightmap_stats


def read_map(
    *, guard: Guard, path: str, out: str, name: str, max_cells: int, options: dict[str, Any]
) -> dict[str, Any]:
    """Read a heightmap or a layer and write it as a GeoTIFF. Result: what a listing says about it, JSON-able."""
    layer = options.pop("layer", False)
    as_numbers = {"nearest": True, "noise_m": 0.0, "scale_m": options.get("scale_m") or 1.0} if layer else {}
    with guard.reading(Path(path)):
        heightmap = read_sent(path, filename=name, max_cells=max_cells, **options | as_numbers)
    with guard.keeping(heightmap.heights.size):
        stats = heightmap_stats(heightmap, band=options.get("band"))
        stats["notes"] = [*heightmap.notes, *(() if layer else heightmap_warnings(heightmap))]
        stats["layer"] = layer
        write_geotiff(out, heightmap, quick=True)
    return stats


def load_gdal() -> None:
    """Load GDAL and PROJ with the formats that need them."""
    from joulemap.model.terrain import coordinate_systems
    from joulemap.model.terrain.formats import raster

    assert raster.recognise(b"II*\0", "")
    coordinate_systems.crs_name("EPSG:32630")
