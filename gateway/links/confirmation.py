"""Decides whether an order in a frame may be an old order. Sans-I/O.

Source: docs/transport.md chapter 1. An order counts at once if its frame cannot be a copy of an earlier one (``history``).
Otherwise ``CONFIRMING_FRAMES`` consecutive frames must contain it, and no other frame, even a stale one, may contradict it. Until
then it waits. If another order replaces it before, it is dropped, because the PLC may not have sent it. While an order waits, and
after a drop until the PLC repeats it, the axis shows no target reached and no task acknowledged.

A stop does not wait: its bit falls with the first frame; only its return must be confirmed. This applies to bits whose return
starts no new motion, else an old frame could start one (STW1.11: homing). OFF2 and OFF3 use STW1 as a whole but a rise of
STW1.10: they release no lock. After a loss they act without STW1.10, so the other words of the frame are ignored.
OFF1 and STW1.3 wait where they would release a lock or end braking. Halt of a Controlword stops where it is 1: it rises at
once, and its fall must be confirmed.

Not detected: a network that delays all frames of a period by whole turns of the counter and loses every other frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter

from pdgw.dsp402.states import ControlBit
from pdgw.gateway.reasons import UnconfirmedOrder
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf

CONFIRMING_FRAMES = 3
"""Number of consecutive frames that confirm an order that may be old."""

_STW1 = signal("STW1")
_NO_STOP = _STW1.bit("NO_COAST_STOP").mask | _STW1.bit("NO_QUICK_STOP").mask
"""OFF2 and OFF3 in STW1 and in the Controlword, which has the same bits: they start nothing. Those of STW1 release no lock."""
_ON = _STW1.bit("ON").mask
_ENABLE = _STW1.bit("ENABLE_OPERATION").mask
_TASK = _STW1.bit("ACTIVATE_TASK", positioning=True).mask
_REJECT = _STW1.bit("DO_NOT_REJECT", positioning=True).mask
_HALT = _STW1.bit("NO_INTERMEDIATE_STOP", positioning=True).mask
_CONTROL = _STW1.bit("CONTROL_BY_PLC").mask
_JOG_1, _JOG_2 = _STW1.bit("JOG_1_ON").mask, _STW1.bit("JOG_2_ON").mask
_RAMP_BITS = tuple(
    _STW1.bit(name).mask for name in ("ENABLE_RAMP_GENERATOR", "UNFREEZE_RAMP_GENERATOR", "ENABLE_SETPOINT")
)
_RELEASED_STOPS = {_ON: _ON, _ENABLE: _ENABLE}
"""Bits whose fall acts at once. These two only while the axis follows the PLC: elsewhere OFF1 releases a lock, and STW1.3 ends
braking.
"""
_SPEED_STOPS = {
    # A jog starts when all three are 0: no unconfirmed jog bit may be set then.
    **{bit: bit | _JOG_1 | _JOG_2 for bit in _RAMP_BITS},
    **{bit: bit for bit in (_JOG_1, _JOG_2, _CONTROL)},
}
_POSITIONING_STOPS = {
    **{bit: bit for bit in (_REJECT, _HALT, _CONTROL)},
    # The return of a jog bit would be the edge of another incremental jog. Until it is confirmed, STW1.5 = 0 holds the axis.
    **dict.fromkeys((_JOG_1, _JOG_2), _HALT),
}
_DISCARDING = _REJECT | _ENABLE
"""Stops after which a positioning axis has no task any more."""
_POWER_SIGNALS = ("STW1", "Controlword")
_SIGN_OF_LIFE = "SIGN_OF_LIFE"


class Orders:
    """The control words of a telegram as one value: everything that can start something. A sign of life is not an order."""

    def __init__(self, half: TelegramHalf) -> None:
        mask = [0] * len(half.signals)
        words: list[tuple[int, int]] = []
        lives: list[int] = []
        self._power: int | None = None
        self._place = 0
        """Place of the word with OFF1 to OFF3 in the telegram."""
        positioning = half.mode is ApplicationMode.POSITIONING
        has_stw1 = "STW1" in half.names
        self._off2_opens = not has_stw1
        self._stops = (_POSITIONING_STOPS if positioning else _SPEED_STOPS) if has_stw1 else {}
        self._control = _CONTROL if has_stw1 else 0
        self._halt = 0 if has_stw1 else ControlBit.HALT
        """Bits that stop where they are 1."""
        self.discarding, self._task = (_DISCARDING, _TASK) if has_stw1 and positioning else (0, 0)
        for place, item in enumerate(half.signals):
            if item.name in _POWER_SIGNALS:
                self._power, self._place = len(words), place
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
        self._words = len(words)
        self.lives = tuple(lives)
        """First byte of its words with a sign of life."""
        self.mask = half.struct.pack(*mask)
        """Mask of its bits in the telegram's bytes."""
        if len(words) == 1 and words[0][1] == ~0:
            only = slice(words[0][0], words[0][0] + 1)
            self.read = itemgetter(only)
        else:
            self.read = lambda values: tuple(values[place] & mask for place, mask in words)

    def stopped(
        self, order: tuple[int, ...], in_force: tuple[int, ...] | None, *, released: bool
    ) -> tuple[int, ...] | None:
        """The order in force with every stop of another order. ``released``: the axis follows the PLC."""
        power = self._power
        if power is None or (self._off2_opens and not released):
            return in_force
        asked = order[power]
        halts = asked & _NO_STOP != _NO_STOP
        if in_force is None:
            if not halts or (self._off2_opens and len(order) > 1):
                return None
            in_force = self.power_bits(0)
        word = in_force[power]
        if halts:
            word = asked & (word | ~self._control)
        else:
            fallen = word & ~asked
            word |= asked & self._halt
            for stops in (self._stops, _RELEASED_STOPS) if released else (self._stops,):
                for bit, cleared in stops.items():
                    if fallen & bit:
                        word &= ~cleared
        return (*in_force[:power], word, *in_force[power + 1 :])

    def power_word(self, order: tuple[int, ...]) -> int:
        """STW1 or the Controlword of an order; 0 without one."""
        return 0 if self._power is None else order[self._power]

    def power_bits(self, bits: int) -> tuple[int, ...]:
        """Bits of STW1 or the Controlword, as those of an order."""
        return tuple(bits if place == self._power else 0 for place in range(self._words))

    def applied(self, order: tuple[int, ...], values: Sequence[int]) -> tuple[int, ...]:
        """The values of a frame, with STW1 or the Controlword of an order."""
        return (*values[: self._place], self.power_word(order), *values[self._place + 1 :])

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

    def begins_task(self, order: tuple[int, ...], in_force: tuple[int, ...] | None) -> bool:
        """Whether an order has the edge of a task, against the one in force."""
        return in_force is not None and self.power_word(order) & ~self.power_word(in_force) & self._task != 0


class Confirmation:
    """The order of one drive object: in force at once, or after enough frames with it."""

    def __init__(self, half: TelegramHalf) -> None:
        self.orders = Orders(half)
        self.read = self.orders.read
        self.mask = self.orders.mask
        self.lives = self.orders.lives
        self.orders_dropped = 0
        """Orders that were replaced before they were confirmed."""
        self._newest: tuple[int, ...] | None = None
        self._repeats = 0
        self._waits = False
        self._early = 0
        """Bits of STW1 that fell with the newest order, discarded the task and are not confirmed."""
        self._dropped: tuple[tuple[int, ...], tuple[int, ...]] | None = None
        """The last dropped command, and its differences from the command in force."""

    def restart(self, order: tuple[int, ...] | None, repeats: int) -> None:
        """A new connection: its last ``repeats`` frames contained ``order``."""
        self._newest = order
        self._repeats = repeats
        self.forget()

    def forget(self) -> None:
        """The axis has no PLC: whatever waited or was dropped starts nothing any more."""
        self._waits = False
        self._early = 0
        self._dropped = None

    def contradict(self) -> None:
        """The newest frame may be an old one: restart the confirmation of its order."""
        self._repeats = 0

    @property
    def unconfirmed(self) -> UnconfirmedOrder:
        """Whether the PLC may have ordered something that is not in force, or the reverse."""
        if self._waits or self._early:
            return UnconfirmedOrder.WAITS
        return UnconfirmedOrder.NONE if self._dropped is None else UnconfirmedOrder.DROPPED

    def judge(
        self, order: tuple[int, ...], in_force: tuple[int, ...] | None, *, is_new: bool, released: bool
    ) -> tuple[int, ...] | None:
        """The order to be in force from this frame on: its own, or the one in force with the stops of this frame."""
        orders = self.orders
        if order == self._newest:
            self._repeats += 1
        else:
            if self._waits:
                self._drop(in_force)
            if in_force is not None and orders.power_word(order) & self._early:
                self._withdraw(in_force)
            self._newest = order
            self._repeats = 1
        certain = is_new or self._repeats >= CONFIRMING_FRAMES
        put = order if certain or order == in_force else orders.stopped(order, in_force, released=released)
        self._waits = put != order
        if put is not None and put != in_force:
            if in_force is not None:
                self._early |= orders.power_word(in_force) & ~orders.power_word(put) & orders.discarding
            if self._dropped is not None:
                self._end_dropped(put, in_force)
        if certain or (put is not None and orders.is_off(put)):
            self._early = 0
        return put

    def _drop(self, in_force: tuple[int, ...] | None) -> None:
        """The newest order was replaced before it was confirmed."""
        self._waits = False
        if self._newest is not None and in_force is not None:
            self.orders_dropped += 1
            self._note_dropped(self._newest, self.orders.changed(self._newest, in_force))

    def _withdraw(self, in_force: tuple[int, ...]) -> None:
        """A stop ended before it was confirmed: the task is discarded, and the PLC may not know."""
        self.orders_dropped += 1
        self._note_dropped(in_force, self.orders.power_bits(self._early))
        self._early = 0

    def _note_dropped(self, order: tuple[int, ...], bits: tuple[int, ...]) -> None:
        if self._dropped is not None:
            earlier, others = self._dropped
            order = tuple(old & ~bit | new & bit for old, new, bit in zip(earlier, order, bits, strict=True))
            bits = tuple(old | new for old, new in zip(others, bits, strict=True))
        self._dropped = order, bits

    def _end_dropped(self, order: tuple[int, ...], in_force: tuple[int, ...] | None) -> None:
        """An order is in force that repeats the dropped one, starts another task, or ends every task."""
        assert self._dropped is not None
        dropped, bits = self._dropped
        repeats = not any((one ^ other) & bit for one, other, bit in zip(order, dropped, bits, strict=True))
        if repeats or self.orders.begins_task(order, in_force) or self.orders.is_off(order):
            self._dropped = None
