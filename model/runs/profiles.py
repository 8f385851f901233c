"""Ready mappings: logs of known tools and data sets, recognised by the names of their columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """One kind of log.

    Attributes
    ----------
    name : str
        What people call it.
    recognised_by : tuple of str
        Columns that such a log has.
    mapping : mapping of str to tuple of str
        By joulemap's column, sources in the order of preference; the first whose columns are there is taken.
    """

    name: str
    recognised_by: tuple[str, ...]
    mapping: Mapping[str, tuple[str, ...]]


PROFILES = [
    Profile(
        "VESC Tool log",
        ("ms_today", "input_voltage", "current_in"),
        {
            "t": ("ms_today:ms",),
            "voltage": ("input_voltage:V",),
            "current": ("current_in_setup:A", "current_in:A"),
            "lat": ("gnss_lat:deg",),
            "lon": ("gnss_lon:deg",),
            "z": ("gnss_alt:m",),
            "gps_error": ("gnss_hAcc:m",),
            "speed": ("speed_meters_per_sec:m/s",),
            "motor_temperature": ("temp_motor:degC",),
        },
    ),
    Profile(
        "WheelLog log",
        ("date", "time", "voltage", "current", "totaldistance"),
        {
            "t": ("date+time:s",),
            "lat": ("latitude:deg",),
            "lon": ("longitude:deg",),
            "z": ("gps_alt:m",),
            "speed": ("speed:km/h",),
            "motor_temperature": ("system_temp:degC",),
        },
    ),
    Profile(
        "BorealTC log (husky)",
        ("velL",),
        {
            "t": ("time:s",),
            "current_left": ("curL:A",),
            "current_right": ("curR:A",),
            "speed_left": ("velL:m/s",),
            "speed_right": ("velR:m/s",),
        },
    ),
    Profile(
        "cuadriga log",
        ("t", "x", "y", "current_left", "current_right", "gps_error", "drive_ref"),
        {"t": ("t:s",), "current_left": ("current_left:A",), "current_right": ("current_right:A",)},
    ),
    Profile(
        "DRIVE log (warthog)",
        ("t", "x", "y", "voltage", "current", "wheel_left_rad_s", "icp_index"),
        {"t": ("t:s",), "voltage": ("voltage:V",), "current": ("current:A",)},
    ),
]
"""All ready mappings, in the order in which they are tried. VESC Tool's and WheelLog's names are those of the headers
that these programs write; the others are those of the published data sets."""
