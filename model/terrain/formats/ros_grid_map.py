"""Elevation maps of robots: the last grid_map_msgs/GridMap of an MCAP recording, its layer `elevation`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, JoulemapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.decoded import Decoded, Scaling, check_cells

_MAGIC = b"\x89MCAP0\r\n"
_KIND = "grid_map_msgs/msg/GridMap"
_LAYERS = ("elevation", "elevation_inpainted", "elevation_smooth", "height")
_LARGEST_RECORD = 1 << 30
_STRAIGHT = 1e-6


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of MCAP.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for an MCAP recording.
    """
    return head.startswith(_MAGIC)


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read the last map of the recording; its frame is taken for the plane of the map.

    Parameters
    ----------
    source : SourceFile
        The recording.
    scaling : Scaling
        How heights become metres.
    max_cells : int
        Largest number of cells.
    band : int, optional
        Number of the layer, from 1; without it, the layer `elevation`, or the only one.

    Returns
    -------
    Decoded
        Heights and place.

    Raises
    ------
    HeightmapError
        If the recording is broken, or has no such map.
    TooLargeError
        If the map has more than `max_cells` cells.
    """
    try:
        return _decoded(source, scaling, max_cells, band)
    except (JoulemapError, MemoryError):
        raise
    except ImportError as error:
        raise HeightmapError(
            f"{source.name} is an MCAP recording; the library {error.name} that reads it is not installed: pip install "
            "'joulemap[logs]'"
        ) from error
    except Exception as error:  # the libraries do not say what they raise on a broken file
        what = str(error).split("\n")[0][:200] or type(error).__name__
        raise HeightmapError(f"the MCAP recording is truncated or corrupt: {what}") from error


def _decoded(source: SourceFile, scaling: Scaling, max_cells: int, band: int | None) -> Decoded:
    from mcap.reader import SeekingReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found: tuple[str, bytes] | None = None
    kinds: set[str] = set()
    with source.open() as stream:
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        for schema, channel, record in reader.iter_messages(log_time_order=False):
            kinds.add(schema.name if schema is not None else "")
            if schema is not None and schema.name == _KIND and channel.message_encoding == "cdr":
                found = schema.data.decode("utf-8"), record.data
    if found is None:
        there = ", ".join(sorted(kinds))[:200] or "none"
        raise HeightmapError(f"{source.name} holds no message {_KIND}; its types are {there}")
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = get_types_from_msg(found[0], _KIND)
    store.register({kind: fields for kind, fields in types.items() if kind not in store.fielddefs})
    message: Any = store.deserialize_cdr(found[1], _KIND)
    layer = _layer(list(message.layers), band)
    matrix = _matrix(message.data[layer], max_cells, source.name)
    rows, cols = matrix.shape  # rows along x, columns along y, both falling
    matrix = np.roll(matrix, (-int(message.outer_start_index), -int(message.inner_start_index)), (0, 1))
    pose, side = message.info.pose, float(message.info.resolution)
    turn = pose.orientation
    if abs(turn.z) > _STRAIGHT or abs(turn.x) > _STRAIGHT or abs(turn.y) > _STRAIGHT:
        raise HeightmapError("the grid map is turned in its frame: record it in the frame of the map")
    west, north = pose.position.x - rows * side / 2, pose.position.y + cols * side / 2
    if not (side > 0 and math.isfinite(west) and math.isfinite(north)):
        raise HeightmapError(f"the grid map's cells are {side:g} m, its place {west:g}, {north:g}: corrupt")
    heights = matrix[::-1].T  # north first, west first
    return Decoded(
        scaling.to_metres(np.ascontiguousarray(heights), known=~np.isnan(heights)),
        west_m=float(west),
        north_m=float(north),
        resolution_m=side,
    )


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
