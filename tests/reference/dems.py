"""Ten and more DEMs in other coordinate systems, reprojected by joulemap, by GDAL's own warp, and judged by PROJ.

python -m tests.reference.dems
"""

import math
from dataclasses import dataclass

import numpy as np
import rasterio
from pyproj import Geod, Transformer
from rasterio import warp
from rasterio.transform import Affine
from scipy import ndimage

from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.library.heightmaps import read_heightmap

ROWS, COLS = 90, 110


def surface(lon, lat, lon0, lat0):
    """Smooth heights [m] by place on Earth; true metres east and north of a place near by."""
    east = (lon - lon0) * 111_320.0 * math.cos(math.radians(lat0))
    north = (lat - lat0) * 110_574.0
    return 300.0 + 0.03 * east - 0.02 * north + 4.0 * np.sin(east / 190.0) * np.cos(north / 230.0)


def made(crs, transform, *, dtype="float32", hole=False, unit=None, scale=1.0, flip=False):
    """A GeoTIFF of the surface on a grid of any kind, and the place about which it lies."""
    row, col = np.mgrid[0:ROWS, 0:COLS]
    x, y = transform @ (col + 0.5, row + 0.5)
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)
    lon0, lat0 = float(lon[ROWS // 2, COLS // 2]), float(lat[ROWS // 2, COLS // 2])
    heights = (surface(lon, lat, lon0, lat0) * scale).astype(dtype)
    options = {}
    if hole:
        heights[20:30, 40:50] = -9999
        options["nodata"] = -9999
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=COLS, height=ROWS, count=1, dtype=dtype, crs=crs, transform=transform, **options
        ) as dataset:
            dataset.write(heights, 1)
            if unit:
                dataset.set_band_unit(1, unit)
        return bytes(memory.getbuffer()), lon0, lat0


CURVATURE = 4.0 / 190.0**2 + 4.0 / 230.0**2
"""Most of the surface [1/m]."""

SECOND = 1 / 3600


def inner(known):
    """Cells around which all cells are known."""
    return ndimage.binary_erosion(known, np.ones((3, 3)), iterations=2)


CASES = {  # CRS, transform, what else, the CRS that "auto" takes
    "degrees": ("EPSG:4326", Affine(SECOND, 0, -4.5, 0, -SECOND, 36.74), {}, "EPSG:32630"),
    "degrees, south": ("EPSG:4326", Affine(SECOND, 0, 147.3, 0, -SECOND, -42.86), {"hole": True}, "EPSG:32755"),
    "degrees, south-up": ("EPSG:4326", Affine(SECOND, 0, 8.5, 0, SECOND, 47.2), {}, "EPSG:32632"),
    "degrees, other datum": ("EPSG:4269", Affine(SECOND, 0, -93.2, 0, -SECOND, 44.95), {}, "EPSG:32615"),
    "feet": (
        "EPSG:2227",
        Affine(10, 0, 6_050_000, 0, -10, 2_110_000),
        {"unit": "ft", "scale": 1 / 0.3048},
        "EPSG:32610",
    ),
    "Web Mercator": ("EPSG:3857", Affine(5, 0, 1_000_000, 0, -5, 6_000_000), {}, "EPSG:32632"),
    "polar, north": ("EPSG:3413", Affine(10, 0, -300_000, 0, -10, -400_000), {"hole": True}, None),
    "polar, south": ("EPSG:3031", Affine(8, 0, 350_000, 0, -8, -1_200_000), {}, "EPSG:32758"),
    "rotated": (
        "EPSG:32630",
        Affine.translation(367_000, 4_064_000) @ Affine.rotation(25) @ Affine.scale(2, -2),
        {},
        "EPSG:32630",
    ),
    "not square": ("EPSG:32630", Affine(2, 0, 367_000, 0, -3, 4_064_000), {"hole": True}, "EPSG:32630"),
    "LAEA": ("EPSG:3035", Affine(10, 0, 2_700_000, 0, -10, 3_600_000), {}, None),
}


@dataclass(frozen=True)
class Judged:
    """A reprojected DEM beside the truth.

    Attributes
    ----------
    found : Heightmap
        As joulemap reads it.
    inner_m, worst_m : float
        Largest error of a height, among cells surrounded by known ones and among all [m].
    bound_m : float
        Largest error of bilinear interpolation: cell^2 / 8 of both second derivatives, and as much again because GDAL
        widens its kernel for wider cells [m].
    area, length : float
        Error of the area of the map, and of the distance between two places on it, against the geodesic, as shares.
    covered : float
        Area of the known cells beside that of the file's known cells, minus 1.
    """

    found: Heightmap
    inner_m: float
    worst_m: float
    bound_m: float
    area: float
    length: float
    covered: float


def judged(name):
    """Reproject one of the DEMs, and compare it with the surface that is known everywhere."""
    crs, transform, how, _ = CASES[name]
    content, lon0, lat0 = made(crs, transform, **how)
    found = read_heightmap(content, filename="dem.tif", reproject="auto")
    frame = found.frame
    row, col = np.mgrid[0 : frame.rows, 0 : frame.cols]
    lon, lat = Transformer.from_crs(frame.crs, "EPSG:4326", always_xy=True).transform(*frame.xy(row, col))
    known = ~np.isnan(found.heights)
    wrong = np.abs(found.heights - surface(lon, lat, lon0, lat0))
    corner = [transform @ place for place in ((0, 0), (COLS, 0), (COLS, ROWS), (0, ROWS))]
    geographic = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    edge = np.array([geographic.transform(*place) for place in corner])
    area = abs(Geod(ellps="WGS84").polygon_area_perimeter(edge[:, 0], edge[:, 1])[0])
    cells = ROWS * COLS - (100 if how.get("hole") else 0)
    ends = [geographic.transform(*transform @ (COLS * a, ROWS * b)) for a, b in ((0.1, 0.5), (0.9, 0.4))]
    true = Geod(ellps="WGS84").inv(*ends[0], *ends[1])[2]
    there = Transformer.from_crs("EPSG:4326", frame.crs, always_xy=True)
    (x0, y0), (x1, y1) = (there.transform(*place) for place in ends)
    x, y = np.array([there.transform(*place) for place in edge]).T
    flat = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    return Judged(
        found,
        float(wrong[inner(known)].max()),
        float(wrong[known].max()),
        0.3 * frame.resolution_m**2 * CURVATURE + 1e-3,
        flat / area - 1,
        math.hypot(x1 - x0, y1 - y0) / true - 1,
        known.sum() * frame.resolution_m**2 / (area * cells / (ROWS * COLS)) - 1,
    )


def beside_gdal(name, found):
    """Largest difference of heights to GDAL's warp on the same grid [m], and share of cells that one alone knows."""
    crs, transform, how, _ = CASES[name]
    content, _, _ = made(crs, transform, **how)
    frame = found.frame
    grid = Affine(frame.resolution_m, 0, frame.west_m, 0, -frame.resolution_m, frame.north_m)
    with rasterio.MemoryFile(content) as memory, memory.open() as dataset:
        theirs = np.full(frame.shape, np.nan, np.float32)
        warp.reproject(
            rasterio.band(dataset, 1),
            theirs,
            dst_transform=grid,
            dst_crs=frame.crs,
            dst_nodata=math.nan,
            resampling=warp.Resampling.bilinear,
            tolerance=0.0,
            XSCALE="1",
            YSCALE="1",
        )
    if how.get("unit") == "ft":
        theirs *= np.float32(0.3048)
    both = inner(~np.isnan(theirs) & ~np.isnan(found.heights))
    apart = (np.isnan(theirs) ^ np.isnan(found.heights)).mean()
    return float(np.abs(theirs - found.heights)[both].max()), float(apart)


def main():
    """Print a line for each DEM."""
    print(
        f"{'DEM':21}{'to':12}{'cell':>7} {'heights':>9} {'(bound)':>9} {'GDAL warp':>10} {'area':>9} {'length':>9}   "
        "m, m, m, %, %"
    )
    for name in CASES:
        one = judged(name)
        gdal_m, _ = beside_gdal(name, one.found)
        print(
            f"{name:21}{one.found.frame.crs[:10]:12}{one.found.resolution_m:7.2f} {one.inner_m:9.4f} "
            f"{one.bound_m:9.4f} {gdal_m:10.4f} {100 * one.area:+9.4f} {100 * one.length:+9.4f}"
        )


if __name__ == "__main__":
    main()
