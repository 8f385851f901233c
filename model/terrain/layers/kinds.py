"""Kinds of ground: what each costs by default, and how a legend names the values of a layer."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from joulemap.model.errors import InputError
from joulemap.model.robot import Robot

_FIELDS = ("value", "rolling_resistance", "factor", "std", "blocked", "source")
MOST_KINDS = 1000
"""Of a legend; land cover maps have ten to fifty."""
MOST_LETTERS = 100
"""Of the name of a kind of ground."""
MOST_VALUE = 2**53
"""Of the stored values of a layer: what numbers of 64 bits hold exactly."""
_SHOWN = 8  # values in a message
MOST_RESISTANCE, MOST_FACTOR = 2.0, 100.0
"""A force of more than twice the weight is no rolling, and a hundred times the energy no ground that one drives on."""


@dataclass(frozen=True)
class Kind:
    """A kind of ground.

    Attributes
    ----------
    name : str
        In small letters.
    rolling_resistance : float, optional
        In place of the robot's own, as a share of the weight.
    factor : float, optional
        By which the energy of motion on the robot's own ground is multiplied.
    std : float
        Standard deviation of whichever of both is given.
    blocked : bool
        Whether no part of a robot may be over it.
    source : str
        Where the numbers are from.
    """

    name: str
    rolling_resistance: float | None = None
    factor: float | None = None
    std: float = 0.0
    blocked: bool = False
    source: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("a kind of ground has no name")
        if len(self.name) > MOST_LETTERS:
            raise InputError(
                f"the name of the kind of ground {self.name[:20]!r}... has {len(self.name)} letters, and the limit is "
                f"{MOST_LETTERS}"
            )
        if self.rolling_resistance is not None and self.factor is not None:
            raise InputError(
                f"the kind of ground {self.name!r} has a rolling_resistance and a factor: give one of them"
            )
        limits = {"rolling_resistance": MOST_RESISTANCE, "factor": MOST_FACTOR, "std": MOST_FACTOR}
        for field, most in limits.items():
            value = getattr(self, field)
            if value is not None and not (math.isfinite(value) and 0.0 <= value <= most):
                raise InputError(
                    f"{field} of the kind of ground {self.name!r} is {value}, and the limits are 0 and {most:g}",
                    value=str(value),
                    limit=[0.0, most],
                )

    def resistance(self, robot: Robot) -> float | None:
        """Return its rolling resistance for a robot.

        Parameters
        ----------
        robot : Robot
            Whose own rolling resistance a factor multiplies.

        Returns
        -------
        float or None
            A share of the weight; None where neither that nor a factor is known.
        """
        return self.rolling_resistance if self.factor is None else self.factor * robot.rolling_resistance

    def as_dict(self) -> dict[str, Any]:
        """Return what is given, JSON-able."""
        return {name: value for name, value in vars(self).items() if value not in (None, False, "", 0.0)}


@dataclass(frozen=True)
class Legend:
    """The kinds of ground of a layer, and the stored values that mean them."""

    kinds: tuple[Kind, ...]  # Each once
    values: Mapping[int, int]  # Stored value -> number of the kind. Empty where values were not given.

    def as_dict(self) -> dict[str, Any]:
        """Return what each kind costs and its values, by name, JSON-able."""
        said = ("rolling_resistance", "factor", "std", "blocked")
        tables = {kind.name: {k: v for k, v in kind.as_dict().items() if k in said} for kind in self.kinds}
        for value, number in self.values.items():
            tables[self.kinds[number].name].setdefault("value", []).append(value)
        return tables

    def unlisted(self, values: Iterable[float], share: float) -> str:
        """Return what a user should know of values that a layer has and the legend has not."""
        lost = sorted(values)
        some = ", ".join(f"{value:g}" for value in lost[:_SHOWN]) + (", ..." if len(lost) > _SHOWN else "")
        return f"{100.0 * share:.3g}% has values that the legend does not name ({some}): of no kind" if lost else ""


def plain_name(name: object) -> str:
    """Return the name of a kind of ground as it is compared: in small letters, without spaces around it."""
    return str(name).strip().lower()


def legend_of(tables: Mapping[str, Any]) -> Legend:
    """Return the legend that tables by name describe.

    `tables`: name -> `value` (a whole number, or several) and `rolling_resistance` or `factor`, with `std`, or
    `blocked`; what is left out is that of the kind of this name in the library.
    """
    if len(tables) > MOST_KINDS:
        raise InputError(f"the legend has {len(tables)} kinds of ground; at most {MOST_KINDS} can be taken")
    kinds, values = list[Kind](), dict[int, int]()
    for number, (name, table) in enumerate(tables.items()):
        if not isinstance(table, Mapping):
            raise InputError(f"{name!r} in the legend is {table!r}: write a table, [{name}], with value = ...")
        strange = next((key for key in table if key not in _FIELDS), None)
        if strange is not None:
            raise InputError(f"the legend says {strange!r} of {name!r}: known are {', '.join(_FIELDS)}", key=strange)
        stored = table.get("value", ())
        for value in stored if isinstance(stored, Sequence) else (stored,):
            if isinstance(value, bool) or not (isinstance(value, int) and abs(value) <= MOST_VALUE):
                raise InputError(f"value = {value!r:.60} of {name!r} in the legend is no whole number to {MOST_VALUE}")
            if value in values:
                raise InputError(f"the value {value} means {kinds[values[value]].name!r} and {name!r}")
            values[value] = number
        given = {key: table[key] for key in _FIELDS[1:] if key in table}
        kinds.append(_kind(plain_name(name), given))
    if len({kind.name for kind in kinds}) < len(kinds):
        raise InputError("the legend names a kind of ground twice: capital and small letters are the same")
    return Legend(tuple(kinds), values)


def _kind(name: str, given: Mapping[str, Any]) -> Kind:
    try:
        numbers = {key: float(given[key]) for key in ("rolling_resistance", "factor", "std") if key in given}
    except (TypeError, ValueError) as error:
        raise InputError(f"the kind of ground {name!r} has no number where one is needed: {error}") from error
    known = library().get(name)
    if known is not None and not given:
        return known
    return Kind(name, **numbers, blocked=given.get("blocked") is True, source=str(given.get("source", "")))


def named_kinds(names: Iterable[str]) -> Legend:
    """Return the legend of names without values, with the numbers of the library where it has them."""
    return Legend(tuple(_kind(name, {}) for name in dict.fromkeys(plain_name(n) for n in names)), {})


def read_legend(path: str | Path) -> Legend:
    """Return the legend of a TOML file: a table for every kind of ground."""
    try:
        with Path(path).open("rb") as file:
            return legend_of(tomllib.load(file))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"the legend {path} cannot be read: {error}", path=str(path)) from error


@cache
def library() -> Mapping[str, Kind]:
    """Return the kinds of ground that are known without a legend, by name; their sources are in `kinds.toml`."""
    text = (resources.files("joulemap.model") / "terrain" / "layers" / "kinds.toml").read_text(encoding="utf-8")
    return {name: Kind(name, **table) for name, table in tomllib.loads(text).items()}
