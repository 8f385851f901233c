"""What to do after a calibration, in sentences: the next drive, what to look for, the next commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from joulemap.service.words import any_of, percent

_SUGGESTED = 3  # effects to look for where none was found


@dataclass(frozen=True)
class NextStep:
    """Something to do with what was found.

    Attributes
    ----------
    purpose : str
        What it is for, as the beginning of a sentence.
    command : str
        To be typed as it is.
    """

    purpose: str
    command: str


def drive_words(drive: Mapping[str, Any]) -> str:
    """Return what to drive next. Result: sentences, without the corners of the route."""
    if "why_not" in drive:
        return f"No drive is suggested: {drive['why_not']}."
    (x, y), points = drive["points"][0], drive["points"]
    sides = [max(values) - min(values) for values in zip(*points, strict=True)]
    where = (
        f"near x {x:.1f}, y {y:.1f}"
        if drive["placed"]
        else f"on {sides[0]:.1f} x {sides[1]:.1f} m of level ground, wherever there is room"
    )
    pace = " and ".join(f"{speed:.2f} m/s" for speed in drive["speeds_mps"])
    share = percent(drive["expected_interval_share"], 0)
    aim = (
        f"to distinguish {drive['label']} from {any_of(drive['confounded_labels'])}"
        if drive["confounded_labels"]
        else f"to measure {drive['label']} more precisely"
    )
    return (
        f"Drive {drive['kind']} {where}, repeated for {drive['total_length_m']:.0f} m at {pace}, {aim}. The 95 % "
        f"interval of its coefficient is then expected to be {share} as wide as now."
    )


def likeliest(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what could be driven to find an effect where none was found."""
    able = [c for c in document["candidates"] if not c["taken"] and c["p_value"] < 1.0]
    ranked = sorted(able, key=lambda c: c["p_value"])
    return [(c["label"], c["reveals"]) for c in ranked][:_SUGGESTED]
