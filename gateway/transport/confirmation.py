"""Whether what a frame orders may be an old order. Sans-I/O.

Source: docs/transport.md chapter 1. The cycle counter has the same value again every 2.048 s, so a frame delayed by just that (or
twice that) fits the present sequence. What was received meanwhile tells: where the PLC's frame with this counter, a turn or two
ago, came and ordered something else, this one is no copy of it and counts at once. Where it ordered the same, or is not known
(lost, or before this connection), the order has to stand in ``CONFIRMING_FRAMES`` frames in a row, and no other frame may
contradict it meanwhile, even if it is a stale one. Stops do not wait: OFF2 and OFF3 always count at once, and OFF1 where it
releases no lock.

Left out: networks that delay a whole stretch of frames by whole turns and lose every other frame: nothing in the frames tells
these from the PLC.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from operator import attrgetter, itemgetter

from pdgw.gateway.transport.sequence import OLDEST_NS, WRAP_NS
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TelegramHalf

CONFIRMING_FRAMES = 3
"""So many frames in a row make an order credible that might be an old one."""
_TURNS = range(1, OLDEST_NS // WRAP_NS + 1)
_STRETCHES = 256
"""Kept of the past; older ones are not known any more, which only makes the confirmation longer."""

_STW1 = signal("STW1")
_NO_STOP = _STW1.bit("NO_COAST_STOP").mask | _STW1.bit("NO_QUICK_STOP").mask
"""OFF2 and OFF3 in STW1, and in the Controlword, which has the same bits: they start nothing. Those of STW1 release no lock."""
_ON = _STW1.bit("ON").mask
_POWER_SIGNALS = ("STW1", "Controlword")
_LOCK_OPENED_BY_OFF1_ONLY = "STW1"
_SIGN_OF_LIFE = "SIGN_OF_LIFE"


class Orders:
    """The control words of a telegram as one value: all that can start something. A sign of life is no order."""

    __slots__ = ("_off2_opens", "_power", "mask", "read")

    def __init__(self, half: TelegramHalf) -> None:
        mask = [0] * len(half.signals)
        words: list[tuple[int, int]] = []
        self._power: int | None = None
        self._off2_opens = _LOCK_OPENED_BY_OFF1_ONLY not in half.names
        for place, item in enumerate(half.signals):
            if item.name in _POWER_SIGNALS:
                self._power = len(words)
            elif "STW" not in item.name:
                continue
            life = sum(bit.mask for bit in item.bits if bit.name == _SIGN_OF_LIFE)
            words.append((place, ~life))
            low, high = item.type.integer_range
            mask[place] = (high - low) & ~life
        self.read: Callable[[Sequence[int]], tuple[int, ...]]
        """The order in the values of a frame."""
        self.mask = half.struct.pack(*mask)
        """Its bits in the telegram's bytes."""
        if len(words) == 1 and words[0][1] == ~0:
            only = slice(words[0][0], words[0][0] + 1)
            self.read = itemgetter(only)
        else:
            self.read = lambda values: tuple(values[place] & mask for place, mask in words)

    def only_stops(self, order: tuple[int, ...], in_force: tuple[int, ...] | None, *, released: bool) -> bool:
        """Whether all that is new in an order is OFF2, OFF3, or the OFF1 of an axis whose interlock is ``released``."""
        power = self._power
        if power is None or (self._off2_opens and not released):
            return False
        if order[power] & _NO_STOP == _NO_STOP:
            return released and in_force is not None and order == self._with_off(in_force, power)
        others = order[:power] + order[power + 1 :]
        return not others or (in_force is not None and others == in_force[:power] + in_force[power + 1 :])

    @staticmethod
    def _with_off(order: tuple[int, ...], power: int) -> tuple[int, ...]:
        return (*order[:power], order[power] & ~_ON, *order[power + 1 :])


class _Stretch:
    """Frames without a gap that ordered the same. Times are the PLC's, nanoseconds since the connection."""

    __slots__ = ("command", "first", "last")

    def __init__(self, command: Hashable, first: int) -> None:
        self.command = command
        self.first = self.last = first


_FIRST: Callable[[_Stretch], int] = attrgetter("first")


class OrderHistory:
    """What the frames of a connection ordered, and when by the PLC's clock."""

    def __init__(self, cycle_ns: int) -> None:
        # A frame is missing between two that are further apart.
        self._gap_ns = max(cycle_ns, COUNTER_UNIT_NS) * 3 // 2
        self._stretches: deque[_Stretch] = deque(maxlen=_STRETCHES)

    def clear(self) -> None:
        """A new connection: nothing is known of the time before."""
        self._stretches.clear()

    def enter(self, command: Hashable, elapsed_ns: int) -> None:
        """A frame was accepted."""
        stretches = self._stretches
        if stretches:
            last = stretches[-1]
            gap = elapsed_ns - last.last > self._gap_ns
            if last.command == command and not gap:
                last.last = elapsed_ns
                return
            if not gap:
                last.last = elapsed_ns - 1
            while stretches and stretches[0].last < elapsed_ns - OLDEST_NS - WRAP_NS:
                stretches.popleft()
        stretches.append(_Stretch(command, elapsed_ns))

    def contradict(self, command: Hashable, time: int) -> None:
        """Another frame of a time came too late: if it orders something else, what was ordered then is not known any more."""
        for place, stretch in enumerate(self._stretches):
            if stretch.first <= time <= stretch.last:
                if stretch.command != command:
                    after = _Stretch(stretch.command, time + 1)
                    after.last = stretch.last
                    stretch.last = time - 1
                    if len(self._stretches) < _STRETCHES:
                        self._stretches.insert(place + 1, after)
                    else:
                        self._stretches.clear()
                return

    def is_new(self, command: Hashable, elapsed_ns: int) -> bool:
        """Whether a frame of this time cannot be a copy of one sent a turn of the counter, or more, before."""
        return all(self._known_other(command, elapsed_ns - turn * WRAP_NS) for turn in _TURNS)

    def _known_other(self, command: Hashable, time: int) -> bool:
        place = bisect_right(self._stretches, time, key=_FIRST)
        if not place:
            return False
        stretch = self._stretches[place - 1]
        return time <= stretch.last and stretch.command != command


class Confirmation:
    """The order of one drive object: in force at once, or when it stood in enough frames."""

    __slots__ = ("_newest", "_orders", "_repeats", "mask", "read")

    def __init__(self, half: TelegramHalf) -> None:
        self._orders = Orders(half)
        self.read = self._orders.read
        self.mask = self._orders.mask
        self._newest: tuple[int, ...] | None = None
        self._repeats = 0

    def restart(self, order: tuple[int, ...] | None, repeats: int) -> None:
        """``order`` stood in the last ``repeats`` frames."""
        self._newest = order
        self._repeats = repeats

    def counts(self, order: tuple[int, ...], in_force: tuple[int, ...] | None, *, is_new: bool, released: bool) -> bool:
        """Whether the order of this frame, another than the one in force, may be put in force by it."""
        self._repeats = self._repeats + 1 if order == self._newest else 1
        self._newest = order
        if is_new or self._repeats >= CONFIRMING_FRAMES:
            return True
        return self._orders.only_stops(order, in_force, released=released)
