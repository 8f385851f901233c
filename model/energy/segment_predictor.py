"""A predictor of a network that answers for one segment at a time: cuts an input per place and heading, and asks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.drivetrain import geared
from joulemap.model.energy.examples import cut_examples
from joulemap.model.energy.learned import Facts, Learned
from joulemap.model.energy.tensors import ExampleTensors
from joulemap.model.energy.uncertainty import USUAL_SPREAD, segment_std
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

if TYPE_CHECKING:
    from joulemap.model.energy.architectures.contract import Architecture
    from joulemap.model.energy.architectures.network import Network

FloatArray = NDArray[np.float64]


class SegmentPredictor(Learned):
    """The predictor of any architecture that has none of its own. It is slow: one input per place and heading.

    The traction is the network's energy without the robot's hotel load, so that the price of a segment is the network's
    answer wherever that is not below the hotel load. NaN where an input meets unknown ground.
    """

    def __init__(self, architecture: Architecture[Any], net: Network, facts: Facts) -> None:
        super().__init__(facts)
        self.architecture = architecture
        self.device = architecture.device()
        self.net = net.to(self.device).eval()
        self.size = facts.size

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return traction and uncertainty at the cell centres of a lattice.

        `headings_rad` is (K,). Returns `traction` (rows, cols, K): traction demand [J/m], NaN where the map is unknown;
        `std` (rows, cols, K): standard deviation of a 1 m segment's energy [J].
        """
        x, y = frame.centres()
        shape = frame.rows, frame.cols, len(headings_rad)
        places = np.broadcast_arrays(x[None, :, None], y[:, None, None], np.asarray(headings_rad)[None, None, :])
        traction, std = self.segment_traction_and_std(heightmap, robot, *places)
        return traction.reshape(shape).astype(np.float32), std.reshape(shape).astype(np.float32)

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return traction and uncertainty of 1 m segments.

        A network without a standard deviation of its own gets the share of the energy that held-out runs showed.

        `x`, `y` (n,): centres of the segments [m]; `heading_rad` (n,). Returns `traction` (n,): traction demand [J/m],
        NaN where the map is unknown; `std` (n,): standard deviation of the energy [J].
        """
        places = np.broadcast_arrays(x, y, heading_rad)
        xs, ys, heading = (np.ascontiguousarray(a, dtype=np.float64).ravel() for a in places)
        out, relative = np.full(xs.size, np.nan), np.full(xs.size, USUAL_SPREAD)
        at_once = self.architecture.at_once
        with torch.inference_mode():
            for k in range(0, xs.size, at_once):
                part = np.arange(k, min(k + at_once, xs.size))
                seen = cut_examples(
                    heightmap,
                    robot,
                    xs[part],
                    ys[part],
                    heading[part],
                    0.0,
                    run=part,  # which of them the map knows
                    architecture=self.architecture.name,
                    size=self.size,
                )
                if not len(seen):
                    continue
                rows = torch.arange(len(seen), device=self.device)
                said = ExampleTensors(seen, self.device).answer(self.net, rows, leak=1.0)
                out[seen.run] = said.energy.cpu().numpy().astype(np.float64) - robot.hotel_per_m
                if said.spread is not None:
                    relative[seen.run] = torch.exp(said.spread).cpu().numpy()
        out = heightmap.layers.on_kinds(geared(out, robot, self.drivetrain_efficiency), robot, xs, ys)
        price, level = robot.price_per_m(out), robot.hotel_per_m + robot.weight_n * robot.rolling_resistance
        return out, segment_std(price, relative, level, factor=self.spread.factor)
