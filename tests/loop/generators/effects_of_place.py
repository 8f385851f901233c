"""Effects that depend on where the robot is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy

from tests.loop.generators.effect import HiddenEffect, Scene
from tests.loop.generators.site import Site

FloatArray = NDArray[np.float64]

_PLACE = (r"place", r"position(?![ _]index)", r"local", r"patch", r"region", r"disk", r"(^|[^a-z])[xy]($|[^a-z])")


class WetPatch(HiddenEffect):
    """Soft ground inside a polygon of five corners, about 15 m across."""

    kind = "wet_patch"
    right = _PLACE
    why_none = "a polygon, which no candidate is"
    transfers = False

    def force_n(self, scene: Scene) -> FloatArray | float:
        """Additional rolling resistance inside."""
        if not scene.home:
            return 0.0
        inside = contains_xy(self.patch(scene.site), scene.motion.x, scene.motion.y)
        return 0.5 * self.size * scene.robot.rolling_n * inside

    def patch(self, site: Site) -> Polygon:
        """The polygon on a site."""
        west, south, east, north = site.bounds
        x = west + (0.3 + 0.4 * self.draw[0]) * (east - west)
        y = south + (0.35 + 0.3 * self.draw[1]) * (north - south)
        angle = 2 * np.pi * (self.draw[2] + np.arange(5) / 5.0)
        reach = 9.0 * np.array([1.0, 0.75, 0.95, 0.65 + 0.3 * self.draw[3], 0.85])
        return Polygon(np.column_stack([x + reach * np.sin(angle), y + reach * np.cos(angle)]))


class LowMud(HiddenEffect):
    """Mud that stays below a certain height above the sea."""

    kind = "low_mud"
    right = (r"elevation", r"height", r"hollow", r"topographic", r"position.index", *_PLACE)
    why_none = "a step in the height"

    def force_n(self, scene: Scene) -> FloatArray:
        """Additional rolling resistance below the level, which is a quantile of the site's own heights."""
        heights = scene.site.heightmap.heights
        level = np.quantile(heights[::5, ::5], 0.25 + 0.15 * self.draw[0])
        soft = 1.0 / (1.0 + np.exp((scene.motion.z - level) / 0.05))
        return 0.45 * self.size * scene.robot.rolling_n * soft


PLACE = (WetPatch, LowMud)
