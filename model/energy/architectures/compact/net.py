"""The compact network: it reads the ground around a place once, and a small head answers for every heading.

What is known is not learned: traction = m g (a mu + c tan theta + r). Here mu is the declared rolling resistance, tan
theta the grade of the 1 m segment (as in eq. 5), and a and c are gains that depend on the robot alone. The rest r is
learned in two steps. The *ground* part, convolutions over the two metres around a place, gives every hidden unit of the
head a short Fourier series over headings. The *head* evaluates these series at a heading, adds the features of the
wheel tracks (`tracks`), and answers r and its standard deviation. All convolutions are unpadded and their strides
multiply to 1 m. One square of `SQUARE` heights therefore gives one answer, and a raster of a whole window gives the
answers of all its cells in one pass.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, TRACKS
from joulemap.model.energy.architectures.contract import Network
from joulemap.model.energy.robot_features import FEATURES
from joulemap.model.energy.uncertainty import USUAL_SPREAD
from joulemap.model.errors import ModelError

STRIDE = 8
"""Working pixels between neighbouring answers."""

HEAD_BLOCK = 8
"""Inputs of the head's layers that the compiled loop adds up at a time."""

_SLOPE_SCALE = 4.0  # brings slopes of rough ground to about one
_REST_SCALE = 0.1  # and what is left to learn to a tenth of the weight
SPREAD_RANGE = (math.log(0.01), math.log(2.0))
"""Logarithms of the relative standard deviations that the head can answer."""


@dataclass(frozen=True)
class CompactConfig:
    """Widths of the network's layers.

    Attributes
    ----------
    channels : tuple of int
        Of the three strided convolutions.
    hidden : int
        Of the layer after them.
    order : int
        Highest harmonic of the heading.
    head : tuple of int
        Of the head's two layers.
    robot_hidden : int
        Of the layer that reads the robot.
    """

    channels: tuple[int, int, int] = (16, 32, 64)
    hidden: int = 64
    order: int = 2
    head: tuple[int, int] = (24, 16)
    robot_hidden: int = 32

    def as_dict(self) -> dict[str, Any]:
        """Return the widths, JSON-able."""
        return {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> CompactConfig:
        """Make a configuration of what `as_dict` wrote.

        Parameters
        ----------
        values : dict
            Widths by name; those that are missing take their defaults.

        Returns
        -------
        CompactConfig
            The configuration.

        Raises
        ------
        ModelError
            If a name is unknown.
        """
        converted: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
        try:
            return cls(**converted)
        except TypeError as error:
            raise ModelError(f"the network's description does not fit this version: {error}") from error


def heading_basis(heading_rad: ArrayLike, order: int) -> NDArray[np.float32]:
    """Return 1, sin h, cos h, sin 2h, ... of every heading.

    Parameters
    ----------
    heading_rad : array_like, (n,)
        Headings h [rad].
    order : int
        Highest harmonic.

    Returns
    -------
    ndarray of float32, (n, 2 order + 1)
        The basis functions.
    """
    heading = np.asarray(heading_rad, dtype=np.float64).ravel()
    columns = [np.ones_like(heading)]
    for harmonic in range(1, order + 1):
        columns += [np.sin(harmonic * heading), np.cos(harmonic * heading)]
    return np.stack(columns, axis=1).astype(np.float32)


def slopes_of_squares(squares: Tensor) -> Tensor:
    """Return the slopes of every 2 x 2 heights.

    Parameters
    ----------
    squares : Tensor, (B, N, N)
        Heights [m] at working pixels, north up.

    Returns
    -------
    Tensor, (B, 3, N - 1, N - 1)
        Slope to the east, slope to the north and twist.
    """
    nw, ne = squares[:, :-1, :-1], squares[:, :-1, 1:]
    sw, se = squares[:, 1:, :-1], squares[:, 1:, 1:]
    east = (ne - nw) + (se - sw)
    north = (nw - sw) + (ne - se)
    twist = (ne - nw) - (se - sw)
    return torch.stack([east, north, twist], dim=1) * (0.5 / PIXEL_M)


@dataclass(frozen=True)
class RobotCode:
    """How the robot (or each of B robots) modulates the network.

    Attributes
    ----------
    ground : Tensor, (B, 2 (third + hidden), 1, 1)
        Scale and shift of the third convolution and of the hidden layer.
    tracks : Tensor, (B, 2 head[0])
        Scale and shift of the head's first layer.
    gains : Tensor, (B, 2)
        Gains a and c of the rolling resistance and of the grade.
    """

    ground: Tensor
    tracks: Tensor
    gains: Tensor


@dataclass(frozen=True)
class GroundPass:
    """The function `CompactNet.read_ground` for one robot, its scales folded into the weights: less memory traffic.

    Attributes
    ----------
    convolutions : tuple of (Tensor, Tensor)
        Weight and bias of each.
    hidden, series : (Tensor, Tensor)
        Weight and bias of these layers.
    """

    convolutions: tuple[tuple[Tensor, Tensor], ...]
    hidden: tuple[Tensor, Tensor]
    series: tuple[Tensor, Tensor]

    def __call__(self, slopes: Tensor) -> Tensor:
        """(units * (2 order + 1), places) of (B, 3, 8 r + 8, 8 c + 8), channels last; places : B r c of them."""
        z = slopes
        for weight, bias in self.convolutions:
            z = nn.functional.conv2d(z, weight, bias, stride=2).relu_()
        z = z.permute(0, 2, 3, 1).flatten(0, 2)  # (places, third)
        z = nn.functional.linear(z, *self.hidden).relu_()
        return torch.addmm(self.series[1], self.series[0], z.T)


class CompactNet(Network):
    """Network from slopes, wheel tracks and robot to traction and its standard deviation.

    The ranges of the robot's features are buffers: features are normalised by them and clamped to them. A robot outside
    the learned ranges gets the answer of the nearest robot inside; the predictor adds a warning.

    Parameters
    ----------
    config : CompactConfig, optional
        Widths of the layers. Those of the shipped network by default.
    """

    architecture = "compact"
    feature_low: Tensor
    feature_high: Tensor

    def __init__(self, config: CompactConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or CompactConfig()
        first, second, third = config.channels
        units, last = config.head
        self.conv0 = nn.Conv2d(3, first, 4, stride=2)
        self.conv1 = nn.Conv2d(first, second, 3, stride=2)
        self.conv2 = nn.Conv2d(second, third, 3, stride=2)
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

        Parameters
        ----------
        low, high : array_like, (8,)
            Least and greatest value of each of `FEATURES`.
        """
        low_t, high_t = torch.tensor(np.asarray(low)), torch.tensor(np.asarray(high))
        with torch.no_grad():
            self.feature_low.copy_(torch.minimum(low_t, high_t - 1e-3))
            self.feature_high.copy_(high_t)

    def adapted(self, *, level: float, climb: float, shape: float) -> CompactNet:
        """Return a copy whose traction over the weight is (a mu + (c + climb) tan theta) + (1 + shape) r + level.

        Parameters
        ----------
        level, climb, shape : float
            As `Architecture.adapted`.

        Returns
        -------
        CompactNet
            The copy.
        """
        other = deepcopy(self)
        with torch.no_grad():
            other.gains.bias[1].add_(climb)
            for parameter in other.rest.parameters():
                parameter.mul_(1.0 + shape)
            other.rest.bias.add_(level / _REST_SCALE)
        return other

    def read_robot(self, features: Tensor) -> RobotCode:
        """Turn the robot's features into scales, shifts and gains.

        Parameters
        ----------
        features : Tensor, (B, 8)
            As from `robot_features`.

        Returns
        -------
        RobotCode
            Of each of the B robots.
        """
        inside = torch.maximum(torch.minimum(features, self.feature_high), self.feature_low)
        unit = 2.0 * (inside - self.feature_low) / (self.feature_high - self.feature_low) - 1.0
        code = torch.tanh(self.robot(unit))
        film = self.film(code)
        split = 2 * (self.config.channels[2] + self.config.hidden)
        return RobotCode(film[:, :split, None, None], film[:, split:], 1.0 + self.gains(code))

    def read_ground(self, slopes: Tensor, robot: RobotCode) -> Tensor:
        """Read the ground: a Fourier series over headings for every hidden unit of the head.

        Parameters
        ----------
        slopes : Tensor, (B, 3, 8 r + 8, 8 c + 8)
            As from `slopes_of_squares`.
        robot : RobotCode
            Of B robots, or of one for all.

        Returns
        -------
        Tensor, (B, units * (2 order + 1), r, c)
            Coefficients; those of one unit are next to each other.
        """
        third, hidden = self.config.channels[2], self.config.hidden
        scale0, shift0, scale1, shift1 = robot.ground.split([third, third, hidden, hidden], dim=1)
        z = torch.relu_(self.conv0(slopes * _SLOPE_SCALE))
        z = torch.relu_(self.conv1(z))
        z = torch.relu_(self.conv2(z) * (1.0 + scale0) + shift0)
        z = torch.relu_(self.hidden(z) * (1.0 + scale1) + shift1)
        return self.series(z)

    def ask(self, series: Tensor, basis: Tensor, tracks: Tensor, robot: RobotCode) -> tuple[Tensor, Tensor]:
        """Evaluate the head at one heading of each place.

        Parameters
        ----------
        series : Tensor, (B, units * C)
            As from `read_ground`.
        basis : Tensor, (B, C)
            As from `heading_basis`.
        tracks : Tensor, (B, 9)
            As from `track_features`.
        robot : RobotCode
            Of the B robots, or of one for all.

        Returns
        -------
        rest : Tensor, (B,)
            Traction over weight beyond eq. 5.
        spread : Tensor, (B,)
            Logarithm of the standard deviation over the energy. Its gradient does not reach the layers below.
        """
        scale, shift = robot.tracks.chunk(2, dim=1)
        units = torch.einsum("buc,bc->bu", series.unflatten(1, (-1, basis.shape[1])), basis)  # (B, units)
        z = torch.relu(units + self.tracks(tracks) * (1.0 + scale) + shift)
        z = torch.relu(self.head(z))
        rest = _REST_SCALE * self.rest(z)[:, 0]
        return rest, self.spread(z.detach())[:, 0].clamp(*SPREAD_RANGE)

    def forward(
        self, squares: Tensor, features: Tensor, basis: Tensor, tracks: Tensor, tan_grade: Tensor, resistance: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Answer for single segments.

        Parameters
        ----------
        squares : Tensor, (B, 17, 17)
            Heights [m], north up.
        features : Tensor, (B, 8)
            As from `robot_features`.
        basis, tracks : Tensor, (B, C) and (B, 9)
            As in `ask`.
        tan_grade : Tensor, (B,)
            Grade of the segments.
        resistance : Tensor, (B,)
            Declared rolling resistance.

        Returns
        -------
        traction : Tensor, (B,)
            Traction over weight.
        spread : Tensor, (B,)
            Logarithm of the standard deviation over the energy.
        """
        robot = self.read_robot(features)
        series = self.read_ground(slopes_of_squares(squares), robot)[:, :, 0, 0]
        rest, spread = self.ask(series, basis, tracks, robot)
        return robot.gains[:, 0] * resistance + robot.gains[:, 1] * tan_grade + rest, spread

    def folded_ground(self, robot: RobotCode) -> GroundPass:
        """Return `read_ground` for one robot, its scales folded into the weights.

        Parameters
        ----------
        robot : RobotCode
            Of one robot.

        Returns
        -------
        GroundPass
            Without gradients.
        """
        third, hidden = self.config.channels[2], self.config.hidden
        known = {name: parameter.detach() for name, parameter in self.named_parameters()}
        parts = [p.detach().flatten() for p in robot.ground.split([third, third, hidden, hidden], dim=1)]
        scale2, shift2, scale, shift = 1.0 + parts[0], parts[1], 1.0 + parts[2], parts[3]
        convolutions = (
            (known["conv0.weight"] * _SLOPE_SCALE, known["conv0.bias"]),
            (known["conv1.weight"], known["conv1.bias"]),
            (known["conv2.weight"] * scale2[:, None, None, None], known["conv2.bias"] * scale2 + shift2),
        )
        return GroundPass(
            tuple((weight.contiguous(memory_format=torch.channels_last), bias) for weight, bias in convolutions),
            (known["hidden.weight"].flatten(1) * scale[:, None], known["hidden.bias"] * scale + shift),
            (known["series.weight"].flatten(1), known["series.bias"][:, None]),
        )

    def folded_head(self, robot: RobotCode) -> tuple[NDArray[np.float32], ...]:
        """Return the head's weights for one robot, as the compiled loop over a lattice takes them.

        Parameters
        ----------
        robot : RobotCode
            Of one robot.

        Returns
        -------
        tuple of ndarray of float32
            Tracks (units, 9) and shift (units,), head (last, units) and bias, rest and spread (2, last) and their
            biases (2,), scaled as `ask` answers. Units and last are padded with zeros to multiples of `HEAD_BLOCK`.
        """
        with torch.no_grad():
            scale, shift = robot.tracks[0].chunk(2)
            units, last = (-size % HEAD_BLOCK for size in self.config.head)
            parts = (
                nn.functional.pad(self.tracks.weight * (1.0 + scale)[:, None], (0, 0, 0, units)),
                nn.functional.pad(shift, (0, units)),
                nn.functional.pad(self.head.weight, (0, units, 0, last)),
                nn.functional.pad(self.head.bias, (0, last)),
                nn.functional.pad(torch.cat([_REST_SCALE * self.rest.weight, self.spread.weight]), (0, last)),
                torch.cat([_REST_SCALE * self.rest.bias, self.spread.bias]),
            )
            return tuple(np.ascontiguousarray(p.numpy(), dtype=np.float32) for p in parts)
