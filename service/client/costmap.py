"""A cost map of a service, asked as a cost map in memory is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import httpx
from pydantic import BaseModel

from joulemap.model.errors import BusyError, ConflictError
from joulemap.model.frames import GridFrame
from joulemap.service.client.connection import Connection, document_of, stranger
from joulemap.service.places.areas_given import corners_of
from joulemap.service.places.coordinates import PlaceLike
from joulemap.service.questions.asking import asks
from joulemap.service.questions.at import AtRequest
from joulemap.service.questions.charging import ChargingOut, ChargingRequest
from joulemap.service.questions.feasibility import FeasibilityRequest
from joulemap.service.questions.given import battery_with, plain
from joulemap.service.questions.homeward import ReturnOut, ReturnRequest
from joulemap.service.questions.matrix import MatrixOut, MatrixRequest
from joulemap.service.questions.parts import OnMap
from joulemap.service.questions.path import PathRequest
from joulemap.service.questions.reach import ReachOut, ReachRequest
from joulemap.service.questions.speeds import SpeedsOut, SpeedsRequest
from joulemap.service.questions.tour import TourRequest
from joulemap.service.schemas.maps import AtOut, CostmapOut
from joulemap.service.schemas.planning import FeasibilityOut, PathOut, TourOut

Point = PlaceLike
Progress = Callable[[float], object]
_ANSWERS: Mapping[str, tuple[str, type[BaseModel], type[OnMap]]] = {
    "path": ("paths", PathOut, PathRequest),
    "tour": ("tours", TourOut, TourRequest),
    "matrix": ("matrix", MatrixOut, MatrixRequest),
    "reach": ("reach", ReachOut, ReachRequest),
    "feasibility": ("feasibility", FeasibilityOut, FeasibilityRequest),
    "speeds": ("speeds", SpeedsOut, SpeedsRequest),
    "homeward": ("return", ReturnOut, ReturnRequest),
    "charging": ("charging", ChargingOut, ChargingRequest),
}
"""Where a question is asked, what is answered and what is sent, by its module in `service.questions`."""


def _given(**query: str | None) -> dict[str, str]:
    return {name: value for name, value in query.items() if value is not None}


class ServedCostMap:
    """A cost map of a service, asked as a `CostMap` of the library is, and with its errors.

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

    @asks(PathRequest)
    def plan(self, wanted: PathRequest, *, progress: Progress | None = None) -> PathOut:
        """Find the route of least energy, and the shortest one beside it.

        Returns
        -------
        PathOut
            Energies in J.
        """
        return self.ask("path", wanted, progress=progress)

    @asks(PathRequest)
    def plan_geojson(self, wanted: PathRequest, *, coordinates: str = "wgs84") -> dict[str, Any]:
        """Find the same routes, as GeoJSON.

        Parameters
        ----------
        coordinates : str, optional
            "wgs84" (longitude, latitude [degrees]) or "map" (x, y [m] in the CRS of the map).

        Returns
        -------
        dict
            A FeatureCollection of lines with heights.

        Raises
        ------
        InputError
            If the map has no CRS, and degrees are wanted.
        """
        answer = self._file("paths", wanted, format="geojson", coordinates=coordinates)
        lines = document_of(answer.content)
        if lines.get("type") != "FeatureCollection":
            raise stranger(answer, "no GeoJSON")
        return lines

    @asks(PathRequest)
    def plan_file(
        self, wanted: PathRequest, *, format: str, coordinates: str | None = None, origin: str | None = None
    ) -> bytes:
        """Find the same routes, as a file for another program.

        Parameters
        ----------
        format : str
            "gpx", "qgc-plan", ...: a name of `joulemap.service.exports.routes.ROUTE_FORMATS`.
        coordinates : str, optional
            Of GeoJSON, "wgs84" or "map".
        origin : str, optional
            Of formats for ROS: "x,y" [m] or "start", which gets the coordinates 0,0.

        Returns
        -------
        bytes
            The file.

        Raises
        ------
        InputError
            If the map has no CRS and the format needs degrees.
        """
        return self.file("path", wanted, format=format, coordinates=coordinates, origin=origin)

    def _body(self, wanted: OnMap) -> dict[str, Any]:
        """What is sent of a question: what was given."""
        given = {name: getattr(wanted, name) for name in wanted.model_fields_set}
        if "avoid" in given:
            given["avoid"] = corners_of(given["avoid"], self.grid)
        return plain(given)

    def ask(self, question: str, wanted: OnMap, *, progress: Progress | None = None) -> Any:
        """Ask a question by the name of its module in `joulemap.service.questions`.

        Parameters
        ----------
        question : str
            "path", "tour", "matrix", "reach", "feasibility", "speeds", "homeward" or "charging".
        wanted : OnMap
            Its request.
        progress : callable, optional
            Called with the share done, 0..1, while a path is searched.

        Returns
        -------
        BaseModel
            As the method of this question returns it.

        Raises
        ------
        BusyError
            If the connection ends before the answer comes.
        """
        place, answer, _ = _ANSWERS[question]
        if progress is None or answer is not PathOut:
            return self._connection.ask(answer, "POST", f"{self._place}/{place}", json=self._body(wanted))
        for name, document in self._connection.events(f"{self._place}/{place}", self._body(wanted)):
            if name == "answer":
                return PathOut.model_validate(document)
            progress(float(document))
        raise BusyError("the connection ended before the answer came", url=self._connection.url)

    def file(
        self,
        question: str,
        wanted: OnMap | None = None,
        *,
        format: str,
        coordinates: str | None = None,
        origin: str | None = None,
        **fields: Any,
    ) -> bytes:
        """Return the routes that answer a question, as a file for another program.

        Parameters
        ----------
        question : str
            "path", "tour", "feasibility" or "speeds".
        wanted : OnMap, optional
            Its request.
        format : str
            As in `plan_file`.
        coordinates : str, optional
            Of GeoJSON, "wgs84" or "map".
        origin : str, optional
            Of formats for ROS, as in `plan_file`.
        **fields
            In place of `wanted`: the fields of the request, like `stops` of a tour.

        Returns
        -------
        bytes
            The file.
        """
        place, _, request = _ANSWERS[question]
        asked = request.of(**fields) if wanted is None else wanted
        return self._file(place, asked, format=format, coordinates=coordinates, origin=origin).content

    def _file(self, question: str, wanted: OnMap, **query: str | None) -> httpx.Response:
        params = _given(**query)
        return self._connection.send("POST", f"{self._place}/{question}", json=self._body(wanted), params=params)

    @asks(TourRequest)
    def tour(self, wanted: TourRequest) -> TourOut:
        """Find the tour of least energy over several stops, home first.

        Returns
        -------
        TourOut
            With its legs.
        """
        return self.ask("tour", wanted)

    @asks(MatrixRequest)
    def matrix(self, wanted: MatrixRequest) -> MatrixOut:
        """Say what it takes to drive from each start to each goal, by one search for each start or goal.

        Returns
        -------
        MatrixOut
            A row for each start; None where there is no way, with the reason.
        """
        return self.ask("matrix", wanted)

    @asks(ChargingRequest)
    def charging(self, wanted: ChargingRequest) -> ChargingOut:
        """Find the cheapest way that never falls below the reserve, charging where it may.

        Returns
        -------
        ChargingOut
            Its legs with what is charged before each; without legs, why there is no such way.
        """
        return self.ask("charging", wanted)

    @asks(ReachRequest)
    def reach(self, wanted: ReachRequest) -> ReachOut:
        """Say where the battery lasts to from a place, or where it lasts to and back.

        Returns
        -------
        ReachOut
            Outlines and areas, one for each charge.
        """
        return self.ask("reach", wanted)

    @asks(FeasibilityRequest, "path", complete=False)
    def feasibility(
        self,
        wanted: dict[str, Any],
        route: PathOut | TourOut | Sequence[Point] | None = None,
        *,
        charge: float | None = None,
        reserve: float | None = None,
        capacity_wh: float | None = None,
    ) -> FeasibilityOut:
        """Say whether the battery lasts for a route, or for the best one between two points.

        Parameters
        ----------
        route : PathOut, TourOut or sequence of points, optional
            What is driven; points are world x, y [m]. The way back of a planned route is the best one.
        charge, reserve, capacity_wh : float, optional
            As the fields of `battery`, which then must not say otherwise.

        Returns
        -------
        FeasibilityOut
            The verdict, in words and numbers.

        Raises
        ------
        InputError
            If it is neither a route nor both ends.
        """
        state = {"charge": charge, "reserve": reserve, "capacity_wh": capacity_wh}
        wanted["battery"] = battery_with(wanted.get("battery"), **state)
        if isinstance(route, PathOut) and wanted.get("round_trip"):
            wanted |= {"start": route.path[0][:2], "goal": route.path[-1][:2]}
        elif route is not None:
            wanted["path"] = route.path if isinstance(route, PathOut | TourOut) else route
        return self.ask("feasibility", FeasibilityRequest.of(**wanted))

    @asks(SpeedsRequest, "path", complete=False)
    def speeds(self, wanted: dict[str, Any], points: Sequence[Point] | None = None) -> SpeedsOut:
        """Give the cheapest cruising speed of a route, and its energy against its time.

        Parameters
        ----------
        points : sequence of points, optional
            World x, y [m], in order, in place of start and goal.

        Returns
        -------
        SpeedsOut
            At the speeds that the model learned from.

        Raises
        ------
        InputError
            If the model does not know what speed costs.
        """
        return self.ask("speeds", SpeedsRequest.of(**wanted, path=points))

    @asks(ReturnRequest)
    def homeward(self, wanted: ReturnRequest) -> ReturnOut:
        """Say until where a robot may follow the rest of its path and still come home: the point of no return.

        Returns
        -------
        ReturnOut
            In words and numbers.
        """
        return self.ask("homeward", wanted)

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
        here = AtRequest.of(place=point).place
        place = here if isinstance(here, Mapping) else {"x": here[0], "y": here[1]}
        return self._connection.ask(AtOut, "GET", f"{self._place}/at", params=place)

    def data(self, format: str = "geotiff", *, origin: str | None = None) -> bytes:
        """Return the whole cost map as a file.

        Parameters
        ----------
        format : str, optional
            "geotiff", "cog", "npz", "zarr" and "nav2-map", which are zipped, or "nav2-graph".
        origin : str, optional
            Of Nav2 formats: "x,y" of the place that gets the coordinates 0,0 [m].

        Returns
        -------
        bytes
            The file.
        """
        return self._connection.send("GET", f"{self._place}/data", params=_given(format=format, origin=origin)).content
