"""The compact dense network: slopes of the unrotated ground in, a Fourier series over headings out.

What is known is not learned: traction = m g (a mu + c tan theta + S(heading)), with mu the declared rolling resistance,
tan theta the grade of the 1 m segment (exactly as physics has it), a and c gains that depend on the robot alone, and S
a short Fourier series whose coefficients the network reads off the two metres of ground around the place.
Every convolution is valid and their strides multiply to 1 m, so that one square of `SQUARE` heights gives one answer
and a raster of a whole window gives every cell's answer in one pass.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from model.errors import ModelError
from model.robot import Robot

PIXEL_M = 0.125
"""Side of a working pixel [m]: eight to the metre."""
STRIDE = 8
"""Working pixels between neighbouring answers."""
SQUARE = 17
"""Heights along a side of the square that one answer sees: 16 pixels, 2 m."""

FEATURES = (
    "log_mass_kg",
    "width_m",
    "length_m",
    "wheel_radius_m",
    "log_speed_mps",
    "rolling_resistance",
    "hotel_over_weight",
    "log2_resolution_m",
)

_SLOPE_SCALE = 4.0  # brings slopes of rough ground to about one
_SERIES_SCALE = 0.1  # and what the series has to say to a tenth of the weight


@dataclass(frozen=True)
class CompactConfig:
    """Widths of the network. channels : of the three strided convolutions; hidden : of the two layers after them;
    order : highest harmonic of the heading; robot_hidden : of the layer that reads the robot."""

    channels: tuple[int, int, int] = (24, 64, 128)
    hidden: tuple[int, int] = (96, 64)
    order: int = 4
    robot_hidden: int = 32

    def as_dict(self) -> dict[str, Any]:
        return {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> CompactConfig:
        """Raises ModelError on unknown or missing keys."""
        converted: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
        try:
            return cls(**converted)
        except TypeError as error:
            raise ModelError(f"the network's description does not fit this version: {error}") from error


def robot_features(robot: Robot, resolution_m: float) -> NDArray[np.float32]:
    """What the network is told of the robot and the map, in the order of `FEATURES`. (8,) float32.

    hotel_over_weight is the idle energy per metre over m g; log2 of metres per pixel of the heightmap comes last.
    """
    return np.array(
        [
            math.log(robot.mass_kg), robot.width_m, robot.length_m, robot.wheel_radius_m, math.log(robot.speed_mps),
            robot.rolling_resistance, robot.hotel_per_m / robot.weight_n, math.log2(resolution_m),
        ],
        dtype=np.float32,
    )  # fmt: skip


def heading_basis(heading_rad: ArrayLike, order: int) -> NDArray[np.float32]:
    """1, sin h, cos h, sin 2h, ... of every heading: (n, 2 order + 1) float32."""
    heading = np.asarray(heading_rad, dtype=np.float64).ravel()
    columns = [np.ones_like(heading)]
    for harmonic in range(1, order + 1):
        columns += [np.sin(harmonic * heading), np.cos(harmonic * heading)]
    return np.stack(columns, axis=1).astype(np.float32)


def slopes_of_squares(squares: Tensor) -> Tensor:
    """Rise to the east and to the north and the twist of every 2 x 2 heights. (B, N, N) -> (B, 3, N - 1, N - 1)."""
    nw, ne = squares[:, :-1, :-1], squares[:, :-1, 1:]
    sw, se = squares[:, 1:, :-1], squares[:, 1:, 1:]
    east = (ne - nw) + (se - sw)
    north = (nw - sw) + (ne - se)
    twist = (ne - nw) - (se - sw)
    return torch.stack([east, north, twist], dim=1) * (0.5 / PIXEL_M)


class CompactNet(nn.Module):
    """Slopes and robot in; series and gains out. See the module's docstring.

    The ranges of the robot's features are buffers: features are normalised by them and clamped to them, so that a robot
    outside what was learned gets the answer of the nearest one inside (and a warning, elsewhere).
    """

    feature_low: Tensor
    feature_high: Tensor

    def __init__(self, config: CompactConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or CompactConfig()
        first, second, third = config.channels
        self.conv0 = nn.Conv2d(3, first, 4, stride=2)
        self.conv1 = nn.Conv2d(first, second, 3, stride=2)
        self.conv2 = nn.Conv2d(second, third, 3, stride=2)
        self.hidden0 = nn.Conv2d(third, config.hidden[0], 1)
        self.hidden1 = nn.Conv2d(config.hidden[0], config.hidden[1], 1)
        self.series = nn.Conv2d(config.hidden[1], 2 * config.order + 1, 1)
        self.robot = nn.Linear(len(FEATURES), config.robot_hidden)
        self.film = nn.Linear(config.robot_hidden, 2 * (third + config.hidden[0]))
        self.gains = nn.Linear(config.robot_hidden, 2)
        self.register_buffer("feature_low", torch.zeros(len(FEATURES)))
        self.register_buffer("feature_high", torch.ones(len(FEATURES)))
        for layer in (self.series, self.film, self.gains):  # an untrained network is equation 5
            for parameter in layer.parameters():
                nn.init.zeros_(parameter)

    def set_feature_ranges(self, low: ArrayLike, high: ArrayLike) -> None:
        """The ranges (8,) of the features in the training data; an empty range is widened a little."""
        low_t, high_t = torch.tensor(np.asarray(low)), torch.tensor(np.asarray(high))
        with torch.no_grad():
            self.feature_low.copy_(torch.minimum(low_t, high_t - 1e-3))
            self.feature_high.copy_(high_t)

    def read_robot(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """features (B, 8) -> FiLM (B, 2 * (third + hidden), 1, 1) and the gains (a, c) (B, 2)."""
        inside = torch.maximum(torch.minimum(features, self.feature_high), self.feature_low)
        unit = 2.0 * (inside - self.feature_low) / (self.feature_high - self.feature_low) - 1.0
        code = torch.tanh(self.robot(unit))
        return self.film(code)[:, :, None, None], 1.0 + self.gains(code)

    def read_ground(self, slopes: Tensor, film: Tensor) -> Tensor:
        """Coefficients (B, 2 order + 1, r, c) of the series, over the weight.

        slopes : (B, 3, 8 r + 8, 8 c + 8). film : as from `read_robot`, for B robots or one.
        """
        third, hidden = self.config.channels[2], self.config.hidden[0]
        scale0, shift0, scale1, shift1 = film.split([third, third, hidden, hidden], dim=1)
        z = torch.relu_(self.conv0(slopes * _SLOPE_SCALE))
        z = torch.relu_(self.conv1(z))
        z = torch.relu_(self.conv2(z) * (1.0 + scale0) + shift0)
        z = torch.relu_(self.hidden0(z) * (1.0 + scale1) + shift1)
        z = torch.relu_(self.hidden1(z))
        return _SERIES_SCALE * self.series(z)

    def forward(
        self, squares: Tensor, features: Tensor, basis: Tensor, tan_grade: Tensor, rolling_resistance: Tensor
    ) -> Tensor:
        """Traction over weight, (B,). squares : (B, 17, 17) [m]. features : (B, 8). basis : (B, 2 order + 1)."""
        film, gains = self.read_robot(features)
        coefficients = self.read_ground(slopes_of_squares(squares), film)[:, :, 0, 0]  # (B, 2 order + 1)
        return gains[:, 0] * rolling_resistance + gains[:, 1] * tan_grade + (coefficients * basis).sum(dim=1)
