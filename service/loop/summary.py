"""What a calibration found, in sentences: for the top of the report page and the answer of the command line."""

from __future__ import annotations

from collections.abc import Mapping
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
