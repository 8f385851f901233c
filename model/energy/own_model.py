"""A user's own model: a formula, or an object that predicts from heights. joulemap asks it for whole maps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.grade import SEGMENT_M
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.shape_features import FEATURES, shape_features
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame, heading_vector
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_patches

FloatArray = NDArray[np.float64]
Formula = Callable[..., Any]
"""From the slope along, the slope across, the roughness [m] and the speed [m/s] to the traction [J/m], all (n,)."""

_AT_ONCE = 1 << 15  # segments


@runtime_checkable
class PredictsFromHeights(Protocol):
    """Something that predicts from heights, as a network of one's own does."""

    def predict(self, heights: NDArray[np.float32], headings_rad: FloatArray) -> Any:
        """Return traction [J/m], (n,), from the patches of `cut_patches`, (n, 32, 32) [m], and headings, (n,) [rad]."""


class OwnModel(PhysicsPredictor):
    """Asks a formula or an object of the user for the traction of every place and heading.

    Parameters
    ----------
    asked : callable or PredictsFromHeights
        Of a function: the slope along (rise over run, positive uphill), the slope across (positive with the right side
        higher), the roughness (root mean square about the plane of the metre [m]) and the robot's speed [m/s].
    """

    def __init__(self, asked: Formula | PredictsFromHeights) -> None:
        self._asked = asked
        self.name = getattr(asked, "__name__", type(asked).__name__)

    def provenance(self) -> dict[str, Any]:
        """Return what the predictor is, JSON-able."""
        return {
            "name": self.name,
            "kind": "own",
            "version": "unknown",
            "config": {"home": type(self._asked).__module__},
        }

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> NDArray[np.float32]:
        """Return the traction at the cell centres of a lattice, (rows, cols, K) [J/m]; NaN where the map is unknown."""
        x, y = frame.centres()
        places = np.broadcast_arrays(x[None, :, None], y[:, None, None], np.asarray(headings_rad)[None, None, :])
        return self.segment_traction(heightmap, robot, *places).reshape(places[0].shape).astype(np.float32)

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> FloatArray:
        """Return the traction of 1 m segments, (n,) [J/m]; NaN where the map is unknown.

        Raises ModelError if the user's model does not answer with one finite number for each known segment.
        """
        places = np.broadcast_arrays(x, y, heading_rad)
        xs, ys, headings = (np.asarray(place, dtype=np.float64).ravel() for place in places)
        traction = np.full(xs.size, np.nan)
        for begin in range(0, xs.size, _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            traction[part] = self._answers(heightmap, robot, xs[part], ys[part], headings[part])
        return heightmap.layers.on_kinds(traction, robot, xs, ys)

    def _answers(
        self, heightmap: Heightmap, robot: Robot, x: FloatArray, y: FloatArray, heading: FloatArray
    ) -> FloatArray:
        if isinstance(self._asked, PredictsFromHeights):
            dx, dy = heading_vector(heading)
            heights = cut_patches(heightmap, x - 0.5 * SEGMENT_M * dx, y - 0.5 * SEGMENT_M * dy, heading)
            known = np.isfinite(heights).all(axis=(1, 2))
            given: tuple[Any, ...] = heights[known], heading[known]
            ask: Formula = self._asked.predict
        else:
            shape = shape_features(heightmap, robot, x, y, heading)
            known = np.isfinite(shape[:, 0])
            along, across, rough = (
                shape[known, FEATURES.index(name)] for name in ("grade", "cross_grade", "roughness")
            )
            given = along, across, rough, np.full(along.size, robot.speed_mps)
            ask = self._asked
        found = np.full(x.size, np.nan)
        if not known.any():
            return found
        said = np.asarray(ask(*given), dtype=np.float64)
        if said.shape not in ((), (known.sum(),)) or not np.isfinite(said).all():
            raise ModelError(
                f"the model {self.name} answered {said.shape} values, {np.isfinite(said).sum()} of them finite, for "
                f"{known.sum()} segments: a finite traction [J/m] for each is needed",
                model=self.name,
            )
        found[known] = said
        return found
