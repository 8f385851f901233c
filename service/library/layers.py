"""Layers as Python users give them: files, arrays, DataArrays, polygons, or a function of the place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers import Layer, Layers
from joulemap.model.terrain.layers.kinds import Legend, legend_of, read_legend
from joulemap.model.terrain.layers.layer import COST, KINDS, check_legend
from joulemap.model.terrain.layers.polygons import areas_document, polygon_layer
from joulemap.model.terrain.layers.reading import array_layer, layer_of, read_layer
from joulemap.service.library.heightmaps import ground_of, says_where

if TYPE_CHECKING:
    from joulemap.service.library.heightmaps import GroundLike

LayerLike = Any
"""A file, an array of as many cells as the heightmap, a DataArray, polygons, or for `cost` a function."""
LegendLike = Mapping[str, Any] | str | Path | None
"""Tables by name of the kind of ground, or their TOML file."""


def with_layers(
    ground: GroundLike,
    *,
    kinds: LayerLike = None,
    obstacles: LayerLike = None,
    free: LayerLike = None,
    factor: LayerLike = None,
    cost: LayerLike = None,
    height: LayerLike = None,
    legend: LegendLike = None,
) -> Heightmap:
    """Say what is known of the ground beside its height.

    A layer is a file (any raster that GDAL reads, in its own resolution and coordinate system; GeoJSON; for obstacles
    the YAML of a Nav2 map), an array with as many cells as the heightmap, a DataArray of xarray with its coordinates,
    polygons (of shapely or GeoPandas, or GeoJSON as a dict), or a list of these. It keeps its own resolution.

    Parameters
    ----------
    ground : Heightmap, str or Path
        The heightmap, or its file.
    kinds : layer, or dict of str to polygons, optional
        Kinds of ground. Of a raster the `legend` says which value is which; polygons have a property `kind`, or are
        given by name.
    obstacles : layer, optional
        What no part of the robot may be over: every number but 0. What is not known there is free.
    free : layer, optional
        The only ground that the robot may be over: every number but 0. What is not known is an obstacle.
    factor : layer, optional
        By which the energy that motion needs is multiplied, on top of what the model says.
    cost : layer or callable, optional
        Energy that is added [J/m], not below 0, as numbers, or as a function of x, y [m] and heading [rad] of n places.
    height : layer, optional
        Heights in place of the map's [m], as of bridges and ramps, where they are known. Polygons have a property
        `height`, or a height at each corner, between which they are linear.
    legend : dict, str or Path, optional
        A table for every kind of ground, or their TOML file: `value`, and `rolling_resistance` or `factor` with its
        `std`, or `blocked`. What is left out is that of the kind of this name in the library.

    Returns
    -------
    Heightmap
        The heightmap with these layers, in place of those that it had; heights of earlier layers stay.

    Raises
    ------
    InputError
        If a layer or the legend cannot be read, lies outside the map, or names a kind that is not in the legend.

    Examples
    --------
    >>> import numpy as np, joulemap as jm
    >>> meadow = jm.heightmap(np.zeros((40, 40)), resolution_m=0.5)
    >>> sand = np.zeros((40, 40))
    >>> sand[:, 20:] = 1
    >>> beach = jm.with_layers(meadow, kinds=sand, legend={"grass": {"value": 0}, "sand": {"value": 1}})
    >>> costs = jm.costmap(beach, model="physics")
    >>> costs.plan((2.0, 2.0), (2.0, 18.0)).energy_j < costs.plan((18.0, 2.0), (18.0, 18.0)).energy_j
    True
    """
    given = {"kinds": kinds, "obstacles": obstacles, "free": free, "factor": factor, "cost": cost, "height": height}
    check_legend(legend, [role for role, value in given.items() if value is not None])
    found, names = ground_of(ground), _legend(legend)
    layers = [
        _layer(role, one, found.frame, names)
        for role, value in given.items()
        if value is not None
        for one in _several(value)
    ]
    return found.with_layers(Layers(tuple(layers)))


def _legend(legend: LegendLike) -> Legend | None:
    if legend is None:
        return None
    return legend_of(legend) if isinstance(legend, Mapping) else read_legend(legend)


def _several(value: Any) -> list[Any]:
    """The layers of one role: bare polygons in a list are one."""
    if not isinstance(value, list):
        return [value]
    return [value] if value and all(_is_shape(one) for one in value) else value


def _is_shape(value: Any) -> bool:
    """Whether it is a geometry of shapely, without properties and CRS."""
    return hasattr(value, "__geo_interface__") and hasattr(value, "geom_type") and not hasattr(value, "crs")


def _layer(role: str, value: LayerLike, ground: GridFrame, legend: Legend | None) -> Layer:
    if isinstance(value, Layer):
        return value
    if isinstance(value, str | Path):
        return read_layer(role, value, ground, legend=legend)
    if callable(value) and not hasattr(value, "__array__"):
        if role != COST:
            raise InputError(f"a layer of {role} is no function: only `cost` may be one", role=role)
        return Layer(role, f"the function {getattr(value, '__name__', type(value).__name__)}", function=value)
    if says_where(value):
        return layer_of(role, _of_data_array(value), ground, legend=legend, source=str(value.name or "DataArray"))
    if hasattr(value, "__geo_interface__") or isinstance(value, Mapping | list):
        return polygon_layer(role, _document(role, value, ground), ground, legend=legend, source=f"the layer of {role}")
    return array_layer(role, np.asarray(value), ground, legend=legend)


def _of_data_array(value: Any) -> Any:
    from rasterio.transform import Affine

    from joulemap.model.terrain.layers.reading import Raster
    from joulemap.service.library.heightmaps import grid_of

    grid = grid_of(value)
    return Raster(
        grid.heights, Affine(grid.resolution_m, 0.0, grid.west_m, 0.0, -grid.resolution_m, grid.north_m), grid.crs
    )


def _document(role: str, value: Any, ground: GridFrame) -> Mapping[str, Any]:
    """Polygons as GeoJSON in the CRS of the map."""
    if isinstance(value, Mapping) and "type" in value:
        return value
    if isinstance(value, Mapping):
        if role != KINDS:
            raise InputError(f"a layer of {role} is no dict: give polygons, or GeoJSON", role=role)
        return areas_document(
            [(shape, {"kind": name}) for name, areas in value.items() for shape in _shapes(areas, ground)]
        )
    if isinstance(value, list):
        found: Mapping[str, Any] = areas_document([(shape.__geo_interface__, {}) for shape in value])
    else:
        own = getattr(value, "crs", None)
        there = value.to_crs(ground.crs) if own is not None and ground.crs is not None else value
        found = there.__geo_interface__
    return {**found, "crs": {"properties": {"name": ground.crs}}} if ground.crs is not None else dict(found)


def _shapes(areas: Any, ground: GridFrame) -> list[Any]:
    if hasattr(areas, "__geo_interface__"):
        areas = [areas]
    shapes = []
    for area in areas:
        own = getattr(area, "crs", None)
        there = area.to_crs(ground.crs) if own is not None and ground.crs is not None else area
        found = there.__geo_interface__ if hasattr(there, "__geo_interface__") else _polygon(there)
        shapes += [f["geometry"] for f in found["features"]] if found["type"] == "FeatureCollection" else [found]
    return shapes


def _polygon(corners: Any) -> dict[str, Any]:
    ring = [[float(x), float(y)] for x, y in corners]
    return {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
