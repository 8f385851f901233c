"""`joulemap follow`: a log replayed as if the robot were driving now, with the forecast of the rest."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output
from joulemap.service.commands.options import there

if TYPE_CHECKING:
    from joulemap.service.driving.ahead import Metres

LEFT_M = 50.0
"""Setting: a robot that is further beside its route for ten seconds has left it [m]: ten times the error of a usual fix
(`ahead.BACK_M`). A wild fix is shorter."""
_SAME_M = 1e-6  # rounding of a place that is projected onto the end


def follow(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", callback=there, help="The log of a drive, of any known format.")
    ],
    wanted: Annotated[Wanted, "joulemap.service.questions.drive:DriveRequest -path"],
    costmap: Annotated[
        Path, typer.Option("--map", metavar="MAP.zarr", callback=there, help="The cost map of the plan.")
    ],
    route: Annotated[
        Path,
        typer.Option("--route", metavar="FILE", callback=there, help="The route that was driven, as for `--path`."),
    ],
    speed: Annotated[
        float | None,
        typer.Option("--speed", min=0.1, metavar="N", help="Replay so many times as fast. [default: without waiting]"),
    ] = None,
    every: Annotated[
        float, typer.Option("--every", min=1.0, metavar="M", help="Distance between two forecasts [m].")
    ] = 10.0,
    better: Annotated[
        bool, typer.Option("--better", help="At every forecast look for another way that has become cheaper.")
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """**Follow a drive**: what its log says so far corrects the forecast of the rest of its route.

    Every line says what the rest is expected to take, why, and whether the battery lasts; changes raise an alarm. It
    begins where the log comes within 3 m of the route, and ends at the end of the route, or where the robot is more
    than 50 m beside it for 10 s, or where the log has a gap of more than an hour.

    Examples:

    `joulemap follow drive.csv --map dem.zarr --route survey.geojson`

    `joulemap follow drive.mcap --map dem.zarr --route survey.plan --charge 0.6 --speed 10`
    """
    import numpy as np

    from joulemap.model.errors import RunsError
    from joulemap.model.runs.reader import read_run
    from joulemap.planner.words import energy_words
    from joulemap.service.commands.path_files import read_path
    from joulemap.service.driving.ahead import LENGTH_M
    from joulemap.service.driving.tracking import GAP_S, LONGEST_GAP_S
    from joulemap.service.library.costmaps import open_costmap
    from joulemap.service.questions.parts import battery_of

    output, ground = Output(json_file), open_costmap(costmap)
    points, notes = read_path(route, ground.lattice.frame)
    values, _ = wanted.on(ground.lattice.frame)
    drive = ground.drive(points, battery=battery_of(values.get("battery"), ground.robot))
    run = read_run(log, crs=ground.crs)
    power = run.power_w if run.voltage_v is None or run.power_w is not None else run.voltage_v * run.current_a
    if power is None or not run.placed:
        raise RunsError(f"{log} has no {'position' if power is not None else 'power'}: a drive cannot be followed")
    output.warn([*notes, *run.notes])
    known = np.isfinite(run.x) & np.isfinite(power)
    moments = np.column_stack([run.t, run.x, run.y, power])[known].tolist()
    moments = moments[_reached(moments, drive.tracking.metres) :]
    said: list[dict[str, object]] = []
    begin, shown_m, alarms, followed, on_route_s = time.monotonic(), -every, 0, 0, moments[0][0]
    ended = "the end of the log"
    last_s = moments[0][0]
    for t, x, y, watts in moments:
        if t - last_s > LONGEST_GAP_S:
            ended = f"a gap of {(t - last_s) / 3600.0:.1f} h in the log, of which nobody knows what was taken"
            ended += f"; {len(moments) - followed} later samples of the log are not used"
            break
        last_s = t
        if speed is not None:
            time.sleep(max(0.0, (t - moments[0][0]) / speed - (time.monotonic() - begin)))
        drive.update(t, (x, y), power_w=watts)
        state, followed = drive.tracking.state, followed + 1
        if state.at_m >= shown_m + every or len(state.alarms) > alarms:
            shown_m, alarms = state.at_m, len(state.alarms)
            now = drive.forecast()
            output.say(now.text, head=f"at {now.at_m:.0f} m:", style="bold red" if now.verdict == "no" else "bold")
            said.append({"time_s": t, **now.as_dict()})
            other = drive.better_route() if better and now.left_m >= LENGTH_M.low else None
            if other is not None:
                saved = energy_words(other.saving_j)
                output.say(f"another way of {other.route.length_m:.0f} m saves {saved} of the rest", head="better")
                said[-1]["better"] = other.as_dict()
        on_route_s = t if state.off_m <= LEFT_M else on_route_s
        if state.at_m >= drive.tracking.metres.length_m - _SAME_M:
            ended = "arrival at the end of the route"
        elif t - on_route_s > GAP_S:
            ended = f"the robot left the route: it was {state.off_m:.0f} m beside it"
        else:
            continue
        ended += f"; {len(moments) - followed} later samples of the log are not used"
        break
    end = drive.forecast()
    output.table(
        {
            "followed to": ended,
            "used": f"{end.used_j / 3600.0:.2f} Wh for {end.at_m:.0f} of {end.at_m + end.left_m:.0f} m",
            "alarms": "; ".join(alarm["text"] for alarm in end.alarm_dicts()) or "none",
        }
    )
    output.document({"forecasts": said, "end": end.as_dict(), "followed_to": ended})


def _reached(moments: list[list[float]], metres: Metres) -> int:
    """Which moment is the first on the route. Raises RunsError if none is."""
    from joulemap.model.errors import RunsError
    from joulemap.service.driving.tracking import OFF_ROUTE_M

    nearest = math.inf
    for k, (_, x, y, _) in enumerate(moments):
        nearest = min(nearest, metres.nearest(x, y, 0.0, metres.length_m)[1])
        if nearest <= OFF_ROUTE_M:
            return k
    raise RunsError(
        f"the log is nowhere on the route: at its nearest it is {nearest:.0f} m beside it; a drive "
        f"begins within {OFF_ROUTE_M:g} m",
        found=nearest,
        limit=OFF_ROUTE_M,
    )
