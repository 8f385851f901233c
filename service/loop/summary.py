"""What a calibration found and what to do next, in sentences: for the report page and for the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from joulemap.model.runs.words import number_words, quantity_name, quantity_value
from joulemap.service.loop.effect_words import base_words, confounded_words, found_words
from joulemap.service.loop.error_words import (
    advice,
    error_words,
    level_words,
    odds_words,
    plan_words,
    site_words,
    unknown_words,
    variation_words,
)
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


FORMER_KEYS = {
    "test_set": "kept_aside",
    "confounded_with": "tells_from",
}
"""Key today -> the key of versions before 0.2."""


def with_former_keys(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document that has its renamed values under their former keys too."""
    out = {key: with_former_keys(value) if isinstance(value, dict) else value for key, value in document.items()}
    return out | {former: out[key] for key, former in FORMER_KEYS.items() if key in out}


_SAID_RANGES = ("speed", "grade", "turning")  # in sentences; the report's table has all


def headline(document: Mapping[str, Any]) -> str:
    """Return the shortest answer to what was found."""
    names = ", ".join(effect["label"] for effect in document["effects"])
    found = f"Found: {names}" if names else "No missing effect was found"
    return f"{found}. {words}" if (words := advice(document)) else found


def summary_lines(document: Mapping[str, Any]) -> list[str]:
    """Return the whole summary, as the command line and Python print it."""
    first, *rest = found_words(document)
    lines = [
        headline(document),
        *level_words(document),
        "Base parameters:",
        *(f"  {words}" for words in base_words(document)),
    ]
    lines += [first, *(f"  {words}" for words in rest), variation_words(document), *error_words(document)]
    lines += [*unknown_words(document), *plan_words(document), *odds_words(document)]
    return [*lines, *confounded_words(document), range_words(document), *site_words(document)]


def range_words(document: Mapping[str, Any]) -> str:
    """Return in which ranges the calibrated model holds."""
    ranges = document["ranges"]
    driven = [
        f"{quantity_name(key)} {number_words(ranges[key][0])} to {quantity_value(key, ranges[key][1])}"
        for key in _SAID_RANGES
        if key in ranges
    ]
    return f"Driven: {', '.join(driven)}. Beyond these, effects keep their value at the border."
