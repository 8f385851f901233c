"""Structure without a formula: a curve over a covariate, or a field over the map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from joulemap.model.loop.forms.base import Form, steps
from joulemap.model.runs.features import Features, FloatArray, quantity
from joulemap.model.runs.units import watts_of_column

_GROUND = ("cross_slope", "roughness", "position_index", "grade", "elevation")
_GEOMETRY = (*_GROUND, "speed", "turning", "turn", "since_start")
_OF_POSITION = frozenset(
    {"heading", "yaw", "gps_course", "wind_from", "gps_error", "speed", "gps_speed", "z", "lat", "lon"}
)
"""Logged columns that are angles, or say again where and how fast the robot is."""
_NAMED = {
    **{key: key for key in ("turning", "speed", "cross_slope", "roughness")},
    "turn": "turning_to_one_side",
    **{f"column:{key}": key for key in ("temperature", "payload")},
}
"""Covariates whose effect has a name, whatever its form."""
_FORECAST = frozenset({"column:temperature", "column:payload", "column:wind_speed"})
"""Logged columns that are known before a drive."""
_DRAGGING = frozenset({"heading", "speed", "elevation", "position_index", "cross_slope", "roughness"})
"""Covariates of a drag, which costs nothing where a slope pushes harder."""
_KNOTS = (4, 8)  # coarse and fine; runs left out decide
_BANDS = (8, 24)  # of heading: 45 and 15 degrees
_LEAST_IN_BELL = 12  # rows within one width of a centre of a field


@dataclass(frozen=True)
class Curve(Form):
    """A piecewise linear curve over a covariate, constant beyond its outer knots.

    Attributes
    ----------
    over : str
        The covariate. Heading is periodic.
    knots : tuple of float
        Its values at the knots.
    of : str
        `length` for energy per metre, `time` for power, `all` for a share of the prediction.
    centred : bool
        Whether it is nil at its middle knot; otherwise runs without the effect say where it is nil.
    odd : bool
        Whether it is the difference between both signs of the covariate: nil at 0, and opposite at opposite values.
    """

    over: str
    knots: tuple[float, ...]
    of: str = "length"
    centred: bool = True
    odd: bool = False

    key = "curve"
    resists = True
    label = "structure"
    meaning = "energy added, at points of a fitted curve"
    reveals = "the same line while only this covariate changes"

    @property
    def name(self) -> str:
        return _NAMED.get(self.over, "learned:" + self.over.removeprefix("column:"))

    @property
    def title(self) -> str:
        if self.over in _NAMED:
            return self.name.replace("_", " ")
        return "structure in " + self.over.removeprefix("column:").replace("_", " ")

    @property
    def weather(self) -> bool:  # type: ignore[override]
        """Whether it is a curve over the weather or a load, whose law holds in the baseline runs too."""
        return self.over in _FORECAST

    @property
    def covariates(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.over,)

    @property
    def parts(self) -> tuple[str, ...]:
        return ("turning",) if self.odd else ()

    @property
    def known_before(self) -> bool:
        if self.over.startswith("column:"):
            return self.over in _FORECAST
        return self.over not in ("turn", "since_start")

    def _kept(self) -> list[int]:
        return [k for k in range(len(self.knots)) if not (self.centred and k == len(self.knots) // 2)]

    def against_baseline(self) -> Form:
        return replace(self, centred=False)

    def coefficient_names(self) -> tuple[str, ...]:
        return tuple(f"at {self.knots[k]:.4g}" for k in self._kept())

    def units(self, energy: str) -> tuple[str, ...]:
        power = "W" if energy == "J" else "A"
        return ({"length": f"{energy}/m", "time": power, "all": "of the prediction"}[self.of],) * len(self._kept())

    def columns(self, rows: Features) -> FloatArray:
        values = quantity(rows, self.over)
        values = np.where(np.isfinite(values), values, self.knots[len(self.knots) // 2])
        period = 2.0 * math.pi if self.over == "heading" else None
        at = (0.0, *self.knots) if self.odd else self.knots
        hats = [
            np.interp(values, at, hat, period=period) - (np.interp(-values, at, hat) if self.odd else 0.0)
            for hat in np.eye(len(at))[-len(self.knots) :][self._kept()]
        ]
        driven = rows.work_m * rows.pulling if self.over in _DRAGGING else rows.work_m
        amount = {"length": driven, "time": rows.duration_s, "all": rows.hotel_and_motion}[self.of]
        return np.nan_to_num(np.stack(hats, axis=1) * amount[:, None])

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        moving = rows.take(~rows.standing)
        for count in _BANDS:
            yield cls("heading", tuple(round(2.0 * math.pi * k / count, 6) for k in range(count)))
        logged = (
            f"column:{key}" for key in moving.columns if key not in _OF_POSITION and watts_of_column(key) is None
        )  # what a logged power costs is no curve (`AuxiliaryPower`)
        for over in (*_GEOMETRY, *logged):
            odd, values = over == "turn", quantity(moving, over)
            for knots in sorted({steps(np.abs(values) if odd else values, count) for count in _KNOTS}, key=len):
                if odd and len(knots) > 1:
                    yield cls(over, knots[1:], centred=False, odd=True)
                elif len(knots) > 1:
                    yield from (cls(over, knots, of) for of in (("length", "time") if ":" in over else ("length",)))

    def where(self, coefficients: tuple[float, ...]) -> str:
        ends = f"between {self.knots[0]:.4g} and {self.knots[-1]:.4g}" if self.over != "heading" else "everywhere"
        return ends + ("; to the left as much less" if self.odd else "")


@dataclass(frozen=True)
class PlaceField(Form):
    """Rolling resistance in addition as a smooth field over the map: Gaussian functions around centres.

    Attributes
    ----------
    centres : tuple of tuple of float
        x, y [m] of each.
    width_m : float
        Standard deviation of the functions [m].
    """

    centres: tuple[tuple[float, float], ...]
    width_m: float

    key = "local_friction"
    resists = True
    label = "local rolling resistance"
    meaning = "coefficient of rolling resistance added at each centre of the field"
    unit = ""
    reveals = "cross the place and its surroundings in several headings"
    of_map = True

    def coefficient_names(self) -> tuple[str, ...]:
        return tuple(f"at x {x:.1f}, y {y:.1f}" for x, y in self.centres)

    def columns(self, rows: Features) -> FloatArray:
        at = np.asarray(self.centres, dtype=np.float64)
        far = (rows.x[:, None] - at[:, 0]) ** 2 + (rows.y[:, None] - at[:, 1]) ** 2
        return (rows.weight_length * rows.pulling)[:, None] * np.exp(-0.5 * far / self.width_m**2)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        moving = ~rows.standing
        x, y = rows.x[moving], rows.y[moving]
        extent = max(float(np.ptp(x)), float(np.ptp(y)))
        for width in (extent / 8.0, extent / 14.0):
            if width < 1.0 or not x.any():  # without positions there are no places
                continue
            grid = [np.arange(v.min() + 0.325 * width, v.max() + 0.325 * width, 1.3 * width) for v in (x, y)]
            centres = tuple(
                (round(float(cx), 2), round(float(cy), 2))
                for cx in grid[0]
                for cy in grid[1]
                if (np.hypot(x - cx, y - cy) <= width).sum() >= _LEAST_IN_BELL
            )
            if 2 <= len(centres) <= moving.sum() // _LEAST_IN_BELL:
                yield cls(centres, round(width, 2))

    def where(self, coefficients: tuple[float, ...]) -> str:
        k = int(np.argmax(np.abs(coefficients)))
        x, y = self.centres[k]
        return f"a field over the map, strongest about x {x:.1f}, y {y:.1f}: {coefficients[k]:+.2g}"
