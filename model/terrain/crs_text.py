"""The only place where a text or an object becomes a CRS; none that names a file is taken.

PROJ opens the grids that a text names (`nadgrids`, PARAMETERFILE), wherever they lie on this machine.
"""

from __future__ import annotations

import re
from contextlib import suppress
from functools import lru_cache
from typing import Any

import rasterio
from pyproj import CRS as ProjCRS
from pyproj import Transformer
from pyproj.exceptions import CRSError, ProjError
from rasterio.crs import CRS

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.formats.gdal import GDAL_OPTIONS, is_gdal_error

_AUTHORITY = r"(?:urn:ogc:def:crs:)?[A-Za-z]+(?:_\d+)?:(?:[\d.]*:)?[A-Za-z]*\d{1,9}\s*$"
_KINDS = re.compile(rf"\s*(?:{_AUTHORITY}|[A-Za-z_]+\s*[\[(]|\{{|\+proj=)")
"""An authority's code, WKT, PROJJSON or PROJ parameters; PROJ and GDAL would also take file names and addresses."""

_HEIGHT_GRIDS = re.compile(
    r'(VERT_?DATUM\s*\[\s*"[^"]*"\s*,\s*\d+\s*),\s*EXTENSION\s*\[\s*"PROJ4_GRIDS"\s*,\s*"[^"]*"\s*\]', re.IGNORECASE
)
"""Many LAS files name the grids of their geoid. Heights are never moved to another datum, so they are not needed."""

_FILE = re.compile(r'PARAMETERFILE\b|EXTENSION\s*[\[(]\s*["\u201c]PROJ4_GRIDS', re.IGNORECASE)
_PARAMETERS = re.compile(
    r'(?:EXTENSION\s*[\[(]\s*["\u201c]PROJ4["\u201d]\s*,|(?:METHOD|PROJECTION)\s*[\[(](?=\s*["\u201c]PROJ[ -]))'
    r'\s*["\u201c]([^"\u201d]*)',
    re.IGNORECASE,
)
_PARAMETER = re.compile(
    r"\+?(?!\w*(?:grid|init|file|model|catalog))"
    r"(?:\w+(?:=[-+\d.,eE]+)?|(?:proj|o_proj|ellps|datum|units|vunits|pm|axis|title|type|sweep)=\w+)"
    r"|\+?(?:nad|geoid)grids=@null",
)
"""A parameter of PROJ that can name no file: a flag, numbers, or one word out of PROJ's own lists."""


def known_crs(crs: Any) -> CRS:
    """Return a CRS by its name, whatever its unit.

    `crs`: an authority's code, WKT, PROJJSON, or an object of rasterio or pyproj. It may name no file.
    """
    text = _checked(_text_of(crs))
    try:
        with rasterio.Env(**GDAL_OPTIONS):
            return CRS.from_string(str(proj_crs(text).to_wkt()) if text.lstrip().startswith("{") else text)
    except Exception as error:
        if not (is_gdal_error(error) or isinstance(error, (ValueError, OverflowError))):
            raise
        raise _unknown(text) from error


def proj_crs(crs: Any) -> ProjCRS:
    """Return a CRS as an object of pyproj, under the rules of `known_crs`."""
    return ProjCRS.from_user_input(_checked(_text_of(crs)))


def transformer(crs: Any, target: Any) -> Transformer:
    """Return what moves x, y (longitude, latitude) from one CRS to another; raises pyproj's `ProjError` for none."""
    return Transformer.from_crs(proj_crs(crs), proj_crs(target), always_xy=True)


def _text_of(crs: Any) -> str:
    if isinstance(crs, str):
        return crs
    if isinstance(crs, int):
        return f"EPSG:{crs}"
    for version in ("WKT1_GDAL", "WKT2_2019"):  # the first writes out the grids of a datum
        try:
            if text := crs.to_wkt(version=version):
                return str(text)
        except (CRSError, ValueError):
            continue
        except Exception as error:
            if not is_gdal_error(error):
                raise
    raise _unknown(str(crs))


@lru_cache(maxsize=256)
def _checked(text: str) -> str:
    """The text, where no file is named in it. Reading it opens none: PROJ opens grids when points are moved."""
    kept = _HEIGHT_GRIDS.sub(r"\1", text)
    if not _KINDS.match(kept):
        raise _unknown(text)
    _check(kept)
    try:
        known = ProjCRS.from_user_input(kept)
    except (CRSError, ProjError, ValueError) as error:
        raise _unknown(text) from error
    for version in ("WKT2_2019", "WKT1_GDAL"):  # as PROJ understood it: a text can hide a word (JSON's \\u0067)
        with suppress(CRSError):  # older WKT cannot say every CRS
            _check(str(known.to_wkt(version) or ""))
    return kept


def _check(text: str) -> None:
    """Refuse a text that names a file."""
    found = [text] if text.lstrip().startswith("+") else _PARAMETERS.findall(text)
    bad = _FILE.search(text) is not None or any(
        _PARAMETER.fullmatch(part) is None for parameters in found for part in parameters.split()
    )
    if bad:
        raise HeightmapError(
            f"the coordinate reference system {text[:80]!r} names a file of grid shifts, which is not opened: give "
            "EPSG:n, or WKT without files",
            crs=text[:80],
        )


def _unknown(text: str) -> HeightmapError:
    return HeightmapError(
        f"the coordinate reference system {text[:80]!r} is not known: give EPSG:n or its WKT", crs=text[:80]
    )
