"""A cost map of a service, asked as a cost map in memory is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import httpx

from joulemap.model.battery import Battery
from joulemap.model.errors import BusyError, ConflictError
from joulemap.model.frames import GridFrame
from joulemap.service.client.answers import Answer, document_of, stranger
from joulemap.service.client.connection import Connection
from joulemap.service.coordinates import PlaceLike
from joulemap.service.questions.asking import asks
from joulemap.service.questions.parts import OnMap
from joulemap.service.questions.reach import ReachOut, ReachRequest
from joulemap.service.schemas.homeward import ReturnOut
from joulemap.service.schemas.maps import AtOut, CostmapOut
from joulemap.service.schemas.planning import FeasibilityOut, PathOut
from joulemap.service.schemas.speeds import SpeedsOut
from joulemap.service.schemas.tours import TourOut

Point = PlaceLike
Progress = Callable[[float], object]


class ServedCostMap:
    """A cost map of a service, asked as a `CostMap` of the library is.

    Parameters
    ----------
    connection : Connection
        To its service.
    about : CostmapOut
        What the service says of it.

    Attributes
    ----------
    about : CostmapOut
        Robot, model, frame, prices, what is blocked, and how it was made.
    """

    def __init__(self, connection: Connection, about: CostmapOut) -> None:
        self._connection, self.about = connection, about

    @property
    def id(self) -> str:
        """By which the service knows it."""
        return self.about.id

    @property
    def warnings(self) -> list[str]:
        """Where map or robot lie outside what the model learned."""
        return self.about.warnings

    @property
    def grid(self) -> GridFrame:
        """Where its cells lie."""
        frame = self.about.frame
        if frame is None:
            raise ConflictError(f"cost map {self.id} is {self.about.status}: wait until it is done", id=self.id)
        west, _, _, north = frame.bounds
        return GridFrame(west, north, frame.spacing_m, frame.rows, frame.cols, frame.crs)

    @property
    def crs(self) -> str | None:
        """Its coordinate system, None where the heightmap did not name one."""
        return self.grid.crs

    @property
    def _place(self) -> str:
        return f"/v1/costmaps/{self.id}"

    def plan(self, start: Point, goal: Point, *, progress: Progress | None = None, **options: Any) -> PathOut:
        """Find the route of least energy, and the shortest one beside it.

        Parameters
        ----------
        start, goal : sequence of float or mapping
            World x, y [m]; or latitude, longitude, as `joulemap.service.coordinates.world_point` reads them.
        progress : callable, optional
            Called with the share done, 0..1.
        **options
            Other fields of a path request: planner, neighbours, refine, alternatives, snap, bound,
            time_limit_s, seed, battery, objective, quantile and max_power_w.

        Returns
        -------
        PathOut
            Energies in J.

        Raises
        ------
        PointError, BlockedError, NoRouteError
            As `CostMap.plan`.
        """
        body = {"start": _sent(start), "goal": _sent(goal), **options}
        if progress is None:
            return self._connection.ask(PathOut, "POST", f"{self._place}/paths", json=body)
        for name, document in self._connection.events(f"{self._place}/paths", body):
            if name == "answer":
                return PathOut.model_validate(document)
            progress(float(document))
        raise BusyError("the connection ended before the answer came", url=self._connection.url)

    def plan_geojson(self, start: Point, goal: Point, *, coordinates: str = "wgs84", **options: Any) -> dict[str, Any]:
        """Find the same routes, as GeoJSON.

        Parameters
        ----------
        start, goal : sequence of float or mapping
            As in `plan`.
        coordinates : str, optional
            "wgs84" (longitude, latitude [degrees]) or "map" (x, y [m] in the CRS of the map).
        **options
            As in `plan`.

        Returns
        -------
        dict
            A FeatureCollection of lines with heights.

        Raises
        ------
        InputError
            If the map has no CRS, and degrees are wanted.
        """
        body = {"start": _sent(start), "goal": _sent(goal), **options}
        answer = self._file("paths", body, "geojson", coordinates)
        lines = document_of(answer.content)
        if lines.get("type") != "FeatureCollection":
            raise stranger(answer, "no GeoJSON")
        return lines

    def plan_file(
        self, start: Point, goal: Point, *, format: str, coordinates: str | None = None, **options: Any
    ) -> bytes:
        """Find the same routes, as a file for another program.

        Parameters
        ----------
        start, goal : sequence of float or mapping
            As in `plan`.
        format : str
            "gpx", "qgc-plan", ...: a name of `joulemap.service.exports.routes.ROUTE_FORMATS`.
        coordinates : str, optional
            Of GeoJSON, "wgs84" or "map".
        **options
            As in `plan`.

        Returns
        -------
        bytes
            The file.

        Raises
        ------
        InputError
            If the map has no CRS and the format needs degrees.
        """
        body = {"start": _sent(start), "goal": _sent(goal), **options}
        return self._file("paths", body, format, coordinates).content

    def _ask(self, answer: type[Answer], question: str, wanted: OnMap) -> Answer:
        return self._connection.ask(answer, "POST", f"{self._place}/{question}", json=_body(wanted))

    def tour_file(
        self, stops: Sequence[Point], *, format: str, coordinates: str | None = None, **options: Any
    ) -> bytes:
        """Find the same tour as `tour`, as a file for another program.

        Parameters
        ----------
        stops : sequence of points
            As in `tour`.
        format : str
            As in `plan_file`.
        coordinates : str, optional
            Of GeoJSON, "wgs84" or "map".
        **options
            As in `tour`.

        Returns
        -------
        bytes
            The file.

        Raises
        ------
        InputError
            If the map has no CRS and the format needs degrees.
        """
        return self._file("tours", {"stops": [_sent(stop) for stop in stops], **options}, format, coordinates).content

    def _file(self, question: str, body: dict[str, Any], format: str, coordinates: str | None) -> httpx.Response:
        query = {"format": format} | ({} if coordinates is None else {"coordinates": coordinates})
        return self._connection.send("POST", f"{self._place}/{question}", json=body, params=query)

    def tour(self, stops: Sequence[Point], **options: Any) -> TourOut:
        """Find the round trip of least energy over several stops, home first.

        Parameters
        ----------
        stops : sequence of points
            World x, y [m].
        **options
            Other fields of a tour request: neighbours, refine, time_limit_s, snap, battery.

        Returns
        -------
        TourOut
            With its legs.

        Raises
        ------
        PointError, BlockedError, NoRouteError
            As `CostMap.tour`.
        """
        body = {"stops": [_sent(stop) for stop in stops], **options}
        return self._connection.ask(TourOut, "POST", f"{self._place}/tours", json=body)

    @asks(ReachRequest)
    def reach(self, wanted: ReachRequest) -> ReachOut:
        """Say where the battery lasts to from a place, or where it lasts to and back.

        Parameters
        ----------
        wanted : ReachRequest
            Its fields are parameters of this method.

        Returns
        -------
        ReachOut
            Outlines and areas, one for each charge.

        Raises
        ------
        PointError, BlockedError
            As `CostMap.reach`.
        """
        return self._ask(ReachOut, "reach", wanted)

    def feasibility(
        self,
        route: PathOut | TourOut | Sequence[Point] | None = None,
        *,
        start: Point | None = None,
        goal: Point | None = None,
        round_trip: bool = False,
        snap: bool = False,
        avoid: Sequence[Sequence[Point]] = (),
        charge: float = 1.0,
        reserve: float = 0.0,
        capacity_wh: float | None = None,
        battery: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> FeasibilityOut:
        """Say whether the battery lasts for a route, or for the best one between two points.

        Parameters
        ----------
        route : PathOut, TourOut or sequence of points, optional
            What is driven; points are world x, y [m].
        start, goal : sequence of float, optional
            World x, y [m], instead of a route.
        round_trip : bool, optional
            Whether the way back is driven too: the best one, or the same points in reverse where points are given.
        snap : bool, optional
            Whether a start or goal on blocked ground is moved to the nearest free place.
        avoid : sequence of sequence of points, optional
            Areas that no route may touch: the corners of each.
        charge : float, optional
            State of charge at the start, 0..1.
        reserve : float, optional
            Share of the capacity that must remain, 0..1.
        capacity_wh : float, optional
            Energy of the full battery [Wh]; by default the robot's.
        battery : mapping, optional
            More that is known of the battery, as `joulemap.Battery` has it: `resistance_ohm`, `cutoff_v`, ...
        **options
            Other fields of the request: objective, quantile and max_power_w, with `start` and `goal`.

        Returns
        -------
        FeasibilityOut
            The verdict, in words and numbers.

        Raises
        ------
        InputError
            If it is neither a route nor both ends.
        """
        body: dict[str, Any] = {
            "round_trip": round_trip,
            "snap": snap,
            "avoid": [[_sent(corner) for corner in area] for area in avoid],
            **options,
        }
        body["battery"] = {"charge": charge, "reserve": reserve, "capacity_wh": capacity_wh, **(battery or {})}
        points = route.path if isinstance(route, PathOut | TourOut) else route
        if isinstance(route, PathOut) and round_trip:
            points = None
            start, goal = ([v for v in place[:2] if v is not None] for place in (route.path[0], route.path[-1]))
        for name, value in (("start", start), ("goal", goal)):
            body |= {} if value is None else {name: _sent(value)}
        body |= {} if points is None else {"path": [_sent(point) for point in points]}
        return self._connection.ask(FeasibilityOut, "POST", f"{self._place}/feasibility", json=body)

    def speeds(self, points: Sequence[Point] | None = None, **asked: Any) -> SpeedsOut:
        """Give the cheapest cruising speed of a route, and its energy against its time.

        Parameters
        ----------
        points : sequence of points, optional
            World x, y [m], in order.
        **asked
            `start` and `goal` in place of points, `snap`, `avoid`: see the HTTP reference.

        Returns
        -------
        SpeedsOut
            At the speeds that the model learned from.

        Raises
        ------
        InputError
            If the model does not know what speed costs.
        """
        body = {name: value for name, value in asked.items() if value is not None}
        body |= {name: _sent(body[name]) for name in ("start", "goal") if name in body}
        body |= {} if points is None else {"path": [_sent(point) for point in points]}
        return self._connection.ask(SpeedsOut, "POST", f"{self._place}/speeds", json=body)

    def homeward(self, position: Point, home: Point, **asked: Any) -> ReturnOut:
        """Say until where a robot may follow the rest of its path and still come home: the point of no return.

        Parameters
        ----------
        position, home : sequence of float or mapping
            World x, y [m].
        **asked
            `path`, `charging`, `battery` with the charge now, `confidence`, `avoid`: see the HTTP reference.

        Returns
        -------
        ReturnOut
            In words and numbers.

        Raises
        ------
        PointError, BlockedError
            As `CostMap.homeward`.
        """
        body = {"position": _sent(position), "home": _sent(home), **asked}
        for name in ("path", "charging"):
            if body.get(name) is not None:
                body[name] = [_sent(point) for point in body[name]]
        return self._connection.ask(ReturnOut, "POST", f"{self._place}/return", json=body)

    def at(self, point: Point) -> AtOut:
        """Return the energy per metre at one place in all headings.

        Parameters
        ----------
        point : sequence of float
            World x, y [m].

        Returns
        -------
        AtOut
            With the reasons where headings are blocked.
        """
        place = dict(point) if isinstance(point, Mapping) else {"x": point[0], "y": point[1]}
        return self._connection.ask(AtOut, "GET", f"{self._place}/at", params=place)

    def data(self, format: str = "geotiff") -> bytes:
        """Return the whole cost map as a file.

        Parameters
        ----------
        format : str, optional
            "geotiff", "cog", "npz", "zarr" and "nav2-map", which are zipped, or "nav2-graph".

        Returns
        -------
        bytes
            The file.
        """
        return self._connection.send("GET", f"{self._place}/data", params={"format": format}).content


def _body(wanted: OnMap) -> dict[str, Any]:
    """What is sent of a question: what was given, places as lists."""
    return {name: _plain(getattr(wanted, name)) for name in wanted.model_fields_set}


def _plain(value: Any) -> Any:
    if isinstance(value, Battery):
        return {name: one for name, one in asdict(value).items() if one is not None}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, str) or not isinstance(value, Iterable):
        return value
    return [_plain(one) for one in (value.tolist() if hasattr(value, "tolist") else value)]


def _sent(point: Any) -> Any:
    return dict(point) if isinstance(point, Mapping) else list(point)
