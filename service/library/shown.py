"""How objects show themselves, printed and in a notebook: a title and a table of names and values."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from html import escape


class Shown:
    """An object with a title and rows."""

    @abstractmethod
    def _title(self) -> str:
        """What it is."""

    @abstractmethod
    def _rows(self) -> Mapping[str, str]:
        """Names and values."""

    def __str__(self) -> str:
        rows = self._rows()
        width = max((len(name) for name in rows), default=0)
        return "\n".join([self._title(), *(f"  {name:<{width}}  {value}" for name, value in rows.items())])

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>{escape(value)}</td></tr>"
            for name, value in self._rows().items()
        )
        return f"<div><strong>{escape(self._title())}</strong><table>{cells}</table></div>"
