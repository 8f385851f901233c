"""What a cost map gives out: pictures, arrays, files, words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.errors import ConflictError
from joulemap.planner.lattice.folder import save_lattice
from joulemap.service.analysis.cost_lattices import summarise
from joulemap.service.exports.maps import save_map
from joulemap.service.library.costmap_base import CostMapBase
from joulemap.service.library.shown import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset


class CostMapOutput(Shown, CostMapBase):
    """A cost map as a picture, an array, a file or a table."""

    def plot(self, ax: Axes | None = None, *, view: str | None = None, heading_deg: float | None = None) -> Axes:
        """Draw the energy per metre in colour.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw. By default a new figure is made with pyplot.
        view : str, optional
            "mean" over the headings, "directionality" (dearest minus cheapest heading), or "heading". By default
            "heading" where one is given, "mean" otherwise.
        heading_deg : float, optional
            The heading of the view "heading", clockwise from north.

        Returns
        -------
        matplotlib.axes.Axes
            The map, in metres of its CRS, with a colour bar.

        Raises
        ------
        InputError
            On another view, or without a heading where one is needed.
        """
        from joulemap.service.render.map_drawing import draw_costmap
        from joulemap.service.render.map_style import new_axes

        ax = new_axes() if ax is None else ax
        view = view or ("mean" if heading_deg is None else "heading")
        drawn = draw_costmap(ax, self._whole, view=view, heading_deg=heading_deg)
        ax.figure.colorbar(drawn.scale, ax=ax, label=drawn.label, extend=drawn.extend)
        ax.set_title(drawn.title)
        if drawn.handles:
            ax.legend(handles=drawn.handles, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False)
        return ax

    def to_xarray(self) -> Dataset:
        """Return prices, heights and what is blocked with coordinates and units.

        Returns
        -------
        xarray.Dataset
            Dimensions y, x, heading; energy per metre [J/m] is NaN where that heading is blocked.
        """
        from joulemap.planner.lattice.xarray_dataset import lattice_dataset

        return lattice_dataset(self._whole)

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the map as a folder in zarr format, which `open_costmap` and `xarray.open_zarr` open.

        Parameters
        ----------
        path : str or Path
            Usually NAME.zarr.
        overwrite : bool, optional
            Whether a cost map that is there already is replaced.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        ConflictError
            If something is there already, and `overwrite` is false.
        """
        folder = Path(path)
        if folder.exists() and not overwrite:
            raise ConflictError(
                f"{folder} is there already: choose another name, or say overwrite=True", path=str(path)
            )
        save_lattice(self._whole, folder)
        return folder

    def write_geotiff(self, path: str | Path) -> Path:
        """Write a GeoTIFF: `export` with the format "geotiff".

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced.

        Returns
        -------
        Path
            The file.
        """
        return self.export(path, format="geotiff")

    def export(self, path: str | Path, *, format: str | None = None, origin: Sequence[float] | None = None) -> Path:
        """Write the map for another program; the name says for which, like site.yaml (Nav2) or site.cog.tif.

        Parameters
        ----------
        path : str or Path
            The file; one that is there is replaced. A Nav2 map has its image beside it.
        format : str, optional
            A name of `joulemap.service.exports.maps.MAP_FORMATS`; by default the suffix decides.
        origin : tuple of float, optional
            Of Nav2 formats: world x, y of the place that gets the coordinates 0, 0 [m].

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the format is unknown, or has an origin of its own.
        """
        return save_map(self._whole, path, format, origin=origin)[0]

    def summary(self) -> dict[str, Any]:
        """Return least, mean and greatest price [J/m], and the share that is blocked, by reason.

        Returns
        -------
        dict
            As the service answers it.
        """
        return summarise(self._whole)

    def _title(self) -> str:
        rows, cols = self.lattice.frame.shape
        spacing = self.lattice.frame.resolution_m
        return f"Cost map of {cols} x {rows} cells of {spacing:g} m, {self.lattice.headings} headings"

    def _rows(self) -> dict[str, str]:
        figures = self.summary()
        price, shares = figures["energy_per_m"], figures["blocked"]
        west, south, east, north = self.bounds
        blocked = ", ".join(f"{share:.1%} {reason}" for reason, share in shares.items() if reason != "free" and share)
        rows = {
            "area": f"x {west:.1f} to {east:.1f}, y {south:.1f} to {north:.1f} m, {self.crs or 'CRS not known'}",
            "robot": f"{self.robot.name}, {self.robot.mass_kg:g} kg, {self.robot.speed_mps:g} m/s",
            "model": str(self.lattice.provenance.get("model", {}).get("name", "not known")),
            "energy per metre": "{min:.1f} to {max:.1f} J/m, mean {mean:.1f} J/m".format(**price) if price else "none",
            "blocked": blocked.replace("_", " ") or "nothing",
        }
        return rows | ({"warning": "; ".join(self.warnings)} if self.warnings else {})

    def __repr__(self) -> str:
        return f"<{self._title()}, robot {self.robot.name}>"
