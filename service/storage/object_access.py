"""What talks to an object store: its errors as those of a file system, and some transfers at a time."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

LOST = errno.EHOSTUNREACH  # of an object store that does not answer: answered with 503, and jobs wait
_AT_ONCE = 8  # transfers
SHOWN = "the object store"
"""What messages call it."""


def obstore_library() -> Any:
    """Return obstore, which is an extra."""
    import obstore

    return obstore


def for_all(do: Callable[[str], object], names: list[str]) -> None:
    """Do something for every name, some at a time; raises what the first failure raises."""
    if len(names) <= 1:
        for name in names:
            do(name)
        return
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for done in [pool.submit(partial(do, name)) for name in names]:
            done.result()


@contextmanager
def as_file_errors() -> Iterator[None]:
    """Raise the errors of an object store as those of a file system."""
    from obstore.exceptions import BaseError, NotFoundError

    try:
        yield
    except (NotFoundError, FileNotFoundError) as error:
        raise FileNotFoundError(errno.ENOENT, f"{SHOWN} has no such object: {first_line(error)}") from error
    except BaseError as error:
        raise OSError(LOST, f"{SHOWN} does not answer as it should: {first_line(error)}") from error


def first_line(error: BaseException) -> str:
    """Return the first line of an error; below it obstore repeats itself for its developers."""
    return (str(error).splitlines() or [type(error).__name__])[0][:300]
