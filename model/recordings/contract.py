"""What every kind of recording offers: its topics, and the messages of those that are wanted, one after another."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class Topic:
    """Where messages of one type were sent.

    Attributes
    ----------
    name : str
        Such as `/battery`.
    kind : str
        Type of its messages as the file writes it; empty where it does not say.
    encoding : str
        How the messages are written: cdr, ros1, json, protobuf or another word.
    readable : bool
        Whether messages of this encoding can be read.
    """

    name: str
    kind: str
    encoding: str
    readable: bool = True


Wanted = Callable[[Topic], bool]


class Recording(Protocol):
    """A recording that is open.

    Attributes
    ----------
    topics : dict of str to Topic
        By name; of a file without an index those that were met so far.
    notes : list of str
        What is to be known of the file: that it was cut off, for example.
    """

    topics: dict[str, Topic]
    notes: list[str]

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        """Return the messages of some topics.

        Yields: topic, time of recording [s since 1970], and the message: an object with its fields, or a dict.
        """


def topics_in_words(topics: dict[str, Topic]) -> str:
    """Return the topics of a recording for a message.

    Result: their names, the first ones of many, and what cannot be read with its encoding.
    """
    names = [name if topic.readable else f"{name} ({topic.encoding})" for name, topic in sorted(topics.items())]
    return ", ".join(names)[:300] or "none"
