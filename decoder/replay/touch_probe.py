"""The drive's touch probe in a replay: the recorded SDO answers to a request of the machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pdgw.decoder.replay.recorded import ProbeTransfer
from pdgw.dsp402.drive import touch_probe
from pdgw.gateway.axis.values import ProbeAnswer, ProbeWish
from pdgw.gateway.objects.touch_probe import dropped, refused


class Found(NamedTuple):
    """Time at which the gateway had the answer, and the number of transfers searched for it."""

    time_ns: int
    answer: ProbeAnswer
    used: int


def find_answer(wish: ProbeWish, transfers: Sequence[ProbeTransfer], first: int, begin_ns: int) -> Found | None:
    """Search from transfer ``first`` on, not before ``begin_ns``. None: the request was withdrawn, or no answer arrived."""
    function = touch_probe.function(wish.edges, zero_pulse=wish.zero_pulse)
    armed = False
    missing: list[int] = []
    positions: dict[int, int] = {}
    for used, (time_ns, index, value, written, abort) in enumerate(transfers[first:], first + 1):
        if time_ns < begin_ns:
            continue
        if abort is not None:
            return Found(time_ns, refused(wish, abort), used)
        if index == touch_probe.FUNCTION:
            if written and value == function and not armed:
                armed = True
            elif written and (armed or value):
                return None
        elif not armed:
            continue
        elif index == touch_probe.STATUS:
            missing = [edge for edge in wish.edges if value & touch_probe.stored_bit(edge)]
            if not missing and not touch_probe.enabled_bits(value):
                return Found(time_ns, dropped(wish, value), used)
        elif missing and index == touch_probe.POSITIONS[missing[0]]:
            positions[missing.pop(0)] = value
            if not missing:
                return Found(time_ns, ProbeAnswer(wish, positions), used)
    return None
