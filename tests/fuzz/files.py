"""Hostile files, each as somebody would send it who wants to stop the service."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.reference.heightmap_files import ASC, geotiff, huge_geotiff, huge_npz, npy, npy_header, npz, png, png_header

MAPS, RUNS, COSTMAPS, PATHS = "/v1/heightmaps", "/v1/runs", "/v1/costmaps", "/v1/costmaps/{}/paths"
Rng = np.random.Generator
LOG = b"t,x,y,voltage,current\n" + b"".join(b"%.1f,%.2f,0,24,2\n" % (0.1 * k, 0.05 * k) for k in range(300))


@dataclass(frozen=True)
class Sent:
    """One request.

    Attributes
    ----------
    kind : str
        What is wrong with it.
    to : str
        Path of the service; {} stands for the id of a cost map.
    content : bytes
        Its body.
    params : dict
        Its query.
    """

    kind: str
    to: str
    content: bytes
    params: dict[str, Any] = field(default_factory=dict)


Maker = Callable[[Rng], Sent]
MAKERS: list[Maker] = []


def hostile(make: Maker) -> Maker:
    MAKERS.append(make)
    return make


def hostile_files(count: int, seed: int, makers: Sequence[Maker]) -> Iterator[Sent]:
    """Requests of all kinds in turn, each with sizes and contents of its own."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        yield makers[k % len(makers)](rng)


def tiff(tags: dict[int, tuple[int, int]], tail: bytes = b"") -> bytes:
    """A little-endian TIFF of one directory: tag -> (type, value)."""
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, (kind, value) in sorted(tags.items()))
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + b"\0\0\0\0" + tail


def plain_tiff(rows: int, cols: int, **more: int) -> bytes:
    tags = {256: (4, cols), 257: (4, rows), 258: (3, 32), 259: (3, 1), 262: (3, 1), 273: (4, 8), 277: (3, 1)}
    tags |= {278: (4, more.get("strip", 1)), 279: (4, 4), 339: (3, 3)}
    return tiff(tags)


def parquet(table: dict[str, Any], **options: Any) -> bytes:
    out = io.BytesIO()
    pq.write_table(pa.table(table), out, **options)
    return out.getvalue()


def zipped(members: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def damaged(rng: Rng, content: bytes) -> bytes:
    """With some bits flipped, or cut off."""
    data = bytearray(content)
    if rng.random() < 0.4:
        return bytes(data[: int(rng.integers(0, len(data)))])
    for at in rng.integers(0, len(data), int(rng.integers(1, 30))):
        data[at] ^= 1 << int(rng.integers(0, 8))
    return bytes(data)


@hostile
def one_column_of_millions(rng: Rng) -> Sent:
    rows, cols = (int(rng.integers(10**6, 10**8)), int(rng.choice([1, 1, 2, 3])))
    return Sent("TIFF of 1 x n", MAPS, plain_tiff(*((rows, cols) if rng.random() < 0.5 else (cols, rows))))


@hostile
def strips_that_are_not_there(rng: Rng) -> Sent:
    side = int(rng.integers(2_000, 9_999))
    return Sent("TIFF with missing strips", MAPS, plain_tiff(side, side, strip=int(rng.choice([1, 7, side]))))


@hostile
def dimensions_beyond_everything(rng: Rng) -> Sent:
    return Sent("TIFF of 2^32 cells a side", MAPS, plain_tiff(2**32 - 1, int(rng.choice([2, 2**31, 2**32 - 1]))))


@hostile
def directory_in_a_circle(rng: Rng) -> Sent:
    content = plain_tiff(100, 100)
    return Sent("TIFF directory that points to itself", MAPS, content[:-4] + struct.pack("<I", 8))


@hostile
def sparse_tiff(rng: Rng) -> Sent:
    return Sent("TIFF of 1.2e9 cells, nothing written", MAPS, huge_geotiff())


@hostile
def compressed_constant(rng: Rng) -> Sent:
    side = int(rng.integers(3_000, 6_000))
    constant = np.zeros((side, side), np.uint8)
    return Sent("TIFF bomb", MAPS, geotiff(constant, compress="deflate", tiled=True))


@hostile
def many_bands(rng: Rng) -> Sent:
    values = np.zeros((int(rng.integers(200, 2000)), 8, 8), np.uint8)
    return Sent("TIFF of many bands", MAPS, geotiff(values, interleave="pixel"), {"band": 5})


@hostile
def damaged_tiff(rng: Rng) -> Sent:
    return Sent("damaged TIFF", MAPS, damaged(rng, geotiff()))


@hostile
def tiff_of_nan_and_infinity(rng: Rng) -> Sent:
    values = rng.choice(np.array([np.nan, np.inf, -np.inf, 1e38, -9999.0, 3.0], np.float32), (20, 20))
    return Sent("TIFF of NaN, inf and no-data", MAPS, geotiff(values))


@hostile
def png_of_billions(rng: Rng) -> Sent:
    header = png_header(int(rng.integers(10**4, 2**31)), int(rng.integers(10**4, 2**31)))
    return Sent("PNG of billions of pixels", MAPS, header, {"scale_m": 0.1, "resolution_m": 1})


@hostile
def png_bomb(rng: Rng) -> Sent:
    side = 9_000

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    packer = zlib.compressobj(1)
    rows = b"".join(packer.compress(b"\0" * (side + 1)) for _ in range(side)) + packer.flush()
    text = chunk(b"zTXt", b"Comment\0\0" + zlib.compress(b"a" * 30_000_000))
    ihdr = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0))
    content = b"\x89PNG\r\n\x1a\n" + ihdr + text + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    return Sent("PNG bomb", MAPS, content, {"scale_m": 0.1, "resolution_m": 1})


@hostile
def damaged_png(rng: Rng) -> Sent:
    counts = rng.integers(0, 60_000, (30, 30)).astype(np.uint16)
    return Sent("damaged PNG", MAPS, damaged(rng, png(counts)), {"scale_m": 0.1, "resolution_m": 1})


@hostile
def npy_of_anything(rng: Rng) -> Sent:
    shape = tuple(int(n) for n in rng.choice([0, 1, 2, 3, 10**5, 2**40, 10**18], int(rng.integers(0, 4))))
    kind = str(rng.choice(["<f4", "<f8", "|O", "<U5", "<c16", "|V100000", "<i8", "|b1", "<M8[s]"]))
    return Sent("npy of any shape and type", MAPS, npy_header(shape, kind) + b"\0" * 500, {"resolution_m": 1})


@hostile
def pickle_in_npy(rng: Rng) -> Sent:
    out = io.BytesIO()
    np.save(out, np.array([[{}, print], [1, 2]], dtype=object), allow_pickle=True)
    return Sent("npy with a pickle", MAPS, out.getvalue(), {"resolution_m": 1})


@hostile
def npz_bomb(rng: Rng) -> Sent:
    if rng.random() < 0.5:
        return Sent("npz that claims 1.2e9 cells", MAPS, huge_npz(), {"resolution_m": 1})
    side = 6_000
    content = zipped({"heights.npy": npy_header((side, side), "<f8") + bytes(8 * side * side)})
    return Sent("npz bomb", MAPS, content, {"resolution_m": 1})


@hostile
def strange_archive(rng: Rng) -> Sent:
    inner = zipped({"heights.npy": b"x" * 1000})
    deep = zipped({"a.zip": inner, "heights.npy": inner, "../../etc/passwd": b"x", "ü\u202e.npy": b"\0"})
    many = zipped({f"d{k}/{k}.npy": b"" for k in range(30_000)})
    return Sent("archive of archives, folders, members", MAPS, [inner, deep, many][int(rng.integers(3))])


@hostile
def damaged_npz(rng: Rng) -> Sent:
    return Sent("damaged npz", MAPS, damaged(rng, npz(heights=np.ones((9, 9)), resolution_m=0.5)))


@hostile
def asc_of_words(rng: Rng) -> Sent:
    header = b"ncols %d\nnrows %d\ncellsize 1\n" % (rng.integers(1, 10**4), rng.integers(1, 10**4))
    tail = [b"1 " * 10**6, b"9" * 10**7, b"nan inf -inf 1e999 ", "१२ ünï ".encode(), b"\0" * 1000, b" " * 10**7]
    return Sent("ASCII grid of anything", MAPS, header + tail[int(rng.integers(6))])


@hostile
def asc_header(rng: Rng) -> Sent:
    key = str(rng.choice(["ncols", "nrows", "cellsize", "xllcorner", "NODATA_value"]))
    value = str(rng.choice(["1e300", "-5", "nan", "1" * 5000, "0x10", "2.5", "inf", "99999999"]))
    return Sent("ASCII grid with a strange header", MAPS, f"{key} {value}\n".encode() + ASC)


@hostile
def strange_system(rng: Rng) -> Sent:
    texts = ["BOUNDCRS[" + "A[" * 500, "LOCAL_CS[]", "EPSG:999999999", "+proj=utm", "/etc/passwd", "http://a/b", "\0"]
    texts.append('PROJCS["x",GEOGCS["y",DATUM["d",SPHEROID["s",6378137,298]],PRIMEM["p",0],UNIT["degree",0.01745]],')
    texts[-1] += 'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",999],UNIT["metre",1]]'
    params = {"crs": str(rng.choice(texts)), "resolution_m": 1}
    return Sent("strange coordinate system", MAPS, npy(np.zeros((5, 5))), params)


@hostile
def option_out_of_range(rng: Rng) -> Sent:
    key = str(rng.choice(["resolution_m", "west_m", "north_m", "scale_m", "offset_m", "nodata", "band", "name"]))
    value = str(rng.choice(["nan", "inf", "1e308", "-1e308", "1e-308", "9" * 400, "ü" * 300, "\x00", "\x1b[2J", ""]))
    return Sent("option out of range", MAPS, npy(np.zeros((5, 5))), {"resolution_m": 1, key: value})


@hostile
def nothing_or_noise(rng: Rng) -> Sent:
    content = rng.bytes(int(rng.choice([0, 1, 3, 100, 10**6])))
    return Sent("nothing, or noise", str(rng.choice([MAPS, RUNS])), content)


@hostile
def wrong_kind(rng: Rng) -> Sent:
    contents = [
        LOG,
        geotiff(),
        b"%PDF-1.7\n",
        b"<svg/>",
        zipped({"xl/workbook.xml": b"<x/>"}),
        b"\x1f\x8b\x08" + b"\0" * 99,
    ]
    return Sent("file of another kind", str(rng.choice([MAPS, RUNS])), contents[int(rng.integers(len(contents)))])


@hostile
def million_columns(rng: Rng) -> Sent:
    count = int(rng.integers(200_000, 1_000_000))
    names = [b"c%d" % k for k in range(count)] if rng.random() < 0.5 else [b"a"] * count
    return Sent("CSV of a million columns", RUNS, b",".join(names) + b"\n" + b",".join([b"1"] * count))


@hostile
def bare_returns(rng: Rng) -> Sent:
    mark = [b"\r", b"1\r", b"1,2\r", b"\r\n", b"\n\r"][int(rng.integers(5))]
    return Sent("CSV of bare carriage returns", RUNS, b"t,x\r" + mark * int(rng.integers(10**6, 2 * 10**7)))


@hostile
def million_rows(rng: Rng) -> Sent:
    row = [b"1\n", b"0,0,0,0,0\n", b'"1",2,3,4,5\n', b",,,,\n"][int(rng.integers(4))]
    return Sent("CSV of a million rows", RUNS, LOG + row * int(rng.integers(500_000, 3_000_000)))


@hostile
def long_cells(rng: Rng) -> Sent:
    word = b"w" * int(rng.integers(10**4, 10**7))
    return Sent(
        "CSV with a long text", RUNS, b"t,x,y,current,note\n" + b"1,2,3,4,a\n" * 50_000 + b"1,2,3,4," + word + b"\n"
    )


@hostile
def quotes(rng: Rng) -> Sent:
    body = [b'"' * 10**6, b'"a,\n' * 10**5, b'"",' * 10**6, b'"\r' * 10**6, b'a"b"c,"' * 10**5][int(rng.integers(5))]
    return Sent("CSV of quotes", RUNS, b"t,x,y,current\n" + body)


@hostile
def numbers_of_all_kinds(rng: Rng) -> Sent:
    words = ["nan", "inf", "-inf", "1e308", "1e-308", "-0", "1_0", "0x1p3", "", "１", "9" * 400, "1e29", "999", "-1e30"]
    names = [
        "t,x,y,current",
        "t,lat,lon,current",
        "t,x,y,power,voltage",
        "t,x,y,current_a,current_b,speed_left,speed_right",
    ]
    name = str(rng.choice(names))
    plain = np.arange(200)[:, None] * np.array([0.1] * (name.count(",") + 1))
    table = plain.astype(str)
    hits = rng.random(table.shape) < rng.choice([0.02, 0.3, 0.9])
    table = np.where(hits, rng.choice(words, table.shape), table)
    content = "\n".join([name, *(",".join(row) for row in table)]).encode()
    return Sent("numbers of all kinds", RUNS, content)


@hostile
def other_encodings(rng: Rng) -> Sent:
    text = LOG.decode().replace("voltage", "spänning")
    coding = str(rng.choice(["utf-16", "utf-32", "latin-1", "utf-8-sig", "utf-7"]))
    return Sent("CSV in another encoding", RUNS, text.encode(coding) + b"\0\0")


@hostile
def parquet_dictionary(rng: Rng) -> Sent:
    rows, letters = int(rng.integers(10**5, 9 * 10**5)), int(rng.integers(10**3, 10**5))
    words = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array(["w" * letters]))
    return Sent("Parquet dictionary bomb", RUNS, parquet({"t": np.zeros(rows), "note": words}))


@hostile
def parquet_prefixes(rng: Rng) -> Sent:
    words = [("p" * 50_000) + str(k) for k in range(2_000)]
    options = {"use_dictionary": False, "column_encoding": {"note": "DELTA_BYTE_ARRAY"}, "compression": "zstd"}
    return Sent("Parquet prefix bomb", RUNS, parquet({"t": np.arange(2000.0), "note": words}, **options))


@hostile
def parquet_nested(rng: Rng) -> Sent:
    kinds = [
        [[1.0] * 100] * 1000,
        [{"a": {"b": [1]}}] * 1000,
        pa.array([[("k", 1)]] * 1000, pa.map_(pa.string(), pa.int64())),
        pa.array([b"\xff" * 1000] * 1000, pa.binary()),
        pa.array([None] * 1000, pa.null()),
    ]
    return Sent(
        "Parquet of nested and binary types", RUNS, parquet({"t": np.arange(1000.0), "a": kinds[int(rng.integers(5))]})
    )


@hostile
def parquet_of_many(rng: Rng) -> Sent:
    if rng.random() < 0.5:
        return Sent("Parquet of many columns", RUNS, parquet({f"c{k}": [1.0] for k in range(5_000)}))
    return Sent("Parquet of many row groups", RUNS, parquet({"t": np.zeros(20_000)}, row_group_size=2))


@hostile
def parquet_compressed(rng: Rng) -> Sent:
    rows = int(rng.integers(2 * 10**6, 10**7))
    return Sent(
        "Parquet of millions of equal rows",
        RUNS,
        parquet({"t": np.zeros(rows), "x": np.zeros(rows)}, compression="zstd"),
    )


@hostile
def damaged_parquet(rng: Rng) -> Sent:
    table = {"t": np.arange(300) * 0.1, "x": np.arange(300) * 0.05, "y": np.zeros(300), "current": np.ones(300)}
    return Sent("damaged Parquet", RUNS, damaged(rng, parquet(table | {"note": ["a", "b", "c"] * 100})))


@hostile
def damaged_csv(rng: Rng) -> Sent:
    return Sent("damaged CSV", RUNS, damaged(rng, LOG), {"name": str(rng.choice(["../../x", "\u202egpj", "a" * 200]))})


@hostile
def robot_out_of_range(rng: Rng) -> Sent:
    key = str(rng.choice(["mass_kg", "speed_mps", "battery_wh", "wheel_radius_m", "max_grade_deg", "turn_j_per_rad"]))
    value = rng.choice(np.array([1e-306, 1e306, -1.0, 0.0, np.inf, np.nan]))
    body = json.dumps({"heightmap_id": "hm-none", "robot": {key: float(value)}})
    return Sent("robot out of range", COSTMAPS, body.encode())


@hostile
def robot_of_long_name(rng: Rng) -> Sent:
    name = str(rng.choice(["r" * 10**6, "\x00", "$\\frac{", "\ud800", "\x1b[2J", "\u202e" * 100]))
    return Sent(
        "robot with a strange name", COSTMAPS, json.dumps({"heightmap_id": "hm-none", "robot": {"name": name}}).encode()
    )


@hostile
def json_of_anything(rng: Rng) -> Sent:
    bodies = [
        b"{" + b",".join(b'"k%d":1' % k for k in range(600_000)) + b"}",
        b'{"start":' + b"[" * 100_000,
        b'{"path":[' + b"[0,0]," * 300_000 + b"[0,0]]}",
        b'{"start":[1' + b"0" * 10**6 + b",2]}",
        b'{"start":"' + b"\\u0000" * 10**6 + b'"}',
        b'{"robot":{' + b'"a":{' * 2_000 + b"}" * 2_002,
        b"[" + b"{}," * 10**6 + b"{}]",
        b'{"start":[NaN,Infinity],"goal":[-Infinity,1e999]}',
        b'{"start":[1,2],"goal":[3,4],"goal":[5,6],"seed":-1}',
        b"\xff\xfe{\0}\0",
    ]
    return Sent("JSON of anything", PATHS, bodies[int(rng.integers(len(bodies)))])
