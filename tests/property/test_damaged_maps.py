"""A slice of `python -m tests.fuzz.damages`: a damaged cost map or model is an error, or answers as before."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from joulemap.model.errors import DamagedError
from joulemap.planner.lattice.loading import load_lattice
from tests.fuzz.damages import KINDS, answers, make_map, make_older


@pytest.mark.parametrize("kind", ["map", pytest.param("older-map", marks=pytest.mark.slow), "network", "calibrated"])
def test_no_damage_gives_another_number(tmp_path, kind) -> None:
    found = KINDS[kind](25, 5, tmp_path)
    assert found.others == []
    assert found.outcomes["error"] >= 10, found.line()


@pytest.fixture(scope="module")
def older(tmp_path_factory):
    """A map of the version before, never opened since."""
    folder = tmp_path_factory.mktemp("older") / "map.zarr"
    make_map(folder)
    shutil.rmtree(folder / "coarse-32")
    make_older(folder)
    return folder


@pytest.mark.parametrize(
    ("lost", "words"),
    [
        ("traction_per_m/c/1/1/0", "traction_per_m/c/1/1/0: it is missing"),
        ("elevation_m/c/2/0", "elevation_m/c/2/0: it is missing"),
        ("gradient/c/0/1/0", "gradient/c/0/1/0: it is missing"),
        ("blocked/c/1/2", "blocked/c/1/2: it is missing"),
        ("std_j/c/1/0/0", "std_j/c/1/0/0: it is missing"),
        ("std_j/zarr.json", "std_j/zarr.json: it is missing"),
        ("x/c/0", "x: the coordinates"),
    ],
)
def test_what_an_older_map_lost_before_it_was_opened_is_missed(older, tmp_path, lost, words) -> None:
    shutil.copytree(older, tmp_path / "a.zarr")
    (tmp_path / "a.zarr" / lost).unlink()
    with pytest.raises(DamagedError, match=words):
        load_lattice(tmp_path / "a.zarr")
    assert not (tmp_path / "a.zarr" / "checksums").exists()


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("zarr.json", b'"resolution_m": 1.0', b'"resolution_m": 3.0', "x: the coordinates"),
        ("zarr.json", b'"attributes"', b'"attribu\xf4es"', "zarr.json: "),
        (
            "gradient/zarr.json",
            b'"little"',
            b'"bittle"',
            "gradient/zarr.json: it is not what zarr.json says",
        ),
    ],
)
def test_metadata_of_an_older_map_has_to_fit_together(older, tmp_path, file, old, new, words) -> None:
    place = tmp_path / "a.zarr"
    shutil.copytree(older, place)
    content = (place / file).read_bytes()
    assert old in content
    (place / file).write_bytes(content.replace(old, new, 1))
    with pytest.raises(DamagedError, match=words):
        load_lattice(place)


def test_an_older_map_is_read_and_has_checksums_from_then(older, tmp_path) -> None:
    shutil.copytree(older, tmp_path / "a.zarr")
    make_map(tmp_path / "new.zarr")
    assert answers(tmp_path / "a.zarr") == answers(tmp_path / "new.zarr")
    assert (tmp_path / "a.zarr" / "checksums").is_file()


def test_a_folder_that_cannot_be_written_is_read(older, tmp_path, monkeypatch) -> None:
    shutil.copytree(older, tmp_path / "a.zarr")

    def _read_only(*_):
        raise PermissionError("read-only")

    monkeypatch.setattr("joulemap.planner.lattice.checksums.Checksums.write", _read_only)
    assert np.isfinite(load_lattice(tmp_path / "a.zarr").traction_per_m).any()
    assert not (tmp_path / "a.zarr" / "checksums").exists()


def test_a_new_map_without_its_checksums_is_damaged(older, tmp_path) -> None:
    make_map(tmp_path / "new.zarr")
    (tmp_path / "new.zarr" / "checksums").unlink()
    with pytest.raises(DamagedError, match=r"new\.zarr/checksums: it is missing"):
        load_lattice(tmp_path / "new.zarr")
