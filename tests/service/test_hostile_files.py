"""Files and numbers that are sent to stop the service: each is refused in words, soon, and nothing of it stays."""

from __future__ import annotations

import os
import signal
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import anyio
import httpx
import numpy as np
import psutil
import pytest
import rasterio
from fastapi.testclient import TestClient
from rasterio.transform import from_origin

from joulemap.model.errors import BusyError, TooLargeError
from joulemap.service.http.app import create_app, openapi_document
from joulemap.service.intake.limits import ReadLimits, RunReading
from joulemap.service.intake.readers import Readers
from tests.fuzz.bombs import BOMBS
from tests.fuzz.files import MAPS, PATHS, RUNS, parquet, plain_tiff
from tests.fuzz.reading import fuzz_reader
from tests.fuzz.sending import send_files
from tests.service.conftest import GOAL, START, settings_for
from tests.service.test_bad_input import check_problem, left_in, npy
from tests.service.test_calibrations import run_csv
from tests.service.test_contract import served

_TABLE = {"rows": 10**6, "columns": 2_000, "cells": 2 * 10**7, "text_mb": 200.0}
LIMITS = {"mb": 64.0, "km": 200.0, "table": _TABLE}
ROWS = b"t,x,y,voltage,current\n" + b"".join(b"%.1f,%.2f,0,24,2\n" % (0.1 * k, 0.05 * k) for k in range(400))


def long_text() -> bytes:
    import pyarrow as pa

    words = pa.DictionaryArray.from_arrays(pa.array([0] * 500_000), pa.array(["w" * 10_000]))
    return parquet({"t": [0.0] * 500_000, "note": words})


def npy_zeros() -> bytes:
    import numpy as np

    return npy(np.zeros((5, 5)))


def npy_of_long_numbers() -> bytes:
    return npy_zeros().replace(b"(5, 5)", b"(%s, %s)" % (b"9" * 20, b"9" * 20))


def latitude_999() -> str:
    return (
        'PROJCS["x",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",999],'
        'PARAMETER["central_meridian",-3],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],'
        'PARAMETER["false_northing",0],UNIT["metre",1]]'
    )


ATTACKS: list[tuple[str, Any, dict, int, str, str]] = [
    (
        RUNS,
        lambda: b",".join(b"c%d" % k for k in range(200_000)),
        {},
        413,
        "too_large",
        "200,000 columns, the limit is 2,000",
    ),
    (RUNS, lambda: b"a" * 2_000_000, {}, 413, "too_large", "first line has 2,000,000 bytes, the limit is 1,000,000"),
    (RUNS, lambda: b"#" * 2_000_000, {}, 413, "too_large", "first line has 2,000,000 bytes, the limit is 1,000,000"),
    (RUNS, lambda: b"t,x,t\n" + b"1,2,3\n2,3,5\n" * 4, {}, 422, "invalid_runs", "which of t, t (2) is its t?"),
    (RUNS, lambda: b"t,x\r1,2" + b"\r" * 1_500_000, {}, 413, "too_large", "1,500,000 rows, the limit is 1,000,000"),
    (
        RUNS,
        lambda: b"t,x\n" + b"," * 1_900_000,
        {},
        422,
        "invalid_runs",
        "1 rows are too few",
    ),
    (RUNS, long_text, {}, 413, "too_large", "texts of up to 10,000 letters"),
    (RUNS, lambda: parquet({"t": [1.0], "a": [[1.0]]}), {}, 422, "invalid_runs", "1 rows are too few"),
    (MAPS, lambda: plain_tiff(1, 90_000_000), {}, 413, "too_large", "limit of 1000000"),
    (MAPS, lambda: plain_tiff(1, 900_000), {}, 422, "invalid_heightmap", "at least 2 x 2 cells"),
    (MAPS, lambda: plain_tiff(900, 900), {}, 422, "invalid_heightmap", ""),
    (MAPS, lambda: npy_of_long_numbers(), {"resolution_m": 1}, 413, "too_large", "limit of 1000000"),
    (MAPS, lambda: npy_zeros(), {"resolution_m": 1, "crs": latitude_999()}, 422, "invalid_heightmap", "cannot be used"),
    (
        MAPS,
        lambda: npy_zeros(),
        {"resolution_m": 1, "crs": "BOUNDCRS[" + "A[" * 900},
        422,
        "invalid_heightmap",
        "not known",
    ),
    (MAPS, lambda: npy_zeros(), {"resolution_m": 1, "name": "a\x00b"}, 422, "invalid_request", "name"),
]


@pytest.mark.parametrize(("to", "content", "params", "status", "code", "words"), ATTACKS)
def test_known_attacks_are_refused(
    client: TestClient, to: str, content: Any, params: dict, status: int, code: str, words: str
) -> None:
    check_problem(client.post(to, content=content(), params=params), status, code, words)
    assert left_in(Path(client.app.state.service.store._dir)) == []  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"{" + b",".join(b'"k%d":1' % k for k in range(300_000)) + b"}", "more than 60,000 names of fields"),
        (b'{"path":[' + b"[0,0]," * 200_000 + b"[0,0]]}", "more than 110,000 lists"),
        (b'{"path":[' + b"0," * 2_000_000 + b"0]}", "more than 500,000 values"),
    ],
)
def test_bodies_are_counted_before_they_are_parsed(client: TestClient, body: bytes, words: str) -> None:
    answer = client.post(PATHS.format("cm-x"), content=body, headers={"Content-Type": "application/json"})
    assert check_problem(answer, 413, "too_large", words)["context"]["limit"] > 0


def test_many_unknown_fields_are_one_finding(client: TestClient) -> None:
    body = {"start": START, "goal": GOAL} | {f"k{k}": 1 for k in range(1_500)}
    problem = check_problem(client.post(PATHS.format("cm-x"), json=body), 422, "invalid_request", "1502 fields")
    assert len(problem["context"]["errors"]) == 1


def test_every_number_of_a_request_has_bounds() -> None:
    """Of the schemas of requests, and of the parameters in paths and queries."""
    document = openapi_document()
    schemas = document["components"]["schemas"]
    seen: list[str] = []

    def _walk(schema: dict[str, Any], place: str) -> None:
        if "$ref" in schema:
            name = schema["$ref"].rsplit("/", 1)[1]
            if name not in seen:
                seen.append(name)
                _walk(schemas[name], name)
            return
        kinds = schema.get("type", [])
        if {"number", "integer"} & set([kinds] if isinstance(kinds, str) else kinds) and "enum" not in schema:
            low = schema.get("minimum", schema.get("exclusiveMinimum"))
            high = schema.get("maximum", schema.get("exclusiveMaximum"))
            assert low is not None, place
            assert high is not None, place
        if "string" in kinds and not {"enum", "const", "format"} & set(schema):
            assert "maxLength" in schema or place.endswith("options"), place
        for key in ("items", "additionalProperties"):
            if isinstance(schema.get(key), dict):
                _walk(schema[key], f"{place}.{key}")
        for key in ("anyOf", "oneOf", "allOf", "prefixItems"):
            for one in schema.get(key, ()):
                _walk(one, place)
        for key, one in schema.get("properties", {}).items():
            _walk(one, f"{place}.{key}")

    for path, methods in document["paths"].items():
        for operation in methods.values():
            for parameter in operation.get("parameters", ()):
                if parameter["in"] == "query":
                    _walk(parameter["schema"], f"{path} {parameter['name']}")
            for kind, content in operation.get("requestBody", {}).get("content", {}).items():
                if kind in ("application/json", "multipart/form-data"):
                    _walk(content["schema"], path)
    assert {"CostmapRequest", "RobotIn", "BatteryIn", "PathRequest", "CalibrationRequest"} <= set(seen)


def templates() -> set[psutil.Process]:
    """The processes whose forks read."""
    return {one for one in psutil.Process().children() if "intake.template" in " ".join(one.cmdline())}


def forks() -> set[psutil.Process]:
    return {fork for one in templates() for fork in one.children()}


@pytest.mark.parametrize("reproject", [pytest.param(None, marks=pytest.mark.slow), "auto"])
def test_blocks_of_a_map_that_need_more_memory_are_no_corrupt_file(tmp_path: Path, reproject: str | None) -> None:
    place = tmp_path / "one_block.tif"
    rows = 5_000
    frame = {"crs": "EPSG:32630", "transform": from_origin(367_000, 4_064_000, 1, 1)}
    shape = {"width": rows, "height": rows, "count": 1, "dtype": "float64", "blockysize": rows, "compress": "deflate"}
    with rasterio.open(place, "w", driver="GTiff", **frame, **shape) as dataset:
        dataset.write(np.ones((rows, rows)), 1)

    async def _main() -> None:
        how = {"max_cells": rows * rows, "options": {"reproject": reproject}}
        with (
            closing(Readers(processes=1, queue=1, limits=ReadLimits(30, 250))) as narrow,
            pytest.raises(TooLargeError, match="memory"),
        ):
            await narrow.read("heightmap", path=str(place), name=place.name, out=str(tmp_path / "o.tif"), **how)

    anyio.run(_main)


READING = RunReading().as_dict()


def test_a_process_that_takes_too_long_or_too_much_is_ended(tmp_path: Path) -> None:
    place = tmp_path / "run.csv"
    place.write_bytes(ROWS)

    async def _main() -> None:
        with (
            closing(Readers(processes=1, queue=1, limits=ReadLimits(0.001, 750))) as hurried,
            pytest.raises(TooLargeError, match=r"could not be read within 0\.001 s"),
        ):
            await hurried.read("run", path="/dev/zero", name="endless", limits_of_run=LIMITS, reading=READING)
        with closing(Readers(processes=1, queue=1, limits=ReadLimits(5, 200))) as narrow:
            with pytest.raises(TooLargeError, match="more than 200 MB of memory"):
                await narrow.read("run", path="/dev/zero", name="endless", limits_of_run=LIMITS, reading=READING)
            assert (await narrow.read("run", path=str(place), name="run.csv", limits_of_run=LIMITS, reading=READING))[
                "rows"
            ] == 400
        with closing(Readers(processes=1, queue=1, limits=ReadLimits(30, 10_000))) as roomy:
            seen: set[psutil.Process] = set()
            with anyio.move_on_after(60) as scope:
                async with anyio.create_task_group() as group:

                    async def _until_it_reads() -> None:
                        while not seen:
                            await anyio.sleep(0.02)
                            seen.update(forks())
                        await anyio.sleep(0.2)
                        scope.cancel()

                    group.start_soon(_until_it_reads)
                    await roomy.read("run", path="/dev/zero", name="endless", limits_of_run=LIMITS, reading=READING)
            assert scope.cancelled_caught
            await anyio.sleep(0.5)
            assert seen
            assert not any(fork.is_running() for fork in seen)

    anyio.run(_main)


def test_a_full_queue_is_told(tmp_path: Path) -> None:
    place = tmp_path / "run.csv"
    place.write_bytes(ROWS)
    found: list[Any] = []

    async def _main() -> None:
        async def _one() -> None:
            try:
                found.append(
                    await readers.read("run", path=str(place), name="run.csv", limits_of_run=LIMITS, reading=READING)
                )
            except BusyError as error:
                found.append(error)

        with closing(Readers(processes=1, queue=2, limits=ReadLimits(5, 750))) as readers:
            async with anyio.create_task_group() as group:
                for _ in range(5):
                    group.start_soon(_one)

    anyio.run(_main)
    refused = [one for one in found if isinstance(one, BusyError)]
    assert (len(found), len(refused)) == (5, 2)
    assert refused[0].context["retry_after_s"] > 0


def test_the_slot_of_a_client_that_hangs_up_is_free(tmp_path: Path) -> None:
    """The client leaves while its run is read; the next one is read by a new process."""
    long = run_csv(0).splitlines(keepends=True)
    rows = b"".join(long[1:])
    content = long[0] + rows * 300
    app = create_app(settings_for(tmp_path, read_processes=1))
    with served(app) as url:
        assert httpx.post(f"{url}/v1/runs", content=run_csv(0), timeout=200).status_code == 201
        with pytest.raises(httpx.ReadTimeout):
            httpx.post(f"{url}/v1/runs", content=content, timeout=0.5)
        for _ in range(100):
            if app.state.service.readers.running == 0 and not forks():
                break
            time.sleep(0.1)
        assert app.state.service.readers.running == 0
        assert forks() == set()
        assert httpx.post(f"{url}/v1/runs", content=run_csv(1), timeout=200).status_code == 201
    assert left_in(tmp_path) == []


def test_a_template_that_is_killed_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_template: Any
) -> None:
    monkeypatch.setattr(Readers, "_current", own_template)
    others = templates()
    with TestClient(create_app(settings_for(tmp_path)), raise_server_exceptions=False) as client:
        for _ in range(2):
            assert client.post("/v1/runs", content=run_csv(0)).status_code == 201
            for template in templates() - others:
                os.kill(template.pid, signal.SIGKILL)
    assert templates() <= others


def test_hostile_files_of_each_kind_are_answered(tmp_path: Path) -> None:
    sent = send_files(8, seed=3, folder=tmp_path)
    assert sent.failures == []


@pytest.mark.parametrize("reader", ["geotiff", "npz", "csv", "parquet", "path"])
def test_generated_inputs_are_read_or_refused(reader: str) -> None:
    assert fuzz_reader(reader, 50, seed=11).failures == []


@pytest.mark.slow
def test_fifty_logs_that_are_huge_inside_or_endless(tmp_path: Path) -> None:
    assert send_files(50, seed=0, folder=tmp_path, makers=BOMBS).failures == []


@pytest.mark.slow
def test_two_hundred_hostile_files(tmp_path: Path) -> None:
    assert send_files(200, seed=0, folder=tmp_path).failures == []
