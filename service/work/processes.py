"""Long work of a task in a process of its own, which is killed at once when nobody wants it any more."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence

_LOOK_S = 0.5  # between looks whether the task is still wanted
_ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")  # of a worker


def run(module: str, arguments: Sequence[str], *, cwd: str | None = None, tell: Callable[[str], object]) -> int:
    """Run a module within a Dask task; tiles go on in the worker meanwhile.

    Parameters
    ----------
    module : str
        Runs as `python -m`; it calls `end_with_parent` first.
    arguments : sequence of str
        Of its command line.
    cwd : str, optional
        Folder to run in.
    tell : callable
        Is given every line that the process prints.

    Returns
    -------
    int
        Its exit code; negative where it was killed, for example because the task was cancelled.
    """
    from distributed import get_worker, secede  # which takes half a second to load

    worker = get_worker()
    task = worker.state.tasks.get(worker.get_current_task())
    secede()
    env = {name: value for name, value in os.environ.items() if name not in _ONE_THREAD}
    command = [sys.executable, "-m", module, *arguments]
    with subprocess.Popen(
        command, cwd=cwd, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8"
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
