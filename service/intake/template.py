"""A process in which all is loaded that reading a file needs; each file is read in a fork of it, which ends with it.

A new process takes seconds to load its libraries, a fork some milliseconds. Nothing that one file breaks is there when
the next one is read. The template has a single thread, so that a fork of it is whole. Who closes the socket of a file
ends its process: the system signals that to the process, which needs no help of the code that reads.
"""

from __future__ import annotations

import fcntl
import gc
import json
import os
import select
import signal
import socket
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from joulemap.service.hosting.system import LONG_NICE, be_nice
from joulemap.service.intake.guard import prepared, read

BEGUN = b"\n"
"""What a process sends first. An answer without it means that no process was there to read."""

_CHUNK = 1 << 16


def main(control: socket.socket) -> None:
    """Read files until the other end of a socket is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the service, which lets files in hand be read
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the forks
    be_nice(LONG_NICE)
    for task in ("heightmap", "run"):
        prepared(task)
    gc.collect()
    gc.freeze()  # a fork shares this memory as long as nobody writes into it
    while True:
        _, sockets, _, _ = socket.recv_fds(control, 1, 1)
        if not sockets:
            return
        file = socket.socket(fileno=sockets[0])
        if os.fork() == 0:
            control.close()
            _read_one(file)
        file.close()


def _read_one(file: socket.socket) -> None:
    """In the fork: answer one request and end."""
    try:
        file.sendall(BEGUN)
        chunks = iter(lambda: file.recv(_CHUNK), b"")
        request = json.loads(b"".join(chunks))
        with _ending_with(file):
            answer = _answer(request["task"], request["arguments"])
        file.sendall(answer.encode())
    except BrokenPipeError:  # nobody waits any more
        pass
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(0)


def _answer(task: str, arguments: str) -> str:
    try:
        return read(task, arguments)
    except OSError as error:
        return json.dumps({"os_error": [error.errno, error.strerror or str(error), error.filename]}, default=str)


@contextmanager
def _ending_with(file: socket.socket) -> Iterator[None]:
    """While the block runs, this process ends when the other end of a socket is closed."""
    before = fcntl.fcntl(file, fcntl.F_GETFL)
    fcntl.fcntl(file, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(file, fcntl.F_SETFL, before | os.O_ASYNC)  # nothing handles SIGIO: it ends the process
    gone = select.poll()
    gone.register(file, 0)  # POLLHUP and POLLERR are always reported
    if gone.poll(0):
        os._exit(0)
    try:
        yield
    finally:
        fcntl.fcntl(file, fcntl.F_SETFL, before)


if __name__ == "__main__":
    main(socket.socket(fileno=int(sys.argv[1])))
