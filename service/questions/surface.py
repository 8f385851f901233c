"""How a heightmap is made of the positions that a robot drove over: `driven_surface` takes these by the same names."""

from __future__ import annotations

from pydantic import Field

from joulemap.model.runs.driven_surface import MAX_GAP_M, RESOLUTION_M, SMOOTHING_M
from joulemap.service.schemas.base import Request


class SurfaceOptions(Request):
    """How a heightmap is made of driven positions."""

    resolution_m: float = Field(default=RESOLUTION_M, ge=0.01, description="side of a cell [m]")
    smoothing_m: float = Field(
        default=SMOOTHING_M, ge=0.01, description="waves shorter than this lose more than half their height [m]"
    )
    max_gap_m: float = Field(
        default=MAX_GAP_M, ge=0.01, description="ground farther than this from a driven position is unknown [m]"
    )
    antenna_height_m: float = Field(default=0.0, description="height of the logs' `z` above the ground [m]")
    crs: str | None = Field(default=None, description="CRS in metres, e.g. EPSG:32630; `lat` and `lon` need it")
