"""Slots for work, given in turn: to each owner an equal share, and of an owner to each group of work (cost map)."""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from joulemap.model.errors import BusyError

Owner = str | None
"""Name of a key; None for all that is asked without one."""

_RECENT = 0.1
"""Weight of the latest piece of work in the mean time of one, from which Retry-After is estimated."""


@dataclass(eq=False)
class Slot:
    """The right to work that one request has, or waits for."""

    owner: Owner
    group: str
    given: asyncio.Future[None]
    asked: float = field(default_factory=time.monotonic)
    waited_s: float = 0.0


class FairSlots:
    """A limited number of slots; all its methods are called on one event loop, so it needs no lock.

    A free slot goes to the owner with the fewest, and among those to the one whose turn it is. Where the line is full,
    an owner with less than its share of it takes the place of the newest of the owner with the most.

    `extra`: slots beyond `slots` for owners that have none, so that a short question does not wait for the end of the
    long ones of others; `per_group`: most of a group of one owner that wait; `overall`: most that wait.
    """

    def __init__(
        self,
        what: str,
        *,
        slots: int,
        overall: int,
        extra: int = 0,
        per_group: int | None = None,
        one_at_a_time: Callable[[str], bool] = lambda _group: False,
    ) -> None:
        self.what, self.slots = what, slots
        self._extra, self._overall, self._per_group = extra, overall, per_group or overall
        self._one_at_a_time = one_at_a_time
        self._lines: OrderedDict[Owner, OrderedDict[str, deque[Slot]]] = OrderedDict()  # whose turn it is comes first
        self.taken: dict[Slot, None] = {}
        self._mean_s = 1.0
        self.refused = 0

    @property
    def waiting(self) -> int:
        """How many wait for a slot."""
        return sum(map(_length, self._lines.values()))

    async def take(self, owner: Owner, group: str = "") -> Slot:
        """Wait for a slot; give it back afterwards. Raises BusyError where the line is full, now or later."""
        self._check_room(owner, group)
        slot = Slot(owner, group, asyncio.get_running_loop().create_future())
        self._lines.setdefault(owner, OrderedDict()).setdefault(group, deque()).append(slot)
        self._give()
        try:
            await slot.given
        except asyncio.CancelledError:
            if slot in self.taken:
                self.give_back(slot)
            elif slot in self._lines.get(owner, OrderedDict()).get(group, ()):
                self._take_out(slot)
            raise
        return slot

    def give_back(self, slot: Slot) -> float:
        """Let others have a slot. Result: for how long it was taken [s]."""
        del self.taken[slot]
        took_s = time.monotonic() - slot.asked - slot.waited_s
        self._mean_s += _RECENT * (took_s - self._mean_s)
        self._give()
        return took_s

    def refuse_all(self, error: Callable[[], BusyError]) -> None:
        """Give nobody who waits a slot."""
        while self._lines:
            self._push_out(next(iter(self._lines)), error())

    def _check_room(self, owner: Owner, group: str) -> None:
        line = self._lines.get(owner, OrderedDict())
        here, own, all_ = len(line.get(group, ())), _length(line), self.waiting
        if here >= self._per_group:
            self.refused += 1
            raise self._full("this cost map", here, self._per_group)
        if all_ >= self._overall:
            crowded = max(self._lines, key=lambda each: _length(self._lines[each]))
            self.refused += 1
            full = self._full("all", all_, self._overall)
            if _length(self._lines[crowded]) <= own + 1:
                raise full
            self._push_out(crowded, full)

    def _full(self, where: str, count: int, limit: int) -> BusyError:
        return BusyError(
            f"the queue is full: {self.what} of {where} that wait: {count}, limit: {limit}",
            waiting=count,
            limit=limit,
            retry_after_s=max(1, math.ceil(self.waiting * self._mean_s / self.slots)),
        )

    def _push_out(self, owner: Owner, error: BusyError) -> None:
        line = self._lines[owner]
        slot = max((queue[-1] for queue in line.values()), key=lambda each: each.asked)
        self._take_out(slot)
        if not slot.given.done():
            slot.given.set_exception(error)

    def _take_out(self, slot: Slot) -> None:
        line = self._lines[slot.owner]
        line[slot.group].remove(slot)
        if not line[slot.group]:
            del line[slot.group]
        if not line:
            del self._lines[slot.owner]

    def _give(self) -> None:
        """Give the slots that are free."""
        while (slot := self._next()) is not None:
            self._take_out(slot)
            if (line := self._lines.get(slot.owner)) is not None:
                self._lines.move_to_end(slot.owner)
                if slot.group in line:
                    line.move_to_end(slot.group)
            self.taken[slot] = None
            slot.waited_s = time.monotonic() - slot.asked
            if not slot.given.done():  # else its caller was cancelled, and gives it back
                slot.given.set_result(None)

    def _next(self) -> Slot | None:
        has = Counter(slot.owner for slot in self.taken)
        busy = {(slot.owner, slot.group) for slot in self.taken}
        for owner in sorted(self._lines, key=lambda each: has[each]):
            if len(self.taken) >= self.slots + (0 if has[owner] else self._extra):
                continue
            for group, queue in self._lines[owner].items():
                if (owner, group) not in busy or not self._one_at_a_time(group):
                    return queue[0]
        return None


def _length(line: OrderedDict[str, deque[Slot]]) -> int:
    return sum(map(len, line.values()))
