"""Every code block of the documentation runs, page by page, in an empty folder; the few that cannot say why."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import matplotlib
import matplotlib.pyplot as plt
import pytest

from tests.docs.code_blocks import DATA, ROOT, RUN, Machine, blocks_of, own_test, pages

BLOCKS = {page: blocks_of(page) for page in pages()}
RUNNABLE = [page for page, blocks in BLOCKS.items() if any(b.language in RUN and b.mark != "not run" for b in blocks)]
SLOW = [page for page in RUNNABLE if any(b.mark == "slow" for b in BLOCKS[page])]
LONG = (
    "docs/how-to/my-service.md",
    "docs/how-to/my-robot-in-the-loop.md",
    "docs/how-to/my-mission.md",
    "docs/how-to/will-it-make-it.md",
    "docs/how-to/my-logs.md",
    "docs/how-to/while-driving.md",
    "docs/how-to/reach.md",
    "docs/how-to/my-ground.md",
)
"""Pages that `make test-slow` runs."""
NOT_RUN = 20
"""As many blocks as may be left out, at most: each needs what a test has not (Docker, a cluster, the installation)."""

PRINTED = {"docs/tutorial.md": "Found: turning\n"}
"""What a page says that its blocks print."""


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service of its own on a free port: "127.0.0.1:PORT"."""
    if shutil.which("curl") is None:
        pytest.skip("curl is needed to run the examples of HTTP")
    folder = tmp_path_factory.mktemp("service")
    with (folder / "log").open("wb") as log:
        command = [
            sys.executable,
            "-m",
            "joulemap.service.cli",
            "serve",
            "--port",
            "0",
            "--data-dir",
            str(folder / "data"),
        ]
        process = subprocess.Popen(command, stdout=log, stderr=log)
    try:
        yield _address(process, folder / "log")
    finally:
        process.terminate()
        process.wait(30.0)


def _address(process: subprocess.Popen[bytes], log: Path) -> str:
    """Where the service listens, once it is ready."""
    deadline = time.monotonic() + 180.0
    while time.monotonic() < deadline and process.poll() is None:
        words = log.read_text(errors="replace")
        if "running on http://" in words:
            address = words.partition("running on http://")[2].split()[0]
            if httpx.get(f"http://{address}/readyz").is_success:
                return address
        time.sleep(0.2)
    raise AssertionError(f"the service did not get ready: {log.read_text(errors='replace')[-2000:]}")


def _run(page: str, folder: Path, request: pytest.FixtureRequest, *, slow: bool) -> None:
    matplotlib.use("Agg")
    asks = any("localhost:8000" in b.text for b in BLOCKS[page] if b.mark == "")
    with Machine(folder, service=request.getfixturevalue("service") if asks else "") as machine:
        run = [block for block in BLOCKS[page] if block.mark != "not run" and (slow or block.mark != "slow")]
        printed = "".join(machine.run(block) for block in run)
    plt.close("all")
    assert PRINTED.get(page, "") in printed


@pytest.mark.parametrize("page", [pytest.param(p, marks=[pytest.mark.slow] * (p in LONG)) for p in RUNNABLE])
def test_every_block_of_a_page_runs(page: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    _run(page, tmp_path, request, slow=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW)
def test_the_blocks_that_take_minutes_run_too(page: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    _run(page, tmp_path, request, slow=True)


def test_every_block_has_a_language_and_those_left_out_have_a_reason() -> None:
    every = [block for blocks in BLOCKS.values() for block in blocks]
    assert not [str(b) for b in every if b.language not in RUN + DATA]
    left_out = [b for b in every if b.mark == "not run"]
    assert not [str(b) for b in left_out if b.language not in RUN or len(b.reason) < 10]
    assert len(left_out) <= NOT_RUN, [str(b) for b in left_out]


def test_code_is_fenced() -> None:
    """A block that is only indented would be run by nobody."""
    for page in BLOCKS:
        fenced, previous = False, ""
        for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), 1):
            fenced ^= line.startswith("```")
            indented = (
                line.startswith("    ") and not previous.strip() and not line.lstrip().startswith(("-", "*", ":"))
            )
            assert fenced or not indented or _in_definition(page, number), f"{page}:{number}: fence this code"
            previous = line


def _in_definition(page: str, number: int) -> bool:
    """Whether an indented line goes on with a definition list or an item, whose text is indented as well."""
    before = (ROOT / page).read_text(encoding="utf-8").splitlines()[: number - 1]
    start = next((line for line in reversed(before) if line and not line.startswith(" ")), "")
    return start.startswith((":", "-", "1", "2", "3"))


def test_pages_on_adding_one_more_have_tests_of_their_own() -> None:
    added = sorted((ROOT / "docs/how-to").glob("add-a*.md"))
    assert [page.stem for page in added] == [
        "add-a-heightmap-format",
        "add-a-log-format",
        "add-a-model",
        "add-a-path-option",
        "add-a-planner",
        "add-an-effect",
    ]
    for page in added:
        name = page.relative_to(ROOT).as_posix()
        assert own_test(name).is_file(), f"{name} has no test {own_test(name).name}"
        assert page.name in own_test(name).read_text(encoding="utf-8"), f"the test of {name} does not read it"


def test_a_block_that_fails_is_noticed(tmp_path: Path) -> None:
    from tests.docs.code_blocks import Block

    wrong = Block("page", 1, "bash", "", "false\necho never\n", "", "")
    with Machine(tmp_path) as machine, pytest.raises(AssertionError, match="failed"):
        machine.run(wrong)
    with Machine(tmp_path) as machine, pytest.raises(ZeroDivisionError):
        machine.run(Block("page", 1, "python", "", "1 / 0\n", "", ""))
    with Machine(tmp_path) as machine:
        machine.run(Block("page", 1, "bash", "", "HERE=there\n", "", ""))
        machine.run(Block("page", 2, "toml", "a.toml", "x = 1\n", "", ""))
        assert machine.run(Block("page", 2, "bash", "", "printf 'no end of line'\n", "", "")) == "no end of line"
        assert machine.run(Block("page", 3, "bash", "", "echo $HERE; cat a.toml\n", "", "")) == "there\nx = 1\n"
