"""`joulemap follow`: a log replayed as if the robot were driving now, with the forecast of the rest."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from joulemap.service.commands.asked import Wanted
from joulemap.service.commands.console import JsonFile, Output
from joulemap.service.commands.options import there


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
    json_file: JsonFile = None,
) -> None:
    """**Follow a drive**: what its log says so far corrects the forecast of the rest of its route.

    Every line says what the rest is expected to take, why, and whether the battery lasts; changes raise an alarm.

    Examples:

    `joulemap follow drive.csv --map dem.zarr --route survey.geojson`

    `joulemap follow drive.mcap --map dem.zarr --route survey.plan --charge 0.6 --speed 10`
    """
    import numpy as np

    from joulemap.model.errors import RunsError
    from joulemap.model.runs.reader import read_run
    from joulemap.service.commands.path_files import read_path
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
    said: list[dict[str, object]] = []
    begin, shown_m, alarms = time.monotonic(), -every, 0
    for t, x, y, watts in np.column_stack([run.t, run.x, run.y, power])[known].tolist():
        if speed is not None:
            time.sleep(max(0.0, (t - run.t[known][0]) / speed - (time.monotonic() - begin)))
        drive.update(t, (x, y), power_w=watts)
        state = drive.tracking.state
        if state.at_m >= shown_m + every or len(state.alarms) > alarms:
            shown_m, alarms = state.at_m, len(state.alarms)
            now = drive.forecast()
            output.say(now.text, head=f"{now.at_m:.0f} m", style="bold red" if now.verdict == "no" else "bold")
            said.append({"time_s": t, **now.as_dict()})
    end = drive.forecast()
    output.table(
        {
            "used": f"{end.used_j / 3600.0:.2f} Wh for {end.at_m:.0f} of {end.at_m + end.left_m:.0f} m",
            "alarms": "; ".join(alarm["text"] for alarm in end.alarm_dicts()) or "none",
        }
    )
    output.document({"forecasts": said, "end": end.as_dict()})
