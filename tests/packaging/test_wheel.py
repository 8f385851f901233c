"""The wheel and the sdist: one name in site-packages, real files, and nothing that a user's own modules could break."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parents[2]
HOSTILE = "raise RuntimeError(\"a user's own module was imported instead of joulemap's\")\n"
TOUR = """
import sys
import numpy as np
import joulemap as jm
assert not {"torch", "ompl", "numba", "fastapi"} & set(sys.modules), "import joulemap loads too much"
row, col = np.mgrid[0:16, 0:24]
hill = jm.heightmap(np.exp(-((row - 8) ** 2 + (col - 12) ** 2) / 30.0), resolution_m=0.5)
costmap = jm.costmap(hill, robot={"mass_kg": 50}, model="physics", headings=8)
route = costmap.plan((2.0, 4.0), (10.0, 4.0))
print(route)
assert costmap.feasibility(route, charge=0.6)
print(jm.__file__)
"""


CORE = """
import sys
from importlib import abc

class Missing(abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

BLOCKED = set(sys.argv[2:])
sys.meta_path.insert(0, Missing())
import numpy as np
import joulemap as jm
from typer.testing import CliRunner
from joulemap.service.cli import app

hill = jm.heightmap(np.tile(np.linspace(0.0, 3.0, 60), (40, 1)), resolution_m=0.5)
jm.costmap(hill).save(sys.argv[1] + "/hill.zarr")
for command in (
    ["path", sys.argv[1] + "/hill.zarr", "--start", "3,10", "--goal", "27,10"], ["serve"], ["doctor"]
):
    done = CliRunner().invoke(app, command)
    print(done.exit_code, done.stdout, done.stderr)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist of the files that git would take, and the wheel that is built from the sdist."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
    )
    source = tmp_path_factory.mktemp("source")
    for name in listed.stdout.splitlines():
        origin = REPOSITORY / name
        if not name.startswith(("tests/", "docs/")) and (origin.is_file() or origin.is_symlink()):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(origin, source / name, follow_symlinks=False)
    out = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(source)],
        capture_output=True,
        check=True,
    )
    return out


@pytest.fixture(scope="module")
def site(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the wheel is installed into."""
    target = tmp_path_factory.mktemp("site")
    (wheel,) = built.glob("*.whl")
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(target), str(wheel)],
        capture_output=True,
        check=True,
    )
    return target


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A robot workspace with modules of the same names as joulemap's folders."""
    (tmp_path / "planner").mkdir()
    for name in ("model.py", "planner/__init__.py", "service.py"):
        (tmp_path / name).write_text(HOSTILE)
    return tmp_path


def run(site: Path, hostile: Path, *arguments: str, **more: str) -> str:
    """What a Python of the installed wheel prints in the hostile folder."""
    environment = os.environ | {"PYTHONPATH": f"{hostile}:{site}", "MPLBACKEND": "agg"} | more
    done = subprocess.run([sys.executable, *arguments], cwd=hostile, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_puts_one_name_into_site_packages(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert {name.split("/")[0].split("-")[0] for name in names} == {"joulemap"}
        frames = archive.read("joulemap/model/frames.py")
    assert frames == (REPOSITORY / "model" / "frames.py").read_bytes()
    assert {"joulemap/py.typed", "joulemap/model/weights/weights.safetensors", "joulemap/service/cli.py"} <= set(names)
    modules = {p.relative_to(REPOSITORY) for room in ("model", "planner", "service") for p in room_files(room)}
    assert {f"joulemap/{module}" for module in modules} <= set(names)


def room_files(room: str) -> list[Path]:
    return list((REPOSITORY / room).rglob("*.py"))


def test_the_sdist_holds_files_and_no_links(built: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        members = {member.name.split("/", 1)[-1]: member for member in archive.getmembers()}
    assert members["joulemap/planner/route_planner.py"].isreg()
    assert not [name for name, member in members.items() if member.issym()]


@pytest.mark.slow
@pytest.mark.parametrize("interpreted", ["1", "0"])
def test_a_users_own_modules_change_nothing(site: Path, hostile: Path, interpreted: str) -> None:
    """To compile all kernels anew takes 40 s, and proves nothing of the wheel."""
    assert str(site) in run(site, hostile, "-c", TOUR, NUMBA_DISABLE_JIT=interpreted)
    words = run(site, hostile, "-m", "joulemap.service.cli", "--help")
    assert "costmap" in words


def test_the_core_needs_no_extra(tmp_path: Path) -> None:
    """The shipped network and a path without all that only extras bring, and what a command says that needs one."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    extras = [line for extra in ("server", "train") for line in project["optional-dependencies"][extra]]
    names = {canonicalize_name(Requirement(line).name) for line in extras}
    blocked = [
        module for module, of in packages_distributions().items() if {canonicalize_name(one) for one in of} <= names
    ]
    assert {"torch", "dask", "fastapi", "sqlalchemy"} <= set(blocked)
    command = [sys.executable, "-c", CORE, str(tmp_path), *blocked]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "0 Path for" in done.stdout
    assert re.search(r"^3 .*pip install 'joulemap\[server\]'", done.stdout, re.M | re.S)
    assert "0 good    joulemap" in done.stdout


def test_no_module_has_a_second_name(hostile: Path) -> None:
    """In a checkout `model` would be importable too: it refuses."""
    for room in ("model", "planner", "service"):
        done = subprocess.run([sys.executable, "-c", f"import {room}"], cwd=REPOSITORY, capture_output=True, text=True)
        assert done.returncode != 0
        assert f"import joulemap.{room}" in done.stderr


@pytest.mark.slow
def test_in_a_clean_environment(built: Path, hostile: Path, tmp_path: Path) -> None:
    """Installed with its dependencies alone: the command line and the Python tour; with `server` the demo."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
    (wheel,) = built.glob("*.whl")
    python = venv / "bin" / "python"
    hostile_too = {"PYTHONPATH": str(hostile), "MPLBACKEND": "agg"}
    for extra, command in (
        ("", [str(python), "-c", TOUR]),
        ("", [str(venv / "bin" / "joulemap"), "--help"]),
        ("[server]", [str(venv / "bin" / "joulemap"), "demo", "--exit", "--out", "shown"]),
    ):
        subprocess.run([str(python), "-m", "pip", "install", "-q", f"{wheel}{extra}"], env=environment, check=True)
        done = subprocess.run(command, cwd=hostile, env=environment | hostile_too, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert (hostile / "shown" / "joulemap-demo.png").is_file()
    shutil.rmtree(venv)  # more than a gigabyte that pytest would keep
