"""Which of GDAL's drivers may open a file, and a dataset that is cut off from the network and from other files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import PurePosixPath
from uuid import uuid4

import rasterio
from rasterio.io import DatasetReader, MemoryFile

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.source_file import SourceFile

GDAL_OPTIONS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no .aux.xml, .ovr, .msk, world files
    "GDAL_PAM_ENABLED": "NO",
    "PROJ_NETWORK": "OFF",
    "GDAL_CACHEMAX": 128,  # [MB]
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none",  # no address, whatever a file names
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "GDAL_VRT_RAWRASTERBAND_ALLOWED_SOURCE": "SIBLING_OR_CHILD_OF_VRT_PATH",
    "AAIGRID_DATATYPE": "Float64",  # else the first lines decide whether there are decimals
}
"""Settings of GDAL and PROJ under which every file and every CRS is read."""

_WITH_SIDE_FILES = {"GDAL_DISABLE_READDIR_ON_OPEN": "FALSE", "GDAL_PAM_ENABLED": "YES"}

_ALONE = (
    "GTiff PNG AAIGrid GRASSASCIIGrid GSAG GSBG GS7BG SRTMHGT DTED USGSDEM HFA netCDF PNM JPEG BMP WEBP JP2OpenJPEG "
    "ZMap GXF BT Terragen SIGDEM HF2 GTX ISG NWT_GRD NGSGEOID FIT EHdr ENVI SAGA RRASTER RST PCRaster AIG"
)
ALONE = tuple(_ALONE.split(" "))
"""Drivers of one file, or of files whose names follow from it. In memory they cannot reach any other."""

_NAMING = "VRT ERS ILWIS PDS PDS4 ISIS2 ISIS3 VICAR HDF5 HDF5Image BAG S102 LCP MFF KRO PAux"
BESIDE = (*ALONE, *_NAMING.split(" "))
"""Drivers of files that may name others, too: for files of the user who runs joulemap."""

_FUNCTION = re.compile(r"\b(TIFF|GTiff|JPEG|PNG|HFA|VSI|CPL|GDAL|OGR)\w*:\s*")
"""Names of functions inside GDAL, which its messages begin with."""


_GRIDS = (b"grids=", b"proj4_grids", b"parameterfile")
_NO_GRID = re.compile(rb"grids=(?:@null\b|\s|$)")
_PIECE_BYTES = 1 << 24


def is_gdal_error(error: Exception) -> bool:
    """Decide whether an exception is a failure of GDAL or PROJ.

    Result: True for rasterio's own classes.

    Some properties of a dataset (`colorinterp` is one) raise GDAL's errors in classes which `rasterio.errors` does not
    export. They are recognised by the package that defines them.
    """
    return type(error).__module__.partition(".")[0] == "rasterio"


@contextmanager
def opened(source: SourceFile, drivers: Sequence[str], *, what: str, part: str = "") -> Iterator[DatasetReader]:
    """Open a dataset with some drivers alone."""
    beside = not source.alone and not isinstance(source.place, bytes)
    if not beside:
        _check_grids(source, what)
    options = GDAL_OPTIONS | (_WITH_SIDE_FILES if beside or source.beside else {})
    with rasterio.Env(**options), ExitStack() as stack:
        try:
            if beside or (not isinstance(source.place, bytes) and tuple(drivers) == ("GTiff",)):
                place = str(source.place)
            else:
                folder = uuid4().hex
                for name, content in source.beside:
                    stack.enter_context(MemoryFile(content, dirname=folder, filename=_plain(name)))
                content = source.place if isinstance(source.place, bytes) else source.place.read_bytes()
                place = stack.enter_context(MemoryFile(content, dirname=folder, filename=_plain(source.name))).name
            address = f"{drivers[0]}:{place}:{part}" if part else place
            with DatasetReader(address, driver=list(drivers)) as dataset:
                yield dataset
        except Exception as error:
            if not (is_gdal_error(error) or isinstance(error, (UnicodeDecodeError, OSError))):
                raise
            cause = error.__cause__ or error
            if type(cause).__name__ == "CPLE_OutOfMemoryError" or "cannot allocate" in str(cause):
                raise TooLargeError(
                    f"{what} asks for more memory than there is for one of its blocks: write it in smaller ones "
                    "(gdal_translate -co TILED=YES IN OUT)"
                ) from error
            words = re.sub(r"'?/vsimem/\S*/", "", _FUNCTION.sub("", str(cause)))[:300]
            raise HeightmapError(f"{what} is truncated or corrupt: {words}") from error


def _check_grids(source: SourceFile, what: str) -> None:
    """Refuse a sent file whose CRS names a file: GDAL opens that one already as it opens a GeoTIFF of Esri's."""
    longest = len(_GRIDS[-1])
    for stream in (source.open(), *(BytesIO(content) for _, content in source.beside)):
        with stream:
            end = b""
            while piece := stream.read(_PIECE_BYTES):
                text = end + piece.lower()
                text, end = _NO_GRID.sub(b"", text), text[-longest:]
                if any(word in text for word in _GRIDS):
                    raise HeightmapError(
                        f"{what} names a file of grid shifts in its coordinate reference system, which is not opened: "
                        "save it with EPSG:n"
                    )


def _plain(name: str) -> str:
    """A name that GDAL may see: some drivers take the place from it (N36W005.hgt)."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", PurePosixPath(name.replace("\\", "/")).name)[-80:].lstrip(".") or "file"
