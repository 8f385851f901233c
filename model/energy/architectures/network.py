"""A network of any architecture, as torch trains it."""

from __future__ import annotations

from typing import ClassVar

from torch import nn


class Network(nn.Module):
    """A network that answers for 1 m segments."""

    architecture: ClassVar[str]
