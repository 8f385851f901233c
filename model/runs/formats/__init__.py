"""The formats of logs: one line in `FORMATS` for each, and a module that recognises and decodes its files."""

from __future__ import annotations

from joulemap.model.runs.formats.contract import LogFormat

FORMATS = [
    LogFormat("Parquet file", (".parquet",), ".parquet"),
    LogFormat("Feather file", (".feather", ".arrow"), ".feather"),
    LogFormat("arrays of MATLAB, NumPy or netCDF 3", (".mat", ".npz", ".nc"), ".arrays"),
    LogFormat("MCAP recording", (".mcap",), ".recording:MCAP", "logs"),
    LogFormat("ROS 1 bag", (".bag",), ".recording:ROS1", "logs"),
    LogFormat("ROS 2 bag (SQLite)", (".db3",), ".recording:ROS2", "logs"),
    LogFormat("ROS 2 bag of several files", (".zip", ".tar", ".tar.gz", ".tgz"), ".recording", "logs"),
    LogFormat("ArduPilot dataflash log", (".bin", ".log"), ".ardupilot", "logs"),
    LogFormat("MAVLink telemetry log", (".tlog",), ".mavlink_telemetry", "logs"),
    LogFormat("PX4 ULog", (".ulg",), ".ulog", "logs"),
    LogFormat("FIT file", (".fit",), ".fit", "logs"),
    LogFormat("JSON text", (".json", ".jsonl", ".ndjson", ".geojson"), ".json_records", text=True),
    LogFormat("YAML text", (".yaml", ".yml"), ".yaml_documents", text=True),
    LogFormat("track in XML", (".gpx", ".tcx"), ".xml_track", text=True),
    LogFormat("NMEA 0183 sentences", (".nmea", ".log", ".txt"), ".nmea", text=True),
    LogFormat("lines of name=value", (".txt", ".log"), ".pairs", text=True),
    LogFormat("CSV text", (".csv", ".tsv", ".txt"), ".text", text=True),
]
"""All formats that are read, in the order in which they are tried. A module name with a dot in front lies here."""


def formats_in_words() -> str:
    """Return the formats with their suffixes, as messages, the help and the API's description list them."""
    return ", ".join(f"{each.name} ({', '.join(each.suffixes)})" for each in FORMATS)


def suffixes() -> tuple[str, ...]:
    """Return the endings of file names by which a folder is searched for logs."""
    any_use = (".txt", ".log", ".json", ".yaml", ".yml", ".zip", ".tar", ".tar.gz", ".tgz", ".npz", ".mat", ".nc")
    return tuple(suffix for each in FORMATS for suffix in each.suffixes if suffix not in any_use)
