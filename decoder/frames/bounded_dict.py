"""A dictionary that drops its oldest entries, for packets that wait for an answer."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from typing import Final, Generic, TypeVar

REMEMBERED: Final = 256
"""Calls and requests that wait for an answer."""

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class BoundedDict(Generic[K, V]):
    """The newest entries, so that unanswered packets do not fill the memory in a long capture."""

    def __init__(self) -> None:
        self._entries: OrderedDict[K, V] = OrderedDict()

    def put(self, key: K, value: V) -> None:
        """Remember, and forget the oldest."""
        self._entries[key] = value
        self._entries.move_to_end(key)
        if len(self._entries) > REMEMBERED:
            self._entries.popitem(last=False)

    def newest(self) -> Iterator[V]:
        """All that is remembered, the newest first."""
        return reversed(self._entries.values())

    def get(self, key: K) -> V | None:
        return self._entries.get(key)

    def pop(self, key: K) -> V | None:
        return self._entries.pop(key, None)
