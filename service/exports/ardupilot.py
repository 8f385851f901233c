"""ArduPilot, Mission Planner, MAVProxy: a .waypoints file (QGC WPL 110)."""

from __future__ import annotations

from typing import Any

from joulemap.service.exports.mission import CHANGE_SPEED, GROUND_SPEED, UNCHANGED_THROTTLE, WAYPOINT, mission_of
from joulemap.service.exports.track import Track, degree_text

_ABSOLUTE_HEIGHT, _RELATIVE_HEIGHT = 0, 3  # MAV_FRAME_GLOBAL and MAV_FRAME_GLOBAL_RELATIVE_ALT


def write(track: Track) -> bytes:
    """Return what is driven as a waypoint file.

    Result: text: home, then a waypoint for each corner that the energy needs, at height 0, and each change of speed.

    Reference: MAVLink Developer Guide, Mission Plain-Text File Format.
    """
    mission = mission_of(track)
    rows: list[Any] = [(_ABSOLUTE_HEIGHT, WAYPOINT, (0, 0, 0, 0), mission.waypoints[0], mission.height_m)]
    for speed_mps, waypoint in mission.items():
        if speed_mps is not None:
            change = (GROUND_SPEED, speed_mps, UNCHANGED_THROTTLE, 0)
            rows.append((_RELATIVE_HEIGHT, CHANGE_SPEED, change, (0.0, 0.0), 0.0))
        rows.append((_RELATIVE_HEIGHT, WAYPOINT, (0, 0, 0, 0), waypoint, 0.0))
    lines = ["QGC WPL 110"]
    for number, (frame, command, params, (lon, lat), height) in enumerate(rows):
        current = int(number == 0)
        values = [f"{value:g}" for value in params]
        place = [degree_text(lat), degree_text(lon), f"{height:.3f}"]
        lines.append("\t".join([str(number), str(current), str(frame), str(command), *values, *place, "1"]))
    return ("\n".join(lines) + "\n").encode()
