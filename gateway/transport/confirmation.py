"""Whether what a frame orders may be an old order. Sans-I/O.

Source: docs/transport.md chapter 1. An order counts at once when its frame cannot be a copy of an earlier one (``history``).
Otherwise it has to stand in ``CONFIRMING_FRAMES`` frames in a row, and no other frame may contradict it meanwhile, even if it
is a stale one. Until then it waits. An order that another one replaces before it was confirmed is dropped: whether the PLC
sent it is not known. The axis shows no target reached and no task acknowledged while an order waits, and after a drop until the
PLC repeats what was dropped. Stops do not wait: OFF2 and OFF3 always count at once, and OFF1 where it releases no lock.

Left out: networks that delay a whole stretch of frames by whole turns and lose every other frame: nothing in the frames tells
these from the PLC.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter

from pdgw.gateway.reasons import OrderDoubt
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TelegramHalf

CONFIRMING_FRAMES = 3
"""So many frames in a row make an order credible that might be an old one."""

_STW1 = signal("STW1")
_NO_STOP = _STW1.bit("NO_COAST_STOP").mask | _STW1.bit("NO_QUICK_STOP").mask
"""OFF2 and OFF3 in STW1, and in the Controlword, which has the same bits: they start nothing. Those of STW1 release no lock."""
_ON = _STW1.bit("ON").mask
_POWER_SIGNALS = ("STW1", "Controlword")
_LOCK_OPENED_BY_OFF1_ONLY = "STW1"
_SIGN_OF_LIFE = "SIGN_OF_LIFE"


class Orders:
    """The control words of a telegram as one value: all that can start something. A sign of life is no order."""

    __slots__ = ("_off2_opens", "_power", "lives", "mask", "read")

    def __init__(self, half: TelegramHalf) -> None:
        mask = [0] * len(half.signals)
        words: list[tuple[int, int]] = []
        lives: list[int] = []
        self._power: int | None = None
        self._off2_opens = _LOCK_OPENED_BY_OFF1_ONLY not in half.names
        for place, item in enumerate(half.signals):
            if item.name in _POWER_SIGNALS:
                self._power = len(words)
            elif "STW" not in item.name:
                continue
            life = sum(bit.mask for bit in item.bits if bit.name == _SIGN_OF_LIFE)
            if life:
                lives.append(sum(before.type.size for before in half.signals[:place]))
            words.append((place, ~life))
            low, high = item.type.integer_range
            mask[place] = (high - low) & ~life
        self.read: Callable[[Sequence[int]], tuple[int, ...]]
        """The order in the values of a frame."""
        self.lives = tuple(lives)
        """Where its words with a sign of life begin, in bytes."""
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

    def changed(self, order: tuple[int, ...], in_force: tuple[int, ...]) -> tuple[int, ...]:
        """The bits in which two orders differ: those of STW1, of the other words only where STW1 is the same."""
        bits = [one ^ other for one, other in zip(order, in_force, strict=True)]
        power = self._power
        if power is not None and bits[power]:
            bits = [item if place == power else 0 for place, item in enumerate(bits)]
        return tuple(bits)

    def is_off(self, order: tuple[int, ...]) -> bool:
        """OFF1, OFF2 or OFF3: every task is over."""
        return self._power is not None and order[self._power] & (_NO_STOP | _ON) != _NO_STOP | _ON

    @staticmethod
    def _with_off(order: tuple[int, ...], power: int) -> tuple[int, ...]:
        return (*order[:power], order[power] & ~_ON, *order[power + 1 :])


class Confirmation:
    """The order of one drive object: in force at once, or when it stood in enough frames."""

    __slots__ = ("_dropped", "_newest", "_orders", "_repeats", "_waits", "dropped", "lives", "mask", "read")

    def __init__(self, half: TelegramHalf) -> None:
        self._orders = Orders(half)
        self.read = self._orders.read
        self.mask = self._orders.mask
        self.lives = self._orders.lives
        self.dropped = 0
        """Orders that were replaced before they were confirmed."""
        self._newest: tuple[int, ...] | None = None
        self._repeats = 0
        self._waits = False
        self._dropped: tuple[tuple[int, ...], tuple[int, ...]] | None = None
        """The last one, and the bits in which it differed from the order in force."""

    def restart(self, order: tuple[int, ...] | None, repeats: int) -> None:
        """A new connection: ``order`` stood in its last ``repeats`` frames."""
        self._newest = order
        self._repeats = repeats
        self.forget()

    def forget(self) -> None:
        """The axis has no PLC: whatever waited or was dropped starts nothing any more."""
        self._waits = False
        self._dropped = None

    def contradict(self) -> None:
        """The newest frame may have been an old one: what it ordered has to be confirmed from the beginning."""
        self._repeats = 0

    @property
    def doubt(self) -> OrderDoubt:
        """Whether the PLC may have ordered something that is not in force."""
        if self._dropped is not None:
            return OrderDoubt.DROPPED
        return OrderDoubt.WAITS if self._waits else OrderDoubt.NONE

    def repeated(self, order: tuple[int, ...]) -> None:
        """The order of this frame is the one in force."""
        if self._waits:
            self._drop(order)
        self._newest = order
        self._repeats = 1

    def counts(self, order: tuple[int, ...], in_force: tuple[int, ...] | None, *, is_new: bool, released: bool) -> bool:
        """Whether the order of this frame, another than the one in force, may be put in force by it."""
        if order == self._newest:
            self._repeats += 1
        else:
            if self._waits:
                self._drop(in_force)
            self._repeats = 1
        self._newest = order
        counts = (
            is_new or self._repeats >= CONFIRMING_FRAMES or self._orders.only_stops(order, in_force, released=released)
        )
        self._waits = not counts
        if counts and self._dropped is not None:
            self._settle(order)
        return counts

    def _drop(self, in_force: tuple[int, ...] | None) -> None:
        self._waits = False
        if self._newest is not None and in_force is not None:
            self.dropped += 1
            order, bits = self._newest, self._orders.changed(self._newest, in_force)
            if self._dropped is not None:
                earlier, others = self._dropped
                order = tuple(old & ~bit | new & bit for old, new, bit in zip(earlier, order, bits, strict=True))
                bits = tuple(old | new for old, new in zip(others, bits, strict=True))
            self._dropped = order, bits

    def _settle(self, order: tuple[int, ...]) -> None:
        """An order is in force that repeats what was dropped, or ends every task."""
        assert self._dropped is not None
        dropped, bits = self._dropped
        if self._orders.is_off(order) or not any(
            (one ^ other) & bit for one, other, bit in zip(order, dropped, bits, strict=True)
        ):
            self._dropped = None
