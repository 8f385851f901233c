"""A limit of requests per second: a token bucket for each owner."""

from __future__ import annotations

import time
from collections.abc import Callable

from joulemap.model.errors import RateError

BURST_S = 10.0
"""A caller that was quiet may send so many seconds' worth of requests at once."""


class Buckets:
    """Token buckets by name; one that is full again is forgotten when another one is made.

    `clock`: returns a time that only grows [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._buckets: dict[str, tuple[float, float]] = {}  # name -> tokens at a time

    def take(self, name: str, per_s: float) -> None:
        """Take one token, from the thread of the event loop."""
        now, most = self._clock(), max(1.0, per_s * BURST_S)
        tokens, since = self._buckets.get(name, (most, now))
        tokens = min(most, tokens + (now - since) * per_s)
        if tokens < 1.0:
            self._buckets[name] = tokens, now
            raise RateError(
                f"key {name} sends more than {per_s:g} requests per second: wait as long as Retry-After says",
                limit_per_s=per_s,
                retry_after_s=(1.0 - tokens) / per_s,
            )
        self._buckets[name] = tokens - 1.0, now
