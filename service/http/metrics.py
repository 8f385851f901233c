"""What Prometheus reads from a service: requests, queues, stalls of the event loop, and what others add."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from prometheus_client import (
    CollectorRegistry,
    GCCollector,
    Histogram,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from joulemap.service.http.work_queue import WorkQueue

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
Numbers = Callable[[], float | Mapping[Any, float]]
"""Returns a number, or numbers by the value of a label, or by a tuple of the values of labels."""

_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0)
_STALLS = (0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0)
_PROBE_S = 0.01
_SLOT_S, _SLOTS = 10.0, 6  # the worst stall is that of the last minute


class Metrics:
    """The metrics of one service, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        for collector in (ProcessCollector, PlatformCollector, GCCollector):
            collector(registry=self.registry)
        self._requests = Histogram(
            "joulemap_http_request_seconds",
            "time from the first byte of a request to the last one of its answer",
            ["method", "route", "status"],
            registry=self.registry,
            buckets=_SECONDS,
        )
        self._waited = Histogram(
            "joulemap_queue_wait_seconds", "time in a queue", ["queue"], registry=self.registry, buckets=_SECONDS
        )
        self._took = Histogram(
            "joulemap_queue_work_seconds", "time on a thread", ["queue"], registry=self.registry, buckets=_SECONDS
        )
        self._stalls = Histogram(
            "joulemap_event_loop_stall_seconds",
            f"by how much a pause of {_PROBE_S:g} s on the event loop was too long",
            registry=self.registry,
            buckets=_STALLS,
        )
        self._worst: deque[list[float]] = deque(maxlen=_SLOTS)  # [beginning of the slot, its longest stall]
        self.gauge("joulemap_event_loop_stall_max_seconds", "the longest stall of the last minute", self.worst_stall_s)

    def gauge(self, name: str, words: str, read: Numbers, *, labels: Sequence[str] = ()) -> None:
        """Add a number that goes up and down."""
        self.registry.register(_Read(GaugeMetricFamily, name, words, read, labels))

    def counter(self, name: str, words: str, read: Numbers, *, labels: Sequence[str] = ()) -> None:
        """Add a number that only grows; as `gauge`."""
        self.registry.register(_Read(CounterMetricFamily, name, words, read, labels))

    def queues(self, queues: Iterable[WorkQueue]) -> None:
        """Add what there is to know of queues."""
        known, labels = {queue.name: queue for queue in queues}, ("queue",)

        def _each(value: str) -> Callable[[], Mapping[str, float]]:
            return lambda: {name: float(getattr(queue, value)) for name, queue in known.items()}

        self.gauge("joulemap_queue_waiting", "questions that wait", _each("waiting"), labels=labels)
        self.gauge("joulemap_queue_running", "questions on a thread", _each("running"), labels=labels)
        self.gauge("joulemap_queue_slots", "threads for questions", _each("threads"), labels=labels)
        self.counter("joulemap_queue_refused_total", "refused: the queue was full", _each("refused"), labels=labels)
        self.counter("joulemap_queue_given_up_total", "the client had gone", _each("given_up"), labels=labels)

    def saw_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request that was answered."""
        self._requests.labels(method, route, str(status)).observe(seconds)

    def saw_work(self, queue: str, waited_s: float, took_s: float) -> None:
        """Count a piece of work that has ended."""
        self._waited.labels(queue).observe(waited_s)
        self._took.labels(queue).observe(took_s)

    async def watch_loop(self) -> None:
        """Measure the stalls of the event loop until cancelled."""
        while True:
            began = time.monotonic()
            await asyncio.sleep(_PROBE_S)
            now = time.monotonic()
            late = max(now - began - _PROBE_S, 0.0)
            self._stalls.observe(late)
            if not self._worst or now - self._worst[-1][0] > _SLOT_S:
                self._worst.append([now, 0.0])
            self._worst[-1][1] = max(self._worst[-1][1], late)

    def worst_stall_s(self) -> float:
        """Return the longest stall of the event loop in the last minute."""
        return max((late for _, late in self._worst), default=0.0)

    def text(self) -> bytes:
        """Return everything in Prometheus' text format."""
        return generate_latest(self.registry)


class _Read(Collector):
    """A metric that is read where it lives."""

    def __init__(
        self,
        family: type[GaugeMetricFamily] | type[CounterMetricFamily],
        name: str,
        words: str,
        read: Numbers,
        labels: Sequence[str],
    ) -> None:
        self._family, self._name, self._words, self._read, self._labels = family, name, words, read, labels

    def describe(self) -> Iterable[Metric]:
        return [self._family(self._name, self._words, labels=self._labels)]

    def collect(self) -> Iterable[Metric]:
        found = self._read()
        metric = self._family(self._name, self._words, labels=self._labels)
        for key, value in (found if isinstance(found, Mapping) else {(): found}).items():
            metric.add_metric([key] if isinstance(key, str) else list(key), value)
        return [metric]
