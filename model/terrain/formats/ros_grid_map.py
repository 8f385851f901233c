"""Maps of robots in recordings: the last grid_map_msgs/GridMap and the last nav_msgs/OccupancyGrid.

The grid map has the heights, in its layer `elevation`. Where there is an occupancy grid too, what it says is occupied
is a hole, which no route crosses. An occupancy grid alone holds no heights, unless the user says what a count is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, JoulemapError
from joulemap.model.recordings.contract import Topic
from joulemap.model.recordings.kinds import is_recording, open_recording
from joulemap.model.recordings.types import short_type
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Decoded, Scaling, check_cells

_GRID_MAP, _OCCUPANCY = "grid_map_msgs/GridMap", "nav_msgs/OccupancyGrid"
_LAYERS = ("elevation", "elevation_inpainted", "elevation_smooth", "height")
_STRAIGHT = 1e-6
_OCCUPIED = 65  # of 100: the default `occupied_thresh` of Nav2's map server
_UNKNOWN = -1


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of a recording. Result: True for an MCAP recording or a ROS bag."""
    return is_recording(head)


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read the last maps of the recording; their frame is taken for the plane of the map."""
    read: list[str] = []
    try:
        found, topics, notes = _last_maps(source, read)
        heights, occupied = found.get(_GRID_MAP), found.get(_OCCUPANCY)
        if heights is None and occupied is None:
            there = ", ".join(sorted({topic.kind or topic.name for topic in topics.values()}))[:200] or "none"
            raise HeightmapError(f"{source.name} holds no message {_GRID_MAP}; its types are {there}")
        if heights is None:
            return _occupancy_heights(occupied, scaling, max_cells, source.name)
        return _elevation(heights, occupied, scaling, max_cells, band, source.name, notes)
    except (JoulemapError, MemoryError):
        raise
    except ImportError as error:
        raise HeightmapError(
            f"{source.name} is a recording; the library {error.name} that reads it is not installed: pip install "
            "'joulemap[logs]'"
        ) from error
    except Exception as error:  # the libraries do not say what they raise on a broken file
        what = str(error).split("\n")[0][:200] or type(error).__name__
        raise HeightmapError(f"the recording is truncated or corrupt after {len(read):,} maps: {what}") from error


def _last_maps(source: SourceFile, read: list[str]) -> tuple[dict[str, Any], dict[str, Topic], list[str]]:
    """The last message of each type of map, all topics, and what is to be known of the file; counts in `read`."""
    found: dict[str, Any] = {}
    with open_recording(source) as recording:
        for topic, _, message in recording.messages(lambda one: short_type(one.kind) in (_GRID_MAP, _OCCUPANCY)):
            found[short_type(topic.kind)] = message
            read.append(topic.name)
        return found, dict(recording.topics), list(recording.notes)


def _elevation(
    message: Any, occupied: Any, scaling: Scaling, max_cells: int, band: int | None, name: str, notes: list[str]
) -> Decoded:
    layer = _layer(list(message.layers), band)
    matrix = _matrix(message.data[layer], max_cells, name)
    rows, cols = matrix.shape  # rows along x, columns along y, both falling
    matrix = np.roll(matrix, (-int(message.outer_start_index), -int(message.inner_start_index)), (0, 1))
    pose, side = message.info.pose, float(message.info.resolution)
    _check_straight(pose, "grid map")
    west, north = float(pose.position.x - rows * side / 2), float(pose.position.y + cols * side / 2)
    _check_place(side, west, north, "grid map")
    heights = scaling.to_metres(
        np.ascontiguousarray(matrix[::-1].T), known=~np.isnan(matrix[::-1].T)
    )  # north, west first
    if occupied is not None:
        frame, other = str(message.header.frame_id)[:80], str(occupied.header.frame_id)[:80]
        if frame == other:
            holes = _occupied_cells(occupied, heights.shape, west, north, side, max_cells, name)
            heights[holes] = np.nan
            words = f"{int(holes.sum()):,} cells are holes, because the occupancy grid says that they are occupied"
        else:
            words = f"the occupancy grid was left out: it is in the frame {other!r}, the grid map in {frame!r}"
        notes = [*notes, words]
    return Decoded(heights, west_m=west, north_m=north, resolution_m=side, notes=tuple(notes))


def _occupied_cells(
    message: Any, shape: tuple[int, ...], west: float, north: float, side: float, max_cells: int, name: str
) -> NDArray[np.bool_]:
    """Where a cell of the heights holds the centre of an occupied cell, or has its own centre in one."""
    values, grid_west, grid_north, cell = _occupancy(message, max_cells, name)
    occupied = values >= _OCCUPIED
    holes = np.zeros(shape, dtype=np.bool_)
    row, col = np.nonzero(occupied)
    i = np.floor((north - (grid_north - (row + 0.5) * cell)) / side).astype(np.int64)
    j = np.floor((grid_west + (col + 0.5) * cell - west) / side).astype(np.int64)
    inside = (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
    holes[i[inside], j[inside]] = True
    i = np.floor((grid_north - (north - (np.arange(shape[0]) + 0.5) * side)) / cell).astype(np.int64)
    j = np.floor((west + (np.arange(shape[1]) + 0.5) * side - grid_west) / cell).astype(np.int64)
    inside_i, inside_j = (i >= 0) & (i < values.shape[0]), (j >= 0) & (j < values.shape[1])
    holes[np.ix_(inside_i, inside_j)] |= occupied[np.ix_(i[inside_i], j[inside_j])]
    return holes


def _occupancy_heights(message: Any, scaling: Scaling, max_cells: int, name: str) -> Decoded:
    if scaling.scale_m is None:
        raise HeightmapError(
            f"{name} holds an OccupancyGrid and no GridMap: occupancy is no height. Record the elevation map of the "
            "robot too; or, if the values are heights, give `scale_m` (--scale), the metres of one count"
        )
    values, west, north, side = _occupancy(message, max_cells, name)
    heights = scaling.to_metres(values.astype(np.float32), known=values != _UNKNOWN)
    return Decoded(heights, west_m=west, north_m=north, resolution_m=side)


def _occupancy(message: Any, max_cells: int, name: str) -> tuple[NDArray[np.int8], float, float, float]:
    """Values with the northern row first, the western and northern edge [m], and the side of a cell [m]."""
    rows, cols, side = int(message.info.height), int(message.info.width), float(message.info.resolution)
    check_cells(rows, cols, max_cells, what=name)
    values = np.asarray(message.data, dtype=np.int8)
    if values.size != rows * cols:
        raise HeightmapError(f"the occupancy grid is corrupt: {rows} x {cols} cells declared, {values.size} there")
    _check_straight(message.info.origin, "occupancy grid")
    place = message.info.origin.position
    west, north = float(place.x), float(place.y) + rows * side
    _check_place(side, west, north, "occupancy grid")
    return values.reshape(rows, cols)[::-1], west, north, side


def _check_straight(pose: Any, what: str) -> None:
    turn = pose.orientation
    if max(abs(turn.x), abs(turn.y), abs(turn.z)) > _STRAIGHT:
        raise HeightmapError(f"the {what} is turned in its frame: record it in the frame of the map")


def _check_place(side: float, west: float, north: float, what: str) -> None:
    if not (side > 0 and math.isfinite(side) and math.isfinite(west) and math.isfinite(north)):
        raise HeightmapError(f"the {what}'s cells are {side:g} m, its place {west:g}, {north:g}: corrupt")


def _layer(layers: list[str], band: int | None) -> int:
    if band is not None:
        if not 1 <= band <= len(layers):
            raise HeightmapError(f"the grid map has the layers {', '.join(layers)[:200]}: `band` is 1 to {len(layers)}")
        return band - 1
    for name in _LAYERS:
        if name in layers:
            return layers.index(name)
    if len(layers) == 1:
        return 0
    raise HeightmapError(
        f"the grid map has no layer `elevation`; give `band`, the number of one of {', '.join(layers)[:200]}"
    )


def _matrix(message: Any, max_cells: int, name: str) -> NDArray[np.float32]:
    """The values of a layer, rows along x. Eigen writes column by column, and says so in the labels."""
    sizes = {each.label: int(each.size) for each in message.layout.dim}
    rows, cols = sizes.get("row_index", 0), sizes.get("column_index", 0)
    check_cells(rows, cols, max_cells, what=name)
    values = np.asarray(message.data, dtype=np.float32)
    if values.size != rows * cols:
        raise HeightmapError(f"the grid map is corrupt: {rows} x {cols} cells declared, {values.size} there")
    by_column = message.layout.dim[0].label == "column_index"
    return values.reshape(cols, rows).T if by_column else values.reshape(rows, cols)
