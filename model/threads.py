"""Work shared out to threads that do not wait for each other.

Threads that meet at a barrier after every loop, as those of numba's parallel loops do, stand still for most of the time
when the machine has other work: here for up to forty times as long as the loop itself takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numba

Part = TypeVar("Part")


def share_out(
    do: Callable[[Part], object],
    parts: Sequence[Part],
    *,
    initializer: Callable[..., object] | None = None,
    initargs: Iterable[Any] = (),
) -> None:
    """Do every part, each in one of as many threads as numba may use, in no particular order; raises what one raises.

    initializer : called with `initargs` in every thread before its first part.
    """
    threads = min(numba.get_num_threads(), len(parts))
    with ThreadPoolExecutor(threads, initializer=initializer, initargs=tuple(initargs)) as pool:
        for _ in pool.map(do, parts):
            pass


def pieces(count: int, size: int) -> list[slice]:
    """0 ... count in slices of `size`."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
