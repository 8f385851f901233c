"""Long work of a task in a process of its own, which is killed at once when nobody wants it any more."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence

_LOOK_S = 0.5  # between looks whether the task is still wanted
_ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")  # of a worker
_COMMAND = (
    "from joulemap.service.work.processes import end_with_parent; end_with_parent()\n"
    "from joulemap.service.cli import main; main()"
)


def run_command(arguments: Sequence[str], folder: str, topic: str) -> int:
    """Run a `joulemap` command on a worker."""
    from distributed import get_worker  # which takes half a second to load

    worker = get_worker()
    return run(["-c", _COMMAND, *arguments], cwd=folder, tell=lambda line: worker.log_event(topic, line), errors=True)


def run(
    arguments: Sequence[str], *, tell: Callable[[str], object], cwd: str | None = None, errors: bool = False
) -> int:
    """Run Python within a Dask task; tiles go on in the worker meanwhile.

    Result: its exit code; negative where it was killed, for example because the task was cancelled.
    """
    from distributed import get_worker, secede  # which takes half a second to load

    worker = get_worker()
    task = worker.state.tasks.get(worker.get_current_task())
    secede()
    env = {name: value for name, value in os.environ.items() if name not in _ONE_THREAD}
    with subprocess.Popen(
        [sys.executable, *arguments],
        cwd=cwd,
        env=env,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT if errors else None,
        encoding="utf-8",
    ) as process:

        def _watch() -> None:
            while process.poll() is None:
                if task is None or task.state in ("cancelled", "released", "forgotten"):
                    process.kill()
                try:
                    process.wait(_LOOK_S)
                except subprocess.TimeoutExpired:
                    continue

        threading.Thread(target=_watch, name="still wanted", daemon=True).start()
        assert process.stdout is not None
        for line in process.stdout:
            tell(line.rstrip("\n"))
        return process.wait()


def end_with_parent() -> None:
    """End this process when the worker that started it is gone: then its standard input ends."""

    def _watch() -> None:
        os.read(0, 1)  # not of sys.stdin, whose lock would be in the way when Python ends
        os._exit(1)

    threading.Thread(target=_watch, name="parent", daemon=True).start()
