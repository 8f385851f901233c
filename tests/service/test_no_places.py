"""No answer of a service says where on its machine files are, whatever is sent and whatever is missing there."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from joulemap.model.errors import HeightmapError, InputError
from joulemap.service.http.app import create_app
from joulemap.service.problems import problem_of
from tests.service.conftest import settings_for

_PLANAR_CONFIGURATION = 284


def with_tag(tiff: bytes, tag: int, value: int) -> bytes:
    """Return a GeoTIFF of another value in one of the short tags of its first directory."""
    out, (begin,) = bytearray(tiff), struct.unpack_from("<I", tiff, 4)
    (count,) = struct.unpack_from("<H", tiff, begin)
    for at in range(begin + 2, begin + 2 + 12 * count, 12):
        if struct.unpack_from("<H", tiff, at)[0] == tag:
            struct.pack_into("<H", out, at + 8, value)
            return bytes(out)
    raise AssertionError(f"the file has no tag {tag}")


@pytest.mark.parametrize("tag", [_PLANAR_CONFIGURATION, 258, 259, 277, 339])
@pytest.mark.parametrize("value", [0, 9, 60_000])
def test_broken_tags(
    client: TestClient, tmp_path_factory: pytest.TempPathFactory, hill_tif: bytes, tag: int, value: int
) -> None:
    sent = with_tag(hill_tif, tag, value)
    answer = client.post("/v1/heightmaps", files={"file": ("hill.tif", sent)})
    if answer.is_success:
        return
    _check(answer.text, client)


def test_a_missing_folder(tmp_path: Path, hill_tif: bytes) -> None:
    app = create_app(settings_for(tmp_path / "data"))
    with TestClient(app, raise_server_exceptions=False) as client:
        kept = client.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif)}).json()["id"]
        for folder in ("uploads", "heightmaps"):
            shutil.rmtree(tmp_path / "data" / folder)
        for answer in (
            client.post("/v1/heightmaps", files={"file": ("hill.tif", hill_tif + b"\0")}),
            client.get(f"/v1/heightmaps/{kept}/file"),
            client.get(f"/v1/heightmaps/{kept}/preview.png"),
            client.post("/v1/costmaps", json={"heightmap_id": kept, "model": "physics"}, headers={"Prefer": "wait=60"}),
            client.get("/readyz"),
        ):
            assert str(tmp_path) not in answer.text


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("there is no file /tmp/joulemap-x/a b.tif", "there is no file a b.tif"),
        ("cannot open '/tmp/joulemap-x/hill.tif': bad", "cannot open 'hill.tif': bad"),
        ("/vsimem/0f/hill.tif, band 1", "hill.tif, band 1"),
        ("ask /v1/costmaps/7/path, or 3 m/s, or 1/2", "ask /v1/costmaps/7/path, or 3 m/s, or 1/2"),
        ("see https://example.org/tmp/page", "see https://example.org/tmp/page"),
    ],
)
def test_what_is_left_of_a_message(said: str, shown: str) -> None:
    error = HeightmapError(said, path=said, more=[{"place": said}])
    body = problem_of(error)
    assert body["detail"] == body["context"]["path"] == body["context"]["more"][0]["place"] == shown


def test_whatever_is_raised() -> None:
    assert "/usr" not in json.dumps(problem_of(InputError("no", path=Path("/usr/lib/x"))))


def _check(text: str, client: TestClient) -> None:
    data = Path(client.app.state.service.settings.data_dir)  # type: ignore[attr-defined]
    for place in (str(data), str(data.resolve()), "/tmp/", "/vsimem"):
        assert place not in text
