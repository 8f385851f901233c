"""Work distributed to threads that do not wait for each other.

Threads that meet at a barrier after every loop, as those of numba's parallel loops do, are idle for most of the time
when the machine has other work: up to forty times as long as the loop itself takes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

import numba

from joulemap.model.compiling import say_when_compiling

say_when_compiling()

Part = TypeVar("Part")
Result = TypeVar("Result")
First = TypeVar("First")
Second = TypeVar("Second")


def share_out(do: Callable[[Part], Result], parts: Sequence[Part]) -> list[Result]:
    """Do every part, each in one of as many threads as numba may use, in no particular order."""
    threads = min(numba.get_num_threads(), len(parts))
    if threads <= 1:
        return [do(part) for part in parts]
    contexts = [copy_context() for _ in parts]  # context variables of the caller hold in the threads too
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda context, part: context.run(do, part), contexts, parts))


def both(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Call two functions at the same time, or one after the other where numba may use one thread only."""
    if numba.get_num_threads() < 2:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(copy_context().run, first)
        found = second()
        return other.result(), found


def pieces(count: int, size: int) -> list[slice]:
    """Divide a range into consecutive slices."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
