"""What the registries of formats hold: the name, the suffix and the function of each, and which one a file means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from joulemap.model.errors import InputError, nearest_name


@dataclass(frozen=True)
class Format:
    """A format that routes or cost maps are written in.

    Attributes
    ----------
    name : str
        Value of `format`.
    suffix : str
        How its file ends, or the first of its files.
    media_type : str
        For HTTP; of several files, a zip.
    words : str
        What it is for.
    home : str
        Module of this package and function that writes it, "module:function".
    degrees : bool
        Whether it needs longitude and latitude, WGS 84.
    """

    name: str
    suffix: str
    media_type: str
    words: str
    home: str
    degrees: bool = False

    def write(self, *what: Any, **how: Any) -> Any:
        """Return what its function writes."""
        module, function = self.home.split(":")
        return getattr(import_module(f"{__package__}.{module}"), function)(*what, **how)


def format_of(formats: Mapping[str, Format], file: str | Path, name: str | None = None) -> Format:
    """Return the format of a name, or of a file that is to be written. Raises InputError where neither says one."""
    if name is not None:
        if name in formats:
            return formats[name]
        near = nearest_name(name, formats)
        hint = f"; did you mean {near}?" if near else "."
        raise InputError(f"there is no format {name!r}{hint} Known are {', '.join(formats)}", format=name)
    found = [known for known in formats.values() if str(file).lower().endswith(known.suffix)]
    if not found:
        suffixes = ", ".join(f"{known.suffix} ({known.words})" for known in formats.values())
        raise InputError(
            f"the name {Path(file).name!r} does not say what to write: let it end with one of {suffixes}, or give "
            "`format`",
            path=str(file),
        )
    return max(found, key=lambda known: len(known.suffix))
