"""A service at an address: what is sent to it, what it makes, and what it has."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx

from joulemap.model.errors import BusyError, ConflictError, RateError
from joulemap.model.robot import Robot
from joulemap.model.runs.mapping import MappingLike, read_mapping
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.layers.kinds import read_legend
from joulemap.service.client.connection import Connection, error_of, part_of_path
from joulemap.service.client.costmap import Progress, ServedCostMap
from joulemap.service.library.heightmaps import robot_of
from joulemap.service.questions.asking import asks
from joulemap.service.questions.costmap import CostmapOptions
from joulemap.service.questions.given import plain
from joulemap.service.schemas.loop import CalibrationOut, RunsOut
from joulemap.service.schemas.maps import CostmapOut, HeightmapOut

Job = TypeVar("Job", CostmapOut, CalibrationOut)
GroundLike = str | Path | bytes | Heightmap | HeightmapOut
"""A heightmap, its file, or the id or description of one that was sent."""
RobotLike = Robot | Mapping[str, Any] | str | Path | None

_HEIGHTMAP_ID = re.compile(r"hm-[0-9a-f]+")
_PAUSE_S = (0.05, 1.0)  # between looks whether a job is over: at first, and at most
_ABSENT_S = 60.0
"""A service that has said nothing of a job for so long is not waited for any more [s]; a restart takes ten."""


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
        self._connection = Connection(url, key=key, timeout_s=timeout_s, transport=transport)

    @property
    def url(self) -> str:
        """Address of the service."""
        return self._connection.url

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._connection.close()

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
            What the file does not say, as `read_heightmap` takes it: resolution_m, crs, scale_m ...; `layer=True` for a
            raster that cost maps name as a layer.

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
        return self._connection.ask(HeightmapOut, "POST", "/v1/heightmaps", files={"file": (name, data)}, params=query)

    @asks(CostmapOptions, "robot", complete=False)
    def costmap(
        self,
        ground: GroundLike,
        *,
        robot: RobotLike = None,
        wanted: dict[str, Any],
        progress: Progress | None = None,
        timeout_s: float | None = None,
    ) -> ServedCostMap:
        """Have a cost map made, and wait for it.

        Parameters
        ----------
        ground : str, Path, bytes, Heightmap or HeightmapOut
            A heightmap, which is sent; or the id or description of one that was sent.
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
            If it takes longer than `timeout_s`; without one, if the service says nothing of it for a minute.
        """
        layers, legend = (wanted.pop(name, None) or {} for name in ("layers", "legend"))
        body = {"heightmap_id": self._ground_id(ground)} | {n: plain(v) for n, v in wanted.items() if v is not None}
        body["layers"] = {role: self._layer(layer) for role, layer in layers.items()}
        body["legend"] = legend if isinstance(legend, Mapping) else read_legend(legend).as_dict()
        asked = self._connection.ask(CostmapOut, "POST", "/v1/costmaps", json=body | _robot_values(robot))
        return ServedCostMap(self._connection, self._wait(asked, "/v1/costmaps", progress, timeout_s))

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
        return ServedCostMap(
            self._connection, self._connection.ask(CostmapOut, "GET", f"/v1/costmaps/{part_of_path(costmap_id)}")
        )

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
        return self._connection.ask(RunsOut, "POST", "/v1/runs", files=sent, params=query)

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
            If it takes longer than `timeout_s`; without one, if the service says nothing of it for a minute.
        """
        given = [runs] if isinstance(runs, str | RunsOut) else runs
        body: dict[str, Any] = {"runs": [one if isinstance(one, str) else one.id for one in given], **options}
        if ground is not None:
            body["heightmap_id"] = self._ground_id(ground)
        asked = self._connection.ask(CalibrationOut, "POST", "/v1/calibrations", json=body | _robot_values(robot))
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
        self._connection.send("DELETE", f"/v1/{kinds[type(found)]}/{part_of_path(found.id)}")

    def _layer(self, given: Mapping[str, Any] | GroundLike) -> dict[str, Any]:
        if isinstance(given, Mapping):
            return dict(given)
        if isinstance(given, str | Path) and Path(given).suffix.lower() in (".geojson", ".json"):
            from joulemap.model.terrain.layers.polygons import read_document  # loads slowly

            return dict(read_document(given))
        return {"heightmap_id": self._ground_id(given, layer=True)}

    def _ground_id(self, ground: GroundLike, **reading: Any) -> str:
        if isinstance(ground, HeightmapOut):
            return ground.id
        if isinstance(ground, str) and _HEIGHTMAP_ID.fullmatch(ground):
            return ground
        return self.heightmap(ground, **reading).id

    def _wait(self, job: Job, place: str, progress: Progress | None, timeout_s: float | None) -> Job:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        pause, longest = _PAUSE_S
        heard = time.monotonic()
        while True:
            if progress is not None:
                progress(job.progress)
            if job.status == "failed":
                raise error_of(job.problem.model_dump() if job.problem is not None else {})
            if job.status == "cancelled":
                raise ConflictError(f"{job.id} was cancelled at {job.progress:.0%}", job_id=job.id)
            if job.status == "done":
                return job
            if deadline is not None and time.monotonic() > deadline:
                raise BusyError(f"{job.id} is {job.status} ({job.progress:.0%}) after {timeout_s:g} s", job_id=job.id)
            time.sleep(pause if deadline is None else min(pause, max(0.0, deadline - time.monotonic())))
            pause = min(1.3 * pause, longest)
            try:
                job = self._connection.ask(type(job), "GET", f"{place}/{job.id}")
            except (BusyError, RateError) as error:  # a service that restarts goes on with the job
                absent_s = time.monotonic() - heard
                if deadline is None and absent_s > _ABSENT_S:
                    words = f"the service has said nothing of {job.id} for {absent_s:.0f} s; the job may go on"
                    raise type(error)(f"{words}: {error.message}", **(error.context | {"job_id": job.id})) from error
                pause = max(pause, min(float(error.context.get("retry_after_s", 0.0)), _ABSENT_S))
            else:
                heard = time.monotonic()


def _robot_values(robot: RobotLike) -> dict[str, Any]:
    return {} if robot is None else {"robot": robot_of(robot).as_dict()}
