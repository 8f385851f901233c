"""Layers over a heightmap: kinds of ground, obstacles, a factor, and costs of the user's own."""

from joulemap.model.terrain.layers.layer import NO_LAYERS, Layer, Layers

__all__ = ["NO_LAYERS", "Layer", "Layers"]
