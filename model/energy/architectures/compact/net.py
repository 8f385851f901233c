"""The compact network: it reads the ground around a place once, and a small head answers for every heading.

What is known is not learned: traction = m g (a mu + c tan theta + r). Here mu is the declared rolling resistance, tan
theta the grade of the 1 m segment (as in eq. 5), and a and c are gains that depend on the robot alone. The rest r is
learned in two steps. The *ground* part, convolutions over the two metres around a place, gives every hidden unit of the
head a short Fourier series over headings. The *head* evaluates these series at a heading, adds the features of the
wheel tracks (`tracks`), and answers r and its standard deviation. All convolutions are unpadded and their strides
multiply to 1 m. One square of `SQUARE` heights therefore gives one answer, and a raster of a whole window gives the
answers of all its cells in one pass. Here the network is trained; `ground` and `head` ask it without torch.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, TRACKS
from joulemap.model.energy.architectures.compact.weights import (
    KERNELS,
    REST_SCALE,
    SLOPE_SCALE,
    SPREAD_RANGE,
    CompactConfig,
    CompactWeights,
)
from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.robot_features import FEATURES
from joulemap.model.energy.uncertainty import USUAL_SPREAD


def slopes_of_squares(squares: Tensor) -> Tensor:
    """Return the slopes of every 2 x 2 heights.

    `squares` (B, N, N): heights [m] at working pixels, north up. Result (B, 3, N - 1, N - 1): slope to the east, slope
    to the north and twist.
    """
    nw, ne = squares[:, :-1, :-1], squares[:, :-1, 1:]
    sw, se = squares[:, 1:, :-1], squares[:, 1:, 1:]
    east = (ne - nw) + (se - sw)
    north = (nw - sw) + (ne - se)
    twist = (ne - nw) - (se - sw)
    return torch.stack([east, north, twist], dim=1) * (0.5 / PIXEL_M)


@dataclass(frozen=True)
class RobotCode:
    """How the robot (or each of B robots) modulates the network."""

    ground: Tensor  # Scale and shift of the third convolution and of the hidden layer
    tracks: Tensor  # Scale and shift of the head's first layer
    gains: Tensor  # Gains a and c of the rolling resistance and of the grade


class CompactNet(Network):
    """Network from slopes, wheel tracks and robot to traction and its standard deviation.

    The ranges of the robot's features are buffers: features are normalised by them and clamped to them. A robot outside
    the learned ranges gets the answer of the nearest robot inside; the predictor adds a warning.
    """

    architecture = "compact"
    feature_low: Tensor
    feature_high: Tensor

    def __init__(self, config: CompactConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or CompactConfig()
        first, second, third = config.channels
        units, last = config.head
        self.conv0 = nn.Conv2d(3, first, KERNELS[0], stride=2)
        self.conv1 = nn.Conv2d(first, second, KERNELS[1], stride=2)
        self.conv2 = nn.Conv2d(second, third, KERNELS[2], stride=2)
        self.hidden = nn.Conv2d(third, config.hidden, 1)
        self.series = nn.Conv2d(config.hidden, units * (2 * config.order + 1), 1)
        self.tracks = nn.Linear(len(TRACKS), units, bias=False)
        self.head = nn.Linear(units, last)
        self.rest = nn.Linear(last, 1)
        self.spread = nn.Linear(last, 1)
        self.robot = nn.Linear(len(FEATURES), config.robot_hidden)
        self.film = nn.Linear(config.robot_hidden, 2 * (third + config.hidden + units))
        self.gains = nn.Linear(config.robot_hidden, 2)
        self.register_buffer("feature_low", torch.zeros(len(FEATURES)))
        self.register_buffer("feature_high", torch.ones(len(FEATURES)))
        for layer in (self.rest, self.spread, self.film, self.gains):  # an untrained network is equation 5
            for parameter in layer.parameters():
                nn.init.zeros_(parameter)
        nn.init.constant_(self.spread.bias, math.log(USUAL_SPREAD))

    def set_feature_ranges(self, low: ArrayLike, high: ArrayLike) -> None:
        """Set the ranges of the features in the training data; an empty range is widened a little.

        `low`, `high` (9,): least and greatest value of each of `FEATURES`.
        """
        low_t, high_t = torch.tensor(np.asarray(low)), torch.tensor(np.asarray(high))
        with torch.no_grad():
            self.feature_low.copy_(torch.minimum(low_t, high_t - 1e-3))
            self.feature_high.copy_(high_t)

    def adapted(self, *, level: float, climb: float, shape: float) -> CompactNet:
        """Return a copy whose traction over the weight is (a mu + (c + climb) tan theta) + (1 + shape) r + level."""
        other = deepcopy(self)
        with torch.no_grad():
            other.gains.bias[1].add_(climb)
            for parameter in other.rest.parameters():
                parameter.mul_(1.0 + shape)
            other.rest.bias.add_(level / REST_SCALE)
        return other

    def scaled(self, factor: float) -> CompactNet:
        """Return a copy whose traction is a multiple."""
        other = deepcopy(self)
        with torch.no_grad():
            for layer in (other.gains, other.rest):
                for parameter in layer.parameters():
                    parameter.mul_(factor)
            other.gains.bias.add_(factor - 1.0)  # gains are added to 1
        return other

    def read_robot(self, features: Tensor) -> RobotCode:
        """Turn the robot's features into scales, shifts and gains. `features` (B, 9): as from `robot_features`."""
        inside = torch.maximum(torch.minimum(features, self.feature_high), self.feature_low)
        unit = 2.0 * (inside - self.feature_low) / (self.feature_high - self.feature_low) - 1.0
        code = torch.tanh(self.robot(unit))
        film = self.film(code)
        split = 2 * (self.config.channels[2] + self.config.hidden)
        return RobotCode(film[:, :split, None, None], film[:, split:], 1.0 + self.gains(code))

    def read_ground(self, slopes: Tensor, robot: RobotCode) -> Tensor:
        """Read the ground: a Fourier series over headings for every hidden unit of the head.

        `slopes` (B, 3, 8 r + 8, 8 c + 8): as from `slopes_of_squares`. The result is (B, units * (2 order + 1), r, c).
        """
        third, hidden = self.config.channels[2], self.config.hidden
        scale0, shift0, scale1, shift1 = robot.ground.split([third, third, hidden, hidden], dim=1)
        z = torch.relu_(self.conv0(slopes * SLOPE_SCALE))
        z = torch.relu_(self.conv1(z))
        z = torch.relu_(self.conv2(z) * (1.0 + scale0) + shift0)
        z = torch.relu_(self.hidden(z) * (1.0 + scale1) + shift1)
        return self.series(z)

    def ask(self, series: Tensor, basis: Tensor, tracks: Tensor, robot: RobotCode) -> tuple[Tensor, Tensor]:
        """Evaluate the head at one heading of each place.

        `series` (B, units * C): as from `read_ground`; `basis` (B, C): as from `heading_basis`; `tracks` (B, 9): as
        from `track_features`. Returns `rest` (B,): traction over weight beyond eq. 5; `spread` (B,): logarithm of the
        standard deviation over the energy, its gradient does not reach the layers below.
        """
        scale, shift = robot.tracks.chunk(2, dim=1)
        units = torch.einsum("buc,bc->bu", series.unflatten(1, (-1, basis.shape[1])), basis)  # (B, units)
        z = torch.relu(units + self.tracks(tracks) * (1.0 + scale) + shift)
        z = torch.relu(self.head(z))
        rest = REST_SCALE * self.rest(z)[:, 0]
        return rest, self.spread(z.detach())[:, 0].clamp(*SPREAD_RANGE)

    def forward(
        self, squares: Tensor, features: Tensor, basis: Tensor, tracks: Tensor, tan_grade: Tensor, resistance: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Answer for single segments.

        `squares` (B, 17, 17): heights [m], north up; `features` (B, 9): as from `robot_features`; `basis`, `tracks` (B,
        C); `tan_grade` (B,); `resistance` (B,): declared rolling resistance. Returns `traction` (B,): traction over
        weight; `spread` (B,): logarithm of the standard deviation over the energy.
        """
        robot = self.read_robot(features)
        series = self.read_ground(slopes_of_squares(squares), robot)[:, :, 0, 0]
        rest, spread = self.ask(series, basis, tracks, robot)
        return robot.gains[:, 0] * resistance + robot.gains[:, 1] * tan_grade + rest, spread

    def weights(self) -> CompactWeights:
        """Return the weights as arrays, with which the network is asked."""
        return CompactWeights({key: value.numpy().copy() for key, value in self.state_dict().items()}, self.config)
