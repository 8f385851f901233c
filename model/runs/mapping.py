"""Which columns of a log are joulemap's columns, and in which unit: given by the user, or found by their names.

A mapping is a dict from joulemap's column to a source. A source is the name of a column, several of them with signs
between, and optionally a unit or a factor after a colon: `batt_current_mA:mA`, `left+right`, `-pack_current`,
`wheel_rad_s:0.165`.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.runs.units import (
    COUNTED,
    PER_ROW,
    UNITS,
    conversion,
    known_unit,
    own_unit,
    quantity_of,
    unit_in_name,
)

MappingLike = Mapping[str, str] | Sequence[str] | str | Path
"""A dict, texts such as `current=batt_current_mA:mA`, or the name of a TOML file."""

CAPACITY, RADIUS, ROW = CONSTANTS = ("capacity_wh", "wheel_radius_m", "row_s")
"""Said as numbers: what the battery holds [Wh], with which a state of charge is an energy; how large a wheel is [m],
with which its turning is a way; how long a row of a log without a time lasts [s]."""

SIGNS = {"+": 1, "-": -1}
"""Before the name of a column; of a power or a current it says which sign discharges."""

_TARGET = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
_MOST_ENTRIES = 200
_LONGEST_SOURCE = 500


@dataclass(frozen=True)
class Source:
    """Where a column of joulemap is taken from: the sum of columns with signs."""

    parts: tuple[tuple[int, str], ...]
    unit: str = ""  # as `units.known_unit` returns it; empty for joulemap's own

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return [column for _, column in self.parts]

    def words(self, target: str) -> str:
        """Return what is taken, as a report writes it. Result: such as `batt_current_mA [mA]`."""
        signed = "".join(
            f"{'-' if sign < 0 else '+' if k else ''}{column}" for k, (sign, column) in enumerate(self.parts)
        )
        unit = self.unit or own_unit(target)
        return f"{signed} [{unit}]" if unit and not signed.endswith(f"[{unit}]") else signed


def read_mapping(given: MappingLike | None) -> dict[str, str]:
    """Return a mapping from any of the ways to give one. Result: by joulemap's column; empty for None."""
    if given is None:
        return {}
    if isinstance(given, Mapping):
        pairs: list[tuple[object, object]] = list(given.items())
    elif isinstance(given, Path) or (isinstance(given, str) and "=" not in given):
        pairs = list(_from_toml(Path(given)).items())
    else:
        pairs = [_pair(text) for each in ([given] if isinstance(given, str) else given) for text in _entries(each)]
    found: dict[str, str] = {}
    if len(pairs) > _MOST_ENTRIES:
        raise RunsError(f"a mapping has at most {_MOST_ENTRIES} entries, this one has {len(pairs)}")
    for target, source in pairs:
        if not isinstance(target, str) or not _TARGET.fullmatch(target):
            raise RunsError(f"{str(target)[:80]!r} is no name of a column: write t=timestamp_ms:ms, for example")
        if not isinstance(source, str) or not source.strip() or len(source) > _LONGEST_SOURCE:
            raise RunsError(
                f"the column `{target}` is taken from {str(source)[:80]!r}: write the name of a column of the log and, "
                "after a colon, its unit"
            )
        if target in found:
            raise RunsError(f"the mapping gives the column `{target}` twice")
        found[target] = source.strip()
    return found


def source_of(target: str, text: str, columns: Collection[str], name: str) -> Source:
    """Return the source that a text of a mapping means.

    Result: with the unit given, else the unit that the column's name says.
    """
    if target in CONSTANTS and _is_number(text):
        return Source((), text)
    whole = _parts(text, columns)
    if whole is not None:
        units = {unit_in_name(target, column)[1] for _, column in whole}
        return Source(whole, (units.pop() or "") if len(units) == 1 else "")
    front, colon, word = text.rpartition(":")
    parts = _parts(front, columns) if colon else None
    if parts is None:
        wanted = front if colon and known_unit(target, word.strip()) is not None else text
        raise _no_column(target, wanted, columns, name)
    unit = known_unit(target, word.strip())
    if unit is None:
        known = ", ".join(UNITS.get(quantity_of(target) or "", {})) or "none"
        if target in COUNTED:
            known += f", each with {PER_ROW} where a row says what came since the row before"
        raise RunsError.of_run(
            name,
            f"`{target}` cannot be in {word.strip()[:40]!r}: its units are {known}, or a factor such as 0.01",
            column=target,
        )
    conversion(target, unit)
    return Source(parts, unit)


def replaced(target: str, chosen: Collection[str]) -> bool:
    """Return whether the user has said a column, or another way to say the same.

    Result: True too of `lat` where x and y are said, and of a current where another or a power is.
    """
    if target in chosen:
        return True
    if target in ("lat", "lon"):
        return "x" in chosen and "y" in chosen
    if target in ("x", "y"):
        return "lat" in chosen and "lon" in chosen
    if target == "current" or target.startswith("current_"):
        return "power" in chosen or any(key == "current" or key.startswith("current_") for key in chosen)
    return False


def _entries(text: str) -> list[str]:
    """`t=a:ms,current=b` is two entries; a comma inside a name begins no new one."""
    return re.split(r",(?=\s*[A-Za-z_][A-Za-z0-9_]*\s*=)", text)


def _pair(text: str) -> tuple[str, str]:
    target, equals, source = text.partition("=")
    if not equals:
        raise RunsError(f"{text[:80]!r} is no entry of a mapping: write t=timestamp_ms:ms, for example")
    return target.strip(), source.strip()


def _from_toml(file: Path) -> dict[str, object]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise RunsError(f"the mapping {file}: {error.strerror or error}", path=str(file)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RunsError(
            f'the mapping {file} is no TOML file: {str(error)[:200]}; a line is like t = "timestamp_ms:ms"',
            path=str(file),
        ) from error


def _parts(text: str, columns: Collection[str]) -> tuple[tuple[int, str], ...] | None:
    """Columns with signs; names may hold signs themselves, so the longest name that fits is taken. None if none fit."""
    text, parts = text.strip(), list[tuple[int, str]]()
    while text:
        sign = 1
        if text[0] in SIGNS and (parts or text not in columns):
            sign, text = SIGNS[text[0]], text[1:].lstrip()
        elif parts:
            return None
        fitting = [column for column in columns if column and text.startswith(column) and _ends(text[len(column) :])]
        if not fitting:
            return None
        longest = max(fitting, key=len)
        parts.append((sign, longest))
        text = text[len(longest) :].lstrip()
    return tuple(parts) or None


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text)) and float(text) > 0
    except ValueError:
        return False


def _ends(rest: str) -> bool:
    return not rest.strip() or rest.lstrip()[0] in SIGNS


def _no_column(target: str, wanted: str, columns: Collection[str], name: str) -> RunsError:
    close = get_close_matches(wanted, list(columns), 3, 0.5)
    listed = ", ".join(close or sorted(columns)[:20]) or "none"
    return RunsError.of_run(
        name,
        f"`{target}` is to be taken from {wanted[:80]!r}, which is no column of it; "
        f"{'near it are' if close else 'it has'} {listed[:400]}",
        column=wanted[:80],
    )
