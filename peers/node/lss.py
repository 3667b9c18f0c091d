"""Layer setting services of a simulated node: node-ID and bit rate by LSS, kept without power.

Source: CiA 305; CANopenNode (LSS slave). Services: switch state, configure node-ID and bit timing, activate it, store, inquire,
identify non-configured slaves, fastscan. Not simulated: identify remote slaves (46h to 4Bh).
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.communication import (
    IDENTITY,
    LSS_BIT_TIMINGS,
    LSS_NO_NODE_ID,
    LSS_REQUEST,
    LSS_RESPONSE,
    NODE_IDS,
    NmtState,
)
from pdgw.peers.node.behaviour import Behaviour

_BEGIN: Final = 0x80
"""Bit checked of the first request of a fastscan."""
_WORDS: Final = 4
"""Vendor-ID, product code, revision and serial number."""
_DONE, _OUT_OF_RANGE, _NOT_SUPPORTED, _STORE_FAILED = 0, 1, 1, 2


class _Service(enum.IntEnum):
    """Command specifiers. Of four that follow each other, each is for one number of the identity."""

    SWITCH_GLOBAL = 0x04
    NODE_ID = 0x11
    BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    SELECT = 0x40
    SELECTED = 0x44
    IDENTIFY_NON_CONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    NON_CONFIGURED = 0x50
    FASTSCAN = 0x51
    INQUIRE = 0x5A
    INQUIRE_NODE_ID = 0x5E


_SELECT: Final = range(_Service.SELECT, _Service.SELECT + _WORDS)
_INQUIRE: Final = range(_Service.INQUIRE, _Service.INQUIRE + _WORDS)


class LssSlave(Behaviour):
    """The device has LSS. Without a node-ID it answers nothing else, and sends nothing, not even its boot-up message."""

    configured = 1
    """0: it has no node-ID after power-on."""
    bitrate = 0
    """Bit rate after power-on; 0: that of the bus."""
    bit_timing = 1
    """0: it supports no other bit rate."""
    store_ms = 0
    store_fails = 0

    def begin(self) -> None:
        node = self.node
        self._first = node.node_id
        self._active = self._stored = node.node_id if self.configured else LSS_NO_NODE_ID
        self._stored_rate = self.bitrate
        self._answers: list[tuple[int, bytes]] = []
        self.restarting(powered=True)

    def end(self) -> None:
        changed = self._active != self._first
        self._active = self._first
        self.node.bitrate_changed(0)
        if changed:
            self.node.renumber(self._first)

    def restarting(self, *, powered: bool) -> None:
        if powered:
            self._pending, self._rate = self._stored, self._stored_rate
            self.node.bitrate_changed(self._rate)
            self._silent_until = 0
            self._change_at: int | None = None
        self._wait()
        self._active = self._pending
        if self._active in NODE_IDS:
            self.node.node_id = self._active

    def _wait(self) -> None:
        """Waiting state."""
        self._selected = False
        self._matched = self._place = 0
        """Numbers of the identity that matched, in a selective switch and in a fastscan."""

    @property
    def _identity(self) -> list[int]:
        return [int(self.node.values.get((IDENTITY, sub), 0)) for sub in range(1, 1 + _WORDS)]

    # -- frames -------------------------------------------------------------------------------------------------------

    @property
    def _is_silent(self) -> bool:
        return self.node.now < self._silent_until

    def incoming(self, can_id: int, data: bytes) -> bool:
        if can_id != LSS_REQUEST:
            return self._active != LSS_NO_NODE_ID and not self._is_silent
        node = self.node
        if node.running and node.state is not NmtState.OPERATIONAL and len(data) == 8 and not self._is_silent:
            self._serve(data)
        return False

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return (can_id == LSS_RESPONSE or self._active != LSS_NO_NODE_ID) and not self._is_silent

    def _answer(self, service: int, *content: int, delay_ms: int = 0) -> None:
        self._answers.append((self.node.now + delay_ms * MS, bytes((service, *content)).ljust(8, b"\0")))

    def poll(self, now: int) -> None:
        while self._answers and now >= self._answers[0][0]:
            self.node.transmit(LSS_RESPONSE, self._answers.pop(0)[1], past=self)
        if self._change_at is not None and now >= self._change_at:
            self._change_at = None
            self.node.bitrate_changed(self._rate)

    def next_event(self, now: int) -> int | None:
        times = [time for time, _ in self._answers]
        return min([*times, *(() if self._change_at is None else (self._change_at,))], default=None)

    # -- services -----------------------------------------------------------------------------------------------------

    def _serve(self, data: bytes) -> None:
        service, number = data[0], int.from_bytes(data[1:5], "little")
        if service == _Service.SWITCH_GLOBAL:
            self._switch(bool(data[1]))
        elif service in _SELECT:
            self._select(service - _Service.SELECT, number)
        elif service == _Service.FASTSCAN:
            self._scan(number, *data[5:8])
        elif service == _Service.IDENTIFY_NON_CONFIGURED:
            if self._active == self._pending == LSS_NO_NODE_ID:
                self._answer(_Service.NON_CONFIGURED)
        elif self._selected:
            self._configure(service, data)

    def _switch(self, configuration: bool) -> None:
        if configuration:
            self._selected = True
            return
        self._wait()
        if self._active == LSS_NO_NODE_ID != self._pending:
            self._active = self._pending
            self.node.renumber(self._active)

    def _select(self, place: int, number: int) -> None:
        self._matched = 0 if place == 0 else self._matched
        if self._matched == place and self._identity[place] == number:
            self._matched += 1
        if self._matched == _WORDS == place + 1:
            self._selected = True
            self._answer(_Service.SELECTED)

    def _scan(self, number: int, bit: int, place: int, following: int) -> None:
        if self._selected or not self._active == self._pending == LSS_NO_NODE_ID:
            return
        if bit == _BEGIN:
            self._place = 0
        elif place != self._place or place >= _WORDS or self._identity[place] >> bit != number >> bit:
            return
        else:
            self._place = following
            self._selected = bit == 0 and following < place
        self._answer(_Service.IDENTIFIED)

    def _configure(self, service: int, data: bytes) -> None:
        if service in _INQUIRE:
            self._answer(service, *self._identity[service - _Service.INQUIRE].to_bytes(4, "little"))
        elif service == _Service.INQUIRE_NODE_ID:
            self._answer(service, self._active)
        elif service == _Service.NODE_ID:
            allowed = data[1] in NODE_IDS or data[1] == LSS_NO_NODE_ID
            self._pending = data[1] if allowed else self._pending
            self._answer(service, _DONE if allowed else _OUT_OF_RANGE)
        elif service == _Service.BIT_TIMING:
            rates = {number: rate for rate, number in LSS_BIT_TIMINGS.items()}
            allowed = bool(self.bit_timing) and data[1] == 0 and data[2] in rates
            self._rate = rates[data[2]] if allowed else self._rate
            self._answer(service, _DONE if allowed else _NOT_SUPPORTED)
        elif service == _Service.ACTIVATE_BIT_TIMING:
            delay = int.from_bytes(data[1:3], "little") * MS
            self._change_at, self._silent_until = self.node.now + delay, self.node.now + 2 * delay
        elif service == _Service.STORE:
            if not self.store_fails:
                self._stored, self._stored_rate = self._pending, self._rate
            self._answer(service, _STORE_FAILED if self.store_fails else _DONE, delay_ms=self.store_ms)
