"""QGroundControl: a .plan file with the mission of a rover."""

from __future__ import annotations

import json
from typing import Any

from joulemap.service.exports.mission import CHANGE_SPEED, GROUND_SPEED, UNCHANGED_THROTTLE, WAYPOINT, mission_of
from joulemap.service.exports.track import Track
from joulemap.service.places.coordinates import DECIMALS

ARDUPILOT, GROUND_ROVER = 3, 10
"""MAV_AUTOPILOT_ARDUPILOTMEGA and MAV_TYPE_GROUND_ROVER."""

_RELATIVE_HEIGHT, _NO_PLACE = 3, 2  # MAV_FRAME_GLOBAL_RELATIVE_ALT and MAV_FRAME_MISSION
_ABOVE_HOME = 1  # altitude mode


def write(track: Track) -> bytes:
    """Return what is driven as a plan of QGroundControl.

    Result: JSON: a waypoint for each corner that the energy needs, at height 0 above home, and each change of speed.

    Reference: QGroundControl Developer Guide, Plan File Format.
    """
    mission = mission_of(track)
    items: list[dict[str, Any]] = []
    for speed_mps, (lon, lat) in mission.items():
        if speed_mps is not None:
            change = [GROUND_SPEED, round(speed_mps, 3), UNCHANGED_THROTTLE, 0, 0, 0, 0]
            items.append(_item(len(items) + 1, CHANGE_SPEED, _NO_PLACE, change))
        place = [round(lat, DECIMALS), round(lon, DECIMALS), 0]
        height = {"Altitude": 0, "AltitudeMode": _ABOVE_HOME, "AMSLAltAboveTerrain": None}
        items.append(_item(len(items) + 1, WAYPOINT, _RELATIVE_HEIGHT, [0, 0, 0, None, *place]) | height)
    speed = round(mission.speeds_mps[0], 3)
    lon, lat = mission.waypoints[0]
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": ARDUPILOT,
            "vehicleType": GROUND_ROVER,
            "cruiseSpeed": speed,
            "hoverSpeed": speed,
            "globalPlanAltitudeMode": _ABOVE_HOME,
            "plannedHomePosition": [round(lat, DECIMALS), round(lon, DECIMALS), round(mission.height_m, 3)],
            "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    return (json.dumps(plan, indent=2, allow_nan=False) + "\n").encode()


def _item(number: int, command: int, frame: int, params: list[Any]) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "doJumpId": number,
        "frame": frame,
        "params": params,
    }
