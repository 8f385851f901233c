"""What a heightmap format consists of: a line in the registry, and a module that recognises and decodes its files.

This module loads neither numpy nor GDAL, because the help of the command line lists the formats.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from joulemap.model.source_file import SourceFile
    from joulemap.model.terrain.decoded import Decoded, Scaling


class WindowReader(Protocol):
    """A file of which parts can be read, and what it states about its place without its heights."""

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""

    @property
    def west_m(self) -> float | None:
        """Western edge [m], None where the file does not say."""

    @property
    def north_m(self) -> float | None:
        """Northern edge [m], None where the file does not say."""

    @property
    def resolution_m(self) -> float | None:
        """Side of a cell [m], None where the file does not say."""

    @property
    def crs(self) -> str | None:
        """Coordinate reference system, "EPSG:n" or WKT, None where the file does not say."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be known of the file."""

    def read(self, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window.

        Parameters
        ----------
        scaling : Scaling
            How stored values become metres.
        rows, cols : slice
            The window; row 0 is the northern one.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Heights [m], NaN where unknown.
        """


class FormatModule(Protocol):
    """The functions of a format's module.

    A module may have `open_windows(source, scaling, *, band, max_cells) -> WindowReader` instead of `decode`, for maps
    larger than memory.
    """

    def recognise(self, head: bytes, name: str) -> bool:
        """Decide whether a file is of this format.

        Parameters
        ----------
        head : bytes
            The first bytes of the file, 512 at most. They decide wherever the format has a mark of its own.
        name : str
            The file's name, for a format whose content has no such mark.

        Returns
        -------
        bool
            True where `decode` is to read the file.
        """

    def decode(self, source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None) -> Decoded:
        """Read the whole file.

        Parameters
        ----------
        source : SourceFile
            The file.
        scaling : Scaling
            How stored values become metres; `Scaling.to_metres` does it and refuses undeclared no-data values.
        max_cells : int
            Largest number of cells; `check_cells` refuses more of them before memory is allocated.
        band : int or None
            Band of a file with several, from 1.

        Returns
        -------
        Decoded
            Heights with row 0 in the north, and what the file says about its place.

        Raises
        ------
        HeightmapError
            If the file is broken or holds no heights.
        TooLargeError
            If it declares more than `max_cells` cells.
        """


@dataclass(frozen=True)
class HeightmapFormat:
    """One line of the registry.

    Attributes
    ----------
    name : str
        What people call the format.
    suffixes : tuple of str
        Usual endings of file names, in lower case with the dot.
    module : str
        Module with the functions of `FormatModule`. It is imported when the first file is read.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str

    @property
    def code(self) -> FormatModule:
        """The format's module, imported."""
        return cast(FormatModule, import_module(self.module, __package__))

    def open_windows(
        self, source: SourceFile, scaling: Scaling, *, band: int | None, max_cells: int
    ) -> WindowReader | None:
        """Open a file for reading by windows, if the format can do that.

        Parameters
        ----------
        source : SourceFile
            A file of this format.
        scaling : Scaling
            How stored values become metres.
        band : int or None
            Band of a file with several, from 1.
        max_cells : int
            Largest number of cells.

        Returns
        -------
        WindowReader or None
            None where files of this format are only read as a whole.
        """
        opener = getattr(self.code, "open_windows", None)
        if opener is None:
            return None
        return cast("WindowReader", opener(source, scaling, band=band, max_cells=max_cells))
