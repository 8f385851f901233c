"""The places of a question: read as what they mean on a map, with notes of what the user should know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.service.places.areas_given import corners_of
from joulemap.service.places.coordinates import degrees, from_wgs84, on_map, world_point

if TYPE_CHECKING:  # they take their time to load
    from joulemap.planner.answers import Plan, RoundTrip
    from joulemap.planner.route import Route

Answer = TypeVar("Answer", "Plan", "RoundTrip", "Route")


class Places:
    """Reads the places of a question, and keeps what the user should know of them."""

    def __init__(self, frame: GridFrame) -> None:
        self.frame = frame
        self.notes: list[str] = []

    def __call__(self, place: Any, name: str) -> tuple[float, float]:
        """Return a place as `world_point` does. Result: world x, y [m]."""
        found = world_point(self.frame, place, name=name)
        if found.note is not None:
            self.notes.append(found.note)
        return found.x, found.y

    def path(self, points: Any) -> NDArray[np.float64]:
        """Return the points of a path in the coordinates of the map.

        `points` (n, 2 or 3): all in the same form: x, y [m], latitude, longitude, or objects with `lat` and `lon`.
        Result (n, 2): world x, y [m]. They are read as latitude and longitude if the first of them is.
        """
        try:
            pairs = points[:, :2] if isinstance(points, np.ndarray) else [point[:2] for point in points]
            array = np.array(pairs, dtype=np.float64).reshape(-1, 2)
        except (TypeError, ValueError, KeyError):  # objects, or no points: the message names the first that is none
            return np.array([self(point, f"point {k} of the path") for k, point in enumerate(points)])
        if len(array) == 0:
            return array
        begin = world_point(self.frame, array[0].tolist(), name="the path, which begins at")
        if begin.note is None:
            return array
        self.notes.append(begin.note)
        return from_wgs84(self.frame.crs, array[:, ::-1])

    def areas(self, areas: Sequence[Sequence[Any]]) -> list[list[list[float]]]:
        """Return areas in the coordinates of the map, beyond which they may reach.

        Result: world coordinates [m]. Corners of two numbers are latitude, longitude if none of an area is on the map
        as x, y, and one is as latitude, longitude.
        """
        return [self._area(corners, f"area {k}") for k, corners in enumerate(corners_of(areas, self.frame))]

    def _area(self, corners: Sequence[Any], name: str) -> list[list[float]]:
        if any(isinstance(corner, Mapping) for corner in corners):
            lonlat = [degrees(corner, f"corner {k} of {name}")[::-1] for k, corner in enumerate(corners)]
            return from_wgs84(self.frame.crs, lonlat).tolist()
        plain = [[float(value) for value in corner[:2]] for corner in corners]
        if self.frame.crs is None or any(on_map(self.frame, x, y) for x, y in plain):
            return plain
        if all(abs(lat) <= 90.0 and abs(lon) <= 180.0 for lat, lon in plain):
            found = from_wgs84(self.frame.crs, [(lon, lat) for lat, lon in plain]).tolist()
            if any(on_map(self.frame, x, y) for x, y in found):
                self.notes.append(f"the corners of {name} were read as latitude,longitude")
                return found
        return plain

    def noted(self, answer: Answer) -> Answer:
        """Return an answer with the notes."""
        if not self.notes:
            return answer
        if hasattr(answer, "route"):
            return replace(answer, route=self.noted(answer.route))  # type: ignore
        return replace(answer, notes=type(answer.notes)([*self.notes, *answer.notes]))  # type: ignore
