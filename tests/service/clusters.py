"""Dask clusters for tests: of one test, or one that all services of a test session share."""

from __future__ import annotations

import atexit
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def dask(*arguments: str, **env: str) -> Iterator[subprocess.Popen[bytes]]:
    """`dask scheduler` or `dask worker`, killed in the end."""
    command = [sys.executable, "-m", "dask", *arguments]
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT), **env}) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


@contextmanager
def cluster(workers: int, port: int = 0, **env: str) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The address of a scheduler; the scheduler and its workers."""
    port = port or free_port()
    address = f"tcp://127.0.0.1:{port}"
    with ExitStack() as stack:
        scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-show")
        begun = [stack.enter_context(scheduler)]
        for _ in range(workers):
            one = dask(
                "worker", address, "--host", "127.0.0.1", "--no-dashboard", "--nthreads", "1", "--no-nanny", **env
            )
            begun.append(stack.enter_context(one))
        yield address, begun


@cache
def shared_scheduler() -> str:
    """The address of a scheduler with a worker, begun when it is first asked for, for all tests of this process.

    A worker takes seconds to load. How a service starts workers of its own is tested by those that run in a process of
    their own.
    """
    stack = ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(cluster(1))[0]


def compose_environment(service: str) -> dict[str, str]:
    """The variables that `docker/compose.cluster.yaml` sets for one of its services."""
    compose = yaml.safe_load((ROOT / "docker" / "compose.cluster.yaml").read_text())
    return dict(compose["services"][service]["environment"])


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]
