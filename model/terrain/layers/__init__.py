"""Layers over a heightmap: kinds of ground, obstacles, a factor, and costs of the user's own."""

from joulemap.model.terrain.layers.layer import Layer
from joulemap.model.terrain.layers.stack import NO_LAYERS, Layers

__all__ = ["NO_LAYERS", "Layer", "Layers"]
