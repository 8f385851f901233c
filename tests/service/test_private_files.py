"""Other accounts of the machine read nothing of a data directory, a backup or the hashes of keys."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from joulemap.service.cli import app
from tests.service.test_restart import serving


def joulemap(*words: object, umask: int = 0o022) -> None:
    """A command of a user who, by default, lets everybody read."""
    before = os.umask(umask)
    try:
        done = CliRunner().invoke(app, [*map(str, words)])
    finally:
        os.umask(before)
    assert done.exit_code == 0, done.output


def open_to_others(folder: Path) -> list[str]:
    return [str(path) for path in (folder, *folder.rglob("*")) if path.stat().st_mode & 0o077]


def test_what_a_service_makes_is_for_its_account_alone(tmp_path: Path, hill_tif: bytes) -> None:
    folder = tmp_path / "data"
    with serving(folder, place="/readyz", umask=0o022, log=tmp_path / "log") as (_, http):
        heightmap = http.post("/v1/heightmaps", content=hill_tif).json()["id"]
        asked = {"heightmap_id": heightmap, "model": "physics"}
        made = http.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=120"})
        assert made.status_code == 201, made.text
        joulemap("keys", "add", "anna", "--data-dir", folder)
        assert len(list(folder.rglob("*"))) > 20
        assert open_to_others(folder) == []
    joulemap("backup", tmp_path / "monday", "--data-dir", folder)
    joulemap("restore", tmp_path / "monday", "--data-dir", tmp_path / "again")
    assert open_to_others(folder) + open_to_others(tmp_path / "monday") + open_to_others(tmp_path / "again") == []
    assert "open to other accounts" not in (tmp_path / "log").read_text()


def test_an_older_data_directory_is_closed_where_the_keys_are_and_the_rest_is_said(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    joulemap("keys", "add", "anna", "--data-dir", folder)
    folder.chmod(0o755)
    (folder / "joulemap.db").chmod(0o644)
    with serving(folder, umask=0o022, log=tmp_path / "log"):
        modes = {path.name: path.stat().st_mode & 0o777 for path in folder.glob("joulemap.db*")}
    assert set(modes.values()) == {0o600}, modes
    said = (tmp_path / "log").read_text()
    assert "joulemap.db was open to other accounts (mode 0644)" in said
    assert f"{folder} is open to other accounts (mode 0755): chmod -R go-rwx {folder}" in said


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_files_that_a_user_names_keep_the_users_own_mode(tmp_path: Path, umask: int) -> None:
    joulemap("keys", "list", "--data-dir", tmp_path / "data", "--json", tmp_path / "keys.json", umask=umask)
    assert json.loads((tmp_path / "keys.json").read_text()) == {"keys": []}
    assert (tmp_path / "keys.json").stat().st_mode & 0o777 == 0o666 & ~umask
    assert (tmp_path / "data").stat().st_mode & 0o777 == 0o700
