"""Small heightmaps as the bytes of files of every format, whole ones and hostile ones."""

import io
import struct
import warnings
import zipfile
import zlib

import numpy as np
from rasterio.io import MemoryFile
from rasterio.transform import Affine

HEIGHTS = np.add.outer(np.arange(40) * 0.1, np.arange(60) * 0.01).astype(np.float32)  # row 0 lowest
UTM = Affine(0.5, 0.0, 366_966.5, 0.0, -0.5, 4_064_491.5)
ROUGH = np.random.default_rng(0).normal(100.0, 5.0, (300, 280)).astype(np.float32)
ASC = b"ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value -1\n1 2 3\n4 -1 6.5\n"


def geotiff(values: np.ndarray = HEIGHTS, *, mask: np.ndarray | None = None, **options: object) -> bytes:
    profile = {"crs": "EPSG:32630", "transform": UTM, "dtype": values.dtype.name} | options
    bands = values if values.ndim == 3 else values[None]
    scale, offset, unit = (profile.pop(key, None) for key in ("scale", "offset", "unit"))
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=bands.shape[2], height=bands.shape[1], count=bands.shape[0], **profile
        ) as dataset:
            dataset.write(bands)
            if mask is not None:
                dataset.write_mask(mask)
            if scale is not None:
                dataset.scales, dataset.offsets = (scale,), (offset,)
            if unit is not None:
                dataset.units = (unit,)
        return bytes(memory.read())


def png(counts: np.ndarray) -> bytes:
    bands = counts if counts.ndim == 3 else counts[None]
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore")
        with memory.open(
            driver="PNG", width=bands.shape[2], height=bands.shape[1], count=bands.shape[0], dtype=counts.dtype.name
        ) as dataset:
            dataset.write(bands)
        return bytes(memory.read())


def npy(values: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


def npz(**arrays: object) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def npy_header(shape: tuple[int, ...], dtype: str = "<f4") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": dtype, "fortran_order": False, "shape": shape})
    return out.getvalue()


def png_header(cols: int, rows: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    ihdr = struct.pack(">IIBBBBB", cols, rows, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", ihdr) + chunk(b"IDAT", zlib.compress(b"\0" * 9)) + chunk(b"IEND", b"")


def huge_geotiff() -> bytes:
    """A GeoTIFF of 40,000 x 30,000 cells in which nothing was written: a few kilobytes."""
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=40_000,
            height=30_000,
            count=1,
            dtype="float32",
            transform=UTM,
            sparse_ok=True,
            tiled=True,
            blockxsize=4096,
            blockysize=4096,
            nodata=-1.0,
        ):
            pass
        return bytes(memory.read())


def huge_npz() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("heights.npy", npy_header((40_000, 30_000)) + b"\0" * 1_000_000)
    return out.getvalue()


def points_file(kind: str, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> bytes:
    """The same points as PCD or PLY, with a column more."""
    rows = np.column_stack([x, y, z, np.arange(x.size)])
    head = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 8 8 8 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {x.size}\n"
        f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {x.size}\nDATA {kind.partition(' ')[2]}\n"
    ).encode()
    text = "".join(" ".join(f"{value:.4f}" for value in row) + "\n" for row in rows).encode()
    order = ">" if "big" in kind else "<"
    record = np.dtype([(axis, f"{order}f8") for axis in "xyz"] + [("i", f"{order}f4")])
    table = np.zeros(x.size, record)
    for k, name in enumerate(record.names):
        table[name] = rows[:, k]
    if kind.startswith("pcd"):
        if kind.endswith("compressed"):
            plain = b"".join(table[name].tobytes() for name in record.names)
            packed = b"".join(
                bytes([min(32, len(plain) - k) - 1]) + plain[k : k + 32] for k in range(0, len(plain), 32)
            )
            return head + struct.pack("<II", len(packed), len(plain)) + packed
        return head + (text if kind.endswith("ascii") else table.tobytes())
    form = {"ascii": "ascii", "little": "binary_little_endian", "big": "binary_big_endian"}[kind.partition(" ")[2]]
    kinds = "".join(f"property double {axis}\n" for axis in "xyz") + "property float i\nelement face 0\n"
    header = f"ply\nformat {form} 1.0\ncomment made up\nelement vertex {x.size}\n{kinds}"
    return f"{header}property list uchar int vertex_indices\nend_header\n".encode() + (
        text if form == "ascii" else table.tobytes()
    )
