"""A client of a joulemap service, with the words of the Python library: what a script writes, typed, and its errors."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx
from pydantic import BaseModel

from joulemap.model.errors import BusyError, ConflictError, InputError, JoulemapError, RateError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.mapping import MappingLike, read_mapping
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.coordinates import PlaceLike
from joulemap.service.library.heightmaps import robot_of
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.schemas.homeward import ReturnOut
from joulemap.service.schemas.loop import CalibrationOut, RunsOut
from joulemap.service.schemas.maps import AtOut, CostmapOut, HeightmapOut
from joulemap.service.schemas.planning import FeasibilityOut, PathOut
from joulemap.service.schemas.reach import ReachOut
from joulemap.service.schemas.speeds import SpeedsOut
from joulemap.service.schemas.tours import TourOut

Answer = TypeVar("Answer", bound=BaseModel)
Job = TypeVar("Job", CostmapOut, CalibrationOut)
Point = PlaceLike
GroundLike = str | Path | bytes | Heightmap | HeightmapOut
"""A heightmap, its file, or the id or description of one that was sent."""
RobotLike = Robot | Mapping[str, Any] | str | Path | None
Progress = Callable[[float], object]

_HEIGHTMAP_ID = re.compile(r"hm-[0-9a-f]+")
_PAUSE_S = (0.05, 1.0)  # between looks whether a job is over: at first, and at most
_MARGIN_S = 10.0  # more than the service waits itself


class Client:
    """A joulemap service at an address.

    Parameters
    ----------
    url : str, optional
        Of the service.
    key : str, optional
        A key of `joulemap keys add`, where the service wants one.
    timeout_s : float, optional
        Longest time for one answer [s]; what takes longer is a job, and is waited for separately.
    transport : httpx.BaseTransport, optional
        How requests are sent; by default over the network.

    Examples
    --------
    >>> with jm.Client("http://127.0.0.1:8000") as service:  # doctest: +SKIP
    ...     costmap = service.costmap("dem.tif", model="physics")
    ...     print(costmap.plan((5, 5), (55, 35)).energy_j)
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        key: str | None = None,
        timeout_s: float = 300.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        self.url = url.rstrip("/")
        try:
            self._http = httpx.Client(base_url=self.url, headers=headers, timeout=timeout_s, transport=transport)
        except (httpx.InvalidURL, UnicodeEncodeError) as error:
            raise InputError(f"{url[:100]!r} with this key cannot be asked: {error}", url=url[:100]) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def heightmap(
        self, source: str | Path | bytes | Heightmap, *, name: str | None = None, **reading: Any
    ) -> HeightmapOut:
        """Send a heightmap.

        Parameters
        ----------
        source : str, Path, bytes or Heightmap
            A file, its content, or heights in memory.
        name : str, optional
            Its name for people; by default that of the file.
        **reading
            What the file does not say, as `read_heightmap` takes it: resolution_m, crs, scale_m ...

        Returns
        -------
        HeightmapOut
            With its id.

        Raises
        ------
        HeightmapError
            If it is no heightmap.
        """
        if isinstance(source, Heightmap):
            from joulemap.model.terrain.writers import write_geotiff

            data, name = write_geotiff(None, source) or b"", name or "heightmap.tif"
        elif isinstance(source, bytes):
            data, name = source, name or "heightmap"
        else:
            data, name = Path(source).read_bytes(), name or Path(source).name
        query = {key: value for key, value in reading.items() if value is not None}
        return self._ask(HeightmapOut, "POST", "/v1/heightmaps", files={"file": (name, data)}, params=query)

    def costmap(
        self,
        ground: GroundLike,
        *,
        robot: RobotLike = None,
        model: str = DEFAULT_MODEL,
        spacing_m: float = 1.0,
        headings: int = 16,
        progress: Progress | None = None,
        timeout_s: float | None = None,
    ) -> ServedCostMap:
        """Have a cost map made, and wait for it.

        Parameters
        ----------
        ground : str, Path, bytes, Heightmap or HeightmapOut
            A heightmap, which is sent; or the id or description of one that was sent.
        robot : Robot, mapping, str, Path or None, optional
            The robot, its values, or its TOML file.
        model : str, optional
            ``default``, ``physics``, or the id of a model of the service.
        spacing_m : float, optional
            Side of a cell [m].
        headings : int, optional
            Number of headings of each cell.
        progress : callable, optional
            Called with the share done, 0..1.
        timeout_s : float, optional
            Longest time to wait [s]; the job goes on after it.

        Returns
        -------
        ServedCostMap
            To be asked for routes and verdicts.

        Raises
        ------
        JoulemapError
            As the service says why it cannot be made.
        BusyError
            If it takes longer than `timeout_s`.
        """
        body = {"heightmap_id": self._ground_id(ground), "model": model, "spacing_m": spacing_m, "headings": headings}
        asked = self._ask(CostmapOut, "POST", "/v1/costmaps", json=body | _robot_values(robot))
        return ServedCostMap(self, self._wait(asked, "/v1/costmaps", progress, timeout_s))

    def open_costmap(self, costmap_id: str) -> ServedCostMap:
        """Return a cost map that the service has.

        Parameters
        ----------
        costmap_id : str
            Its id.

        Returns
        -------
        ServedCostMap
            Whether it is done or not.

        Raises
        ------
        NotFoundError
            If there is none.
        """
        return ServedCostMap(self, self._ask(CostmapOut, "GET", f"/v1/costmaps/{_part(costmap_id)}"))

    def runs(
        self,
        files: str | Path | Sequence[str | Path],
        *,
        heightmap: GroundLike | None = None,
        odometry_track_m: float | None = None,
        terrain_from_name: bool = False,
        mapping: MappingLike | None = None,
        accept_implausible: bool = False,
    ) -> RunsOut:
        """Send measured runs: all of them are kept, or none.

        Parameters
        ----------
        files : str, Path or sequence of these
            CSV, Parquet, MCAP, ROS bags, flight logs or FIT files.
        heightmap : optional
            The heightmap that they were driven on, as in `costmap`.
        odometry_track_m : float, optional
            The runs have wheel speeds only: the effective track width of the robot [m].
        terrain_from_name : bool, optional
            Whether the name of a file says on what ground it was driven.
        mapping : mapping, sequence of str, str or Path, optional
            Where columns are taken from, as in `joulemap.read_runs`.
        accept_implausible : bool, optional
            Whether runs are kept whose numbers are hardly in the units that they are read in.

        Returns
        -------
        RunsOut
            With their id, and what was read, repaired and left out.

        Raises
        ------
        RunsError
            If one cannot be read.
        """
        paths = [Path(file) for file in ([files] if isinstance(files, str | Path) else files)]
        query: dict[str, Any] = {}
        if heightmap is not None:
            query["heightmap_id"] = self._ground_id(heightmap)
        if odometry_track_m is not None:
            query |= {"odometry_track_m": odometry_track_m, "terrain_from_name": terrain_from_name}
        if mapping is not None:
            query["map"] = [f"{column}={source}" for column, source in read_mapping(mapping).items()]
        if accept_implausible:
            query["accept_implausible"] = True
        sent = [("file", (path.name, path.read_bytes())) for path in paths]
        return self._ask(RunsOut, "POST", "/v1/runs", files=sent, params=query)

    def calibrate(
        self,
        ground: GroundLike | None,
        runs: RunsOut | str | Sequence[RunsOut | str],
        *,
        robot: RobotLike = None,
        progress: Progress | None = None,
        timeout_s: float | None = None,
        **options: Any,
    ) -> CalibrationOut:
        """Have found what a model lacks on measured runs, and wait for it.

        Parameters
        ----------
        ground : str, Path, bytes, Heightmap, HeightmapOut or None
            The heightmap of the runs, as in `costmap`; None for runs without positions.
        runs : RunsOut, str or sequence of these
            Runs that were sent, or their ids.
        robot : Robot, mapping, str, Path or None, optional
            The robot that drove.
        progress : callable, optional
            Called with the share done, 0..1.
        timeout_s : float, optional
            Longest time to wait [s]; the job goes on after it.
        **options
            Other fields of a calibration request: model, baseline_runs, test_runs, start, goal, campaigns, quick, seed.

        Returns
        -------
        CalibrationOut
            With the report, and the id of the calibrated model.

        Raises
        ------
        JoulemapError
            As the service says why it cannot be done.
        BusyError
            If it takes longer than `timeout_s`.
        """
        given = [runs] if isinstance(runs, str | RunsOut) else runs
        body: dict[str, Any] = {"runs": [one if isinstance(one, str) else one.id for one in given], **options}
        if ground is not None:
            body["heightmap_id"] = self._ground_id(ground)
        asked = self._ask(CalibrationOut, "POST", "/v1/calibrations", json=body | _robot_values(robot))
        return self._wait(asked, "/v1/calibrations", progress, timeout_s)

    def delete(self, thing: HeightmapOut | RunsOut | CostmapOut | CalibrationOut | ServedCostMap) -> None:
        """Delete something that was sent or made.

        Parameters
        ----------
        thing : HeightmapOut, RunsOut, CostmapOut, CalibrationOut or ServedCostMap
            As the client returned it.

        Raises
        ------
        ConflictError
            If something else was made from it.
        """
        found = thing.about if isinstance(thing, ServedCostMap) else thing
        kinds = {HeightmapOut: "heightmaps", RunsOut: "runs", CostmapOut: "costmaps", CalibrationOut: "calibrations"}
        self._send("DELETE", f"/v1/{kinds[type(found)]}/{_part(found.id)}")

    def _ground_id(self, ground: GroundLike) -> str:
        if isinstance(ground, HeightmapOut):
            return ground.id
        if isinstance(ground, str) and _HEIGHTMAP_ID.fullmatch(ground):
            return ground
        return self.heightmap(ground).id

    def _wait(self, job: Job, place: str, progress: Progress | None, timeout_s: float | None) -> Job:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        pause, longest = _PAUSE_S
        while True:
            if progress is not None:
                progress(job.progress)
            if job.status == "failed":
                raise _error_of(job.problem.model_dump() if job.problem is not None else {})
            if job.status == "cancelled":
                raise ConflictError(f"{job.id} was cancelled at {job.progress:.0%}", job_id=job.id)
            if job.status == "done":
                return job
            if deadline is not None and time.monotonic() > deadline:
                raise BusyError(f"{job.id} is {job.status} ({job.progress:.0%}) after {timeout_s:g} s", job_id=job.id)
            time.sleep(pause)
            pause = min(1.3 * pause, longest)
            try:
                job = self._ask(type(job), "GET", f"{place}/{job.id}")
            except (BusyError, RateError) as error:  # a service that restarts goes on with the job
                if deadline is None and error.context.get("unreachable"):
                    raise
                pause = max(pause, float(error.context.get("retry_after_s", 0.0)))

    def _ask(self, model: type[Answer], method: str, path: str, **how: Any) -> Answer:
        return model.model_validate(self._send(method, path, **how).json())

    def _send(self, method: str, path: str, **how: Any) -> httpx.Response:
        try:
            answer = self._http.request(method, path, **how)
        except httpx.TransportError as error:
            raise self._unreachable(error) from error
        if not answer.is_success:
            raise _error_of(_document(answer.content), answer.status_code)
        return answer

    def _unreachable(self, error: httpx.TransportError) -> BusyError:
        words = str(error) or type(error).__name__
        return BusyError(f"the service at {self.url} does not answer: {words}", url=self.url, unreachable=True)

    def events(self, path: str, body: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Ask a question and follow it, as server-sent events.

        Parameters
        ----------
        path : str
            Of the question, which is posted.
        body : mapping
            The question.

        Yields
        ------
        tuple
            Name and document of each event: ``progress``, and at the end ``answer``.

        Raises
        ------
        JoulemapError
            As the service says why there is no answer.
        """
        try:
            with self._http.stream("POST", path, json=dict(body), headers={"Accept": "text/event-stream"}) as answer:
                if not answer.is_success:
                    raise _error_of(_document(answer.read()), answer.status_code)
                name = ""
                for line in answer.iter_lines():
                    field, _, value = line.partition(": ")
                    if field == "event":
                        name = value
                    elif field == "data" and name == "problem":
                        raise _error_of(json.loads(value))
                    elif field == "data":
                        yield name, json.loads(value)
        except httpx.TransportError as error:
            raise self._unreachable(error) from error


class ServedCostMap:
    """A cost map of a service, asked as a `CostMap` of the library is.

    Parameters
    ----------
    client : Client
        Of its service.
    about : CostmapOut
        What the service says of it.

    Attributes
    ----------
    about : CostmapOut
        Robot, model, frame, prices, what is blocked, and how it was made.
    """

    def __init__(self, client: Client, about: CostmapOut) -> None:
        self._client, self.about = client, about

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
            return self._client._ask(PathOut, "POST", f"{self._place}/paths", json=body)
        for name, document in self._client.events(f"{self._place}/paths", body):
            if name == "answer":
                return PathOut.model_validate(document)
            progress(float(document))
        raise BusyError("the connection ended before the answer came", url=self._client.url)

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
        return _document(self.plan_file(start, goal, format="geojson", coordinates=coordinates, **options))

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
        return self._file("paths", body, format, coordinates)

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
        return self._file("tours", {"stops": [_sent(stop) for stop in stops], **options}, format, coordinates)

    def _file(self, question: str, body: dict[str, Any], format: str, coordinates: str | None) -> bytes:
        query = {"format": format} | ({} if coordinates is None else {"coordinates": coordinates})
        return self._client._send("POST", f"{self._place}/{question}", json=body, params=query).content

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
        return self._client._ask(TourOut, "POST", f"{self._place}/tours", json=body)

    def reach(
        self,
        start: Point,
        *,
        charges: Sequence[float] | None = None,
        battery: Mapping[str, Any] | None = None,
        round_trip: bool = False,
        confidence: float | None = None,
        **options: Any,
    ) -> ReachOut:
        """Say where the battery lasts to from a place, or where it lasts to and back.

        Parameters
        ----------
        start : sequence of float
            World x, y [m].
        charges : sequence of float, optional
            States of charge at the start, 0..1, each answered on its own; by default that of the battery.
        battery : mapping, optional
            `charge`, `reserve`, `capacity_wh` and more, as `joulemap.Battery` has them; by default the robot's, full.
        round_trip : bool, optional
            Whether it must come back, by the best way back.
        confidence : float, optional
            With what probability the battery is to last. By default the expected energy decides.
        **options
            Other fields of a request for reach: avoid, snap.

        Returns
        -------
        ReachOut
            Outlines and areas, one for each charge.

        Raises
        ------
        PointError, BlockedError
            As `CostMap.reach`.
        """
        body = {
            "start": _sent(start),
            "charges": None if charges is None else list(charges),
            "battery": None if battery is None else dict(battery),
            "round_trip": round_trip,
            "confidence": confidence,
            **options,
        }
        return self._client._ask(ReachOut, "POST", f"{self._place}/reach", json=body)

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
        return self._client._ask(FeasibilityOut, "POST", f"{self._place}/feasibility", json=body)

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
        return self._client._ask(SpeedsOut, "POST", f"{self._place}/speeds", json=body)

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
        return self._client._ask(ReturnOut, "POST", f"{self._place}/return", json=body)

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
        return self._client._ask(AtOut, "GET", f"{self._place}/at", params=place)

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
        return self._client._send("GET", f"{self._place}/data", params={"format": format}).content


def _sent(point: Any) -> Any:
    return dict(point) if isinstance(point, Mapping) else list(point)


def _robot_values(robot: RobotLike) -> dict[str, Any]:
    return {} if robot is None else {"robot": robot_of(robot).as_dict()}


def _part(text: str) -> str:
    """A text as one part of a path. Raises InputError where it cannot be an id."""
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,100}", text) or set(text) == {"."}:
        raise InputError(f"{text[:100]!r} is no id", id=text[:100])
    return text


def _document(content: bytes) -> dict[str, Any]:
    try:
        found = json.loads(content)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _error_of(problem: Mapping[str, Any], status: int | None = None) -> JoulemapError:
    """The error of the tree that the service raised. Not every answer is a service's: a proxy's has no code."""
    code, detail = problem.get("code"), problem.get("detail")
    context = dict(problem.get("context") or {}) | {"request_id": problem.get("request_id")}
    found = next((cls for cls in _tree(JoulemapError) if cls.code == code), None)
    number = status if status is not None else int(problem.get("status") or 500)
    if found is None:
        found = InputError if 400 <= number < 500 else BusyError if number in (502, 503, 504) else JoulemapError
    return found(str(detail or f"the service answered {number} without saying why"), **context)


def _tree(cls: type[JoulemapError]) -> Iterator[type[JoulemapError]]:
    for child in cls.__subclasses__():
        yield child
        yield from _tree(child)
