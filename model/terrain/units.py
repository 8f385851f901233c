"""Units of heights, as files name them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.crs_text import proj_crs

_SURVEY_FOOT_M = 1200 / 3937
_METRES: dict[str, float] = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters", "mtr"), 1.0),
    **dict.fromkeys(("dm", "decimetre", "decimeter", "decimetres", "decimeters"), 0.1),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimeter", "millimetres", "millimeters"), 0.001),
    **dict.fromkeys(("km", "kilometre", "kilometer", "kilometres", "kilometers"), 1000.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), 0.3048),
    **dict.fromkeys(
        ("us survey foot", "us survey feet", "us-ft", "us ft", "ftus", "foot us", "survey foot", "survey feet", "usft"),
        _SURVEY_FOOT_M,
    ),
}
_NO_LENGTH = re.compile(r"deg|radian|rad$|percent|%|m/s|db$|kelvin")


@dataclass(frozen=True)
class HeightUnit:
    """What a file says of the unit of its heights."""

    factor: float = 1.0  # Metres per unit
    said: bool = False  # Whether the file says it
    note: str = ""  # What is to be said of it; empty where they are metres


def height_unit(text: str | None, crs: str | None, what: str, *, or_horizontal: bool = False) -> HeightUnit:
    """Return the unit of heights: that of the file, else that of the vertical part of its CRS."""
    plain = re.sub(r"[\[\]().]", "", text or "").replace("_", " ").strip().lower()
    if plain in _METRES:
        return _unit(_METRES[plain], f"in {plain}")
    if _NO_LENGTH.search(plain):
        raise HeightmapError(f"the values of {what} are in {text}, and not in metres: they are no heights", unit=text)
    if plain:
        return HeightUnit(note=f"the unit of the heights is called {text[:40]!r}; they were taken for metres")  # type: ignore[index]
    if crs is None:
        return HeightUnit()
    parsed = proj_crs(crs)
    parts = [part for part in parsed.sub_crs_list if part.is_vertical]
    axes = parts[0].axis_info if parts else [axis for axis in parsed.axis_info if axis.direction == "up"]
    if not axes and or_horizontal and parsed.is_projected:
        axes = parsed.axis_info[:1]
    return (
        _unit(axes[0].unit_conversion_factor, f"in {axes[0].unit_name}, the unit of its CRS") if axes else HeightUnit()
    )


def _unit(factor: float, words: str) -> HeightUnit:
    if abs(factor - 1.0) < 1e-9:
        return HeightUnit(said=True)
    return HeightUnit(factor, True, f"its heights are {words} and were multiplied by {factor:.10g}")
