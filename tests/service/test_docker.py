"""The Dockerfile without an engine: its steps are read, checked against the repository, and really run."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from joulemap.service.hosting.settings import Settings
from tests.service.clusters import compose_environment

REPOSITORY = Path(__file__).resolve().parents[2]
DOCKERFILE = REPOSITORY / "docker" / "Dockerfile"


@dataclass
class Image:
    """What a Dockerfile says. runs : (user, work folder, command); copies : (sources, target)."""

    base: str = ""
    user: str = "root"
    folder: str = "/"
    env: dict[str, str] = field(default_factory=dict)
    runs: list[tuple[str, str, str]] = field(default_factory=list)
    copies: list[tuple[list[str], str]] = field(default_factory=list)
    steps: list[tuple[str, ...]] = field(default_factory=list)  # both, in their order
    volumes: list[str] = field(default_factory=list)
    exposed: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)
    health: list[str] = field(default_factory=list)


def read_image(text: str) -> Image:
    """The instructions of a Dockerfile of one stage; one that is not known fails."""
    image = Image()
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        word, rest = line.split(None, 1)
        if word == "FROM":
            assert not image.base, "one stage is enough"
            image.base = rest
        elif word == "ENV":
            image.env |= dict(re.findall(r"(\w+)=(\S+)", rest))
        elif word == "RUN":
            image.runs.append((image.user, image.folder, rest))
            image.steps.append(("RUN", image.user, image.folder, rest))
        elif word == "COPY":
            *sources, target = rest.split()
            image.copies.append((sources, target))
            image.steps.append(("COPY", os.path.normpath(os.path.join(image.folder, target)), *sources))
        elif word == "USER":
            image.user = rest
        elif word == "WORKDIR":
            image.folder = rest
        elif word == "VOLUME":
            image.volumes += json.loads(rest)
        elif word == "EXPOSE":
            image.exposed += rest.split()
        elif word == "CMD":
            image.command = json.loads(rest)
        elif word == "HEALTHCHECK":
            image.health = json.loads(rest.split("CMD", 1)[1])
        else:
            assert word == "ARG", f"unknown instruction {word}"
    return image


@pytest.fixture(scope="module")
def image() -> Image:
    return read_image(DOCKERFILE.read_text())


def test_what_is_copied_is_there_and_enough(image: Image) -> None:
    copied = {source.removeprefix("./") for sources, _ in image.copies for source in sources}
    for source in copied:
        assert (REPOSITORY / source).exists(), source
    assert {"pyproject.toml", "README.md", "LICENSE", "joulemap", "model", "planner", "service"} <= copied
    for link in (path for path in (REPOSITORY / "joulemap").iterdir() if path.is_symlink()):
        assert link.resolve().name in copied, f"joulemap/{link.name} links to what is not copied"
    ignored = (REPOSITORY / ".dockerignore").read_text().split()
    assert not copied & set(ignored)
    assert {".git", ".venv", "data"} <= set(ignored)


def test_the_service_is_not_root_and_owns_what_it_writes(image: Image) -> None:
    assert image.user not in ("root", "0")
    made = next(command for user, _, command in image.runs if user == "root" and "useradd" in command)
    assert image.user in made
    owned = made.split(f"chown {image.user}:{image.user}")[1].split()
    assert image.env["JOULEMAP_DATA_DIR"] in image.volumes
    assert {image.env["JOULEMAP_DATA_DIR"], image.env["NUMBA_CACHE_DIR"]} <= set(owned)
    warmed = next(user for user, _, command in image.runs if "warmup" in command)
    assert warmed == image.user  # so that the service can read, and renew, what was compiled


def test_the_base_fits_the_package(image: Image) -> None:
    version = re.fullmatch(r"python:(\d+)\.(\d+)\.\d+-slim-bookworm", image.base)  # exact, and of one Debian
    assert version is not None
    needed = re.search(r'requires-python = ">=(\d+)\.(\d+)"', (REPOSITORY / "pyproject.toml").read_text())
    assert needed is not None
    assert tuple(map(int, version.groups())) >= tuple(map(int, needed.groups()))


def test_the_lock_has_all_that_the_package_and_its_extras_need_with_hashes(image: Image) -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    extras = ("server", "train", "tours", "logs", "clouds", "objects", "cluster", "geo")
    lines = (REPOSITORY / "docker" / "requirements.lock").read_text().replace("\\\n", " ").splitlines()
    locked = {}
    for line in (line for line in lines if not line.startswith("#")):
        requirement, *hashes = line.split("--hash=sha256:")
        assert hashes, line
        found = Requirement(requirement.strip())
        locked[canonicalize_name(found.name)] = str(found.specifier).removeprefix("==")
    torch = next(re.search(r"torch==(\S+)", command) for _, _, command in image.runs if "torch==" in command)
    assert torch is not None
    assert torch[1].endswith("+cpu")
    assert not [name for name in locked if "nvidia" in name or name == "torch"]
    for text in [
        *project["dependencies"],
        *(one for extra in extras for one in project["optional-dependencies"][extra]),
    ]:
        wanted = Requirement(text)
        version = torch[1] if wanted.name == "torch" else locked[canonicalize_name(wanted.name)]
        assert wanted.specifier.contains(version), f"{text}: {version} is locked"


def test_the_cluster_sets_what_there_is() -> None:
    compose = (REPOSITORY / "docker" / "compose.cluster.yaml").read_text()
    known = {f"JOULEMAP_{name.upper()}" for name in Settings.model_fields} | {"JOULEMAP_BIND"}
    assert set(re.findall(r"JOULEMAP_[A-Z_]+", compose)) <= known
    assert all(program in compose for program in ('"dask", "scheduler"', '"dask", "worker"'))


@pytest.mark.parametrize("program", ["scheduler", "worker"])
def test_dask_has_the_same_settings_in_the_compose_file_and_in_the_how_to(program: str) -> None:
    page = (REPOSITORY / "docs" / "how-to" / "my-cluster.md").read_text()
    lines = [line for line in page.splitlines() if line.startswith("export DASK_") or f"dask {program} " in line]
    said = dict(re.findall(r"([A-Z_]+)=(\S+)", " ".join(lines)))
    assert said.items() >= compose_environment(program).items()


def test_compose_starts_this_image(image: Image) -> None:
    compose = (REPOSITORY / "docker" / "compose.yaml").read_text()
    assert "dockerfile: docker/Dockerfile" in compose
    assert f':{image.exposed[0]}:{image.env["JOULEMAP_PORT"]}"' in compose
    assert f"data:{image.volumes[0]}\n" in compose


@pytest.mark.parametrize("name", ["compose.yaml", "compose.cluster.yaml"])
def test_the_root_is_read_only_and_nothing_more_is_allowed(image: Image, name: str) -> None:
    compose = (REPOSITORY / "docker" / name).read_text()
    for line in ("read_only: true", "cap_drop: [ALL]", '"no-new-privileges:true"', "- /tmp:", "stop_grace_period: 15s"):
        assert line in compose, line
    for volume in image.volumes:  # else nothing could be written there
        assert re.search(rf"- \w+:{volume}\b", compose), volume
    assert image.env["NUMBA_CACHE_DIR"] in image.volumes
    assert image.env["MPLCONFIGDIR"].startswith(image.env["NUMBA_CACHE_DIR"])


@pytest.mark.slow
def test_the_command_starts_and_its_health_check_tells_so(image: Image, tmp_path: Path) -> None:
    start_and_check(image, Path(sys.executable).parent, tmp_path, os.environ)


IMAGE_SCRIPT = """
set -e
mount --make-rprivate /
mount -t tmpfs -o size=12g tmpfs {base}
cd {base}
mkdir up work root volumes
mount -t overlay overlay -o lowerdir=/,upperdir={base}/up,workdir={base}/work {base}/root
mount -t proc proc root/proc
mount --rbind /dev root/dev
chmod a+rx root/root
for name in $(getent passwd 1000 | cut -d: -f1); do chroot root userdel $name; done
chroot root {python} -m venv /base
{environment}
export HOME=/root PATH=/base/bin:/usr/sbin:/usr/bin:/sbin:/bin
{steps}
chroot root /base/bin/python -m pip list --format=freeze > {report}/installed
for folder in {volumes}; do
    mkdir -p volumes$folder
    cp -a root$folder/. volumes$folder/
    chown --reference=root$folder volumes$folder
    mount --bind volumes$folder root$folder
done
mount -t tmpfs -o mode=1777 tmpfs root/tmp
mount -o remount,ro root
! chroot root touch /app/x 2> /dev/null
export JOULEMAP_PORT={port} HOME=/home/{user}
cd root{folder}
chroot --userspec={user}:{user} {base}/root bash -c 'cd {folder} && exec {command}' > {report}/log 2>&1 &
pid=$!
for attempt in $(seq 600); do
    if chroot --userspec={user}:{user} {base}/root {health}; then break; fi
    kill -0 $pid
    sleep 0.5
done 2> /dev/null
chroot --userspec={user}:{user} {base}/root {health}
chroot {base}/root find / -xdev -newer {report}/installed -type f > {report}/written || true
kill -TERM $pid
wait $pid || test $? = 143
test -f {base}/root/data/joulemap.db
echo done > {report}/done
"""


def can_be_root() -> bool:
    """Whether this process may mount, so that the steps can be done as they are written, in a copy of this machine."""
    probe = ["unshare", "-m", "bash", "-c", "mount --make-rprivate / && mount -t tmpfs tmpfs /mnt"]
    return shutil.which("unshare") is not None and subprocess.run(probe, capture_output=True).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not can_be_root(), reason="no right to mount")
def test_every_step_as_it_is_written_and_a_start_on_a_read_only_root(image: Image, tmp_path: Path) -> None:
    """COPY and RUN in a copy-on-write view of this machine, with the paths and users of the Dockerfile; then CMD as
    `compose.yaml` starts it: not root, nothing writable but the volumes and /tmp. Only apt-get is left out.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    base = Path(tempfile.mkdtemp(prefix="joulemap-image-", dir="/tmp"))
    steps = []
    for kind, *rest in image.steps:
        if kind == "COPY":
            target, *sources = rest
            steps += [f"mkdir -p root{target}"]
            steps += [
                f"cp -a {REPOSITORY / source}{'/.' if (REPOSITORY / source).is_dir() else ''} root{target}"
                for source in sources
            ]
            continue
        user, folder, command = rest
        if command.startswith("apt-get"):
            continue
        steps += [f"mkdir -p root{folder}"]
        home = "/root" if user == "root" else f"/home/{user}"
        line = f"cd {folder} && {command}".replace("'", "'\\''")
        steps += [f"HOME={home} chroot --userspec={user}:{user} root bash -e -c '{line}'"]
    kept = {key: value for key, value in os.environ.items() if key.startswith(("PIP_", "SSL_", "HTTP", "NO_PROXY"))}
    script = IMAGE_SCRIPT.format(
        base=base,
        python=Path(sys.executable).resolve(),
        environment="\n".join(f"export {key}={shlex.quote(value)}" for key, value in (kept | image.env).items()),
        steps="\n".join(steps),
        volumes=" ".join(image.volumes),
        report=tmp_path,
        port=port,
        user=image.user,
        folder=image.folder,
        command=shlex.join(image.command),
        health=shlex.join(image.health),
    )
    ran = subprocess.run(["unshare", "-m", "bash", "-c", script], capture_output=True, text=True, timeout=2400)
    base.rmdir()
    log = (tmp_path / "log").read_text() if (tmp_path / "log").exists() else ""
    assert ran.returncode == 0, f"{ran.stdout[-3000:]}\n{ran.stderr[-3000:]}\n{log[-3000:]}"
    assert (tmp_path / "done").exists()
    installed = {
        line.partition("==")[0].lower().replace("_", "-") for line in (tmp_path / "installed").read_text().splitlines()
    }
    assert {"joulemap", "fastapi", "torch"} <= installed
    assert not {"scikit-learn", "pytest", "mkdocs", "ruff", "statsmodels"} & installed, "only what the service needs"
    assert (tmp_path / "written").read_text() == "", "written outside of the volumes"


def start_and_check(image: Image, programs: Path, data: Path, environment: Mapping[str, str]) -> None:
    """Run CMD until HEALTHCHECK passes, then stop it as an engine does: SIGTERM, and a clean end."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    env = dict(environment) | {key: value for key, value in image.env.items() if key.startswith("JOULEMAP_")}
    env |= {"PATH": f"{programs}:{env['PATH']}", "JOULEMAP_DATA_DIR": str(data / "kept"), "JOULEMAP_PORT": port}
    log = data / "service.log"
    with log.open("wb") as sink:
        process = subprocess.Popen(image.command, cwd=data, env=env, stdout=sink, stderr=sink)
    try:
        assert subprocess.run(image.health, env=env, capture_output=True).returncode != 0  # not before it is up
        deadline = time.monotonic() + 120.0
        while subprocess.run(image.health, env=env, capture_output=True).returncode != 0:
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.5)
        assert (data / "kept" / "joulemap.db").is_file()
    finally:
        process.send_signal(signal.SIGTERM)
        ended = process.wait(30.0)
    assert ended in (0, -signal.SIGTERM), log.read_text()
