"""Runs that cannot belong to their map, robot or units are refused in words that say what to look for."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.errors import RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_runs, check_units
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.fixes import projected
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.segments import Segments, concatenate_segments
from joulemap.model.terrain.heightmap import Heightmap
from tests.service.test_cli import joulemap

MAP = Heightmap(np.zeros((80, 60), dtype=np.float32), GridFrame(100.0, 980.0, 1.0, 80, 60, "EPSG:32615"))
ROBOT = Robot(mass_kg=35.0, rolling_resistance=0.08, idle_power_w=12.0, speed_mps=0.5)  # 35 x 9.81 x 0.08 + 24 = 51 J/m


def driven(change: Callable[[dict[str, np.ndarray]], None] = lambda columns: None, rows: int = 600) -> Segments:
    """Half a metre a second to the east at 25.6 W, after `change` of the columns."""
    t = 0.1 * np.arange(rows)
    columns = {"t": t, "x": 110.0 + 0.5 * t, "y": np.full(rows, 940.0), "current": np.full(rows, 1.0)}
    columns["voltage"] = np.full(rows, 25.6)
    change(columns)
    lines = [",".join(columns), *(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))]
    return concatenate_segments([cut_segments(parse_run("\n".join(lines), name="run.csv"))])


def times(column: str, factor: float) -> Callable[[dict[str, np.ndarray]], None]:
    return lambda columns: columns.update({column: factor * columns[column]})


def exchanged(columns: dict[str, np.ndarray]) -> None:
    columns.update(x=columns["y"], y=columns["x"])


def elsewhere(columns: dict[str, np.ndarray]) -> None:
    columns.update(x=columns["x"] + 5000.0)


def test_runs_that_belong_to_map_and_robot_pass():
    check_runs(driven(), MAP, ROBOT)
    check_runs(driven(times("current", 20.0)), MAP, ROBOT)  # a heavy load, or deep sand


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (times("current", 1000.0), "took 51,200.0 J.*about 51.5 J.*`current` in A"),
        (times("voltage", 1000.0), "`voltage` in V"),
        (times("t", 1000.0), "`t` in s"),
        (elsewhere, r"span x 5110.*the map x 100.00..160.00, y 900.00..980.00; are they in.*EPSG:32615"),
        (exchanged, "with x and y exchanged they would lie on it"),
    ],
)
def test_what_is_wrong_is_named_with_value_and_limit(change, words):
    with pytest.raises(RunsError, match=words):
        check_runs(driven(change), MAP, ROBOT)


def test_one_run_of_many_may_be_circles_on_the_spot():
    """Whose metres take two hundred times as much: it is refused alone, and not beside runs that are as they should."""
    circles = driven(times("current", 200.0))
    with pytest.raises(RunsError, match="a metre took"):
        check_runs(circles, MAP, ROBOT)
    check_units([(driven(), ROBOT), (circles, ROBOT), (driven(), ROBOT)])
    with pytest.raises(RunsError, match="a metre took"):
        check_units([(driven(), ROBOT), (circles, ROBOT), (circles, ROBOT)])


def test_runs_without_any_segment_have_no_units_to_judge():
    check_units([(driven(rows=10), ROBOT)])
    check_units([])


def test_degrees_exchanged_on_a_map_of_a_whole_world_crs_are_seen_too():
    lat = 48.0 + 1e-5 * np.arange(60)  # a metre of the ground and 1.5 m of EPSG:3857 a row
    x, y = projected(lat, np.full(60, 9.7), "EPSG:3857")
    frame = GridFrame(float(x.min()) - 50.0, float(y.max()) + 50.0, 1.0, 300, 100, "EPSG:3857")
    heightmap = Heightmap(np.zeros((300, 100), dtype=np.float32), frame)
    rows = [f"{2 * k},9.7,{degrees:.6f},1,24\n" for k, degrees in enumerate(lat)]
    table = "t,lat,lon,current,voltage\n" + "".join(rows)
    segments = cut_segments(parse_run(table, name="run.csv", crs="EPSG:3857"))
    with pytest.raises(RunsError, match="with 'lat' and 'lon' exchanged they would lie on it"):
        check_runs(segments, heightmap, ROBOT)


def test_a_robot_that_never_moved_is_said_so():
    with pytest.raises(RunsError, match="no segment of 1 m: did the robot move"):
        check_runs(driven(rows=10), MAP, ROBOT)


def test_a_pattern_that_names_nothing_says_where_it_looked(tmp_path: Path):
    dem = tmp_path / "dem.asc"
    dem.write_text("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 1\n1 1\n")
    for pattern, words in (("no/*.csv", "'no/*.csv' names no log"), (str(tmp_path), "holds no log")):
        code, _, said = joulemap("evaluate", "--heightmap", dem, "--runs", pattern)
        assert code == 5
        assert words in said
        assert str(Path.cwd()) in said
