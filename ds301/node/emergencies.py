"""The EMCY of one node: its last one, and the COB-ID from which it comes (CiA DS 301 V4.02 chapter 7.2.7)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import EMCY, EMCY_COB_ID
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.ds301.node.sdo import SdoAccess

SHORTEST_EMCY: Final = 3
"""Bytes of an EMCY of a device that sends only error code and error register."""


class Emergencies:
    """``text_of`` has the text of an error code; ``on_event`` is called with each EMCY."""

    def __init__(
        self, network: CanNetwork, node_id: int, text_of: Callable[[int], str], on_event: Callable[[NodeNotice], None]
    ) -> None:
        self._network = network
        self._usual = EMCY + node_id
        self._text_of = text_of
        self._on_event = on_event
        self.on_frame: Callable[[bytes], None] = lambda _: None
        """Called with each frame first, also with one that is too short."""
        self._moved = 0
        """COB-ID if 1014h has another one than usual, else 0."""
        self._last = ("", 0)
        """Text and time of the last one; the end of errors replaces an error after a second."""

    def open(self) -> None:
        """Receive the EMCY of the node."""
        self._network.subscribe(self._usual, self._receive)

    def close(self) -> None:
        """The end of ``open``."""
        self._network.unsubscribe(self._usual, self._receive)
        self._move(0)

    def find(self, sdo: SdoAccess) -> None:
        """In the node's task: also take the EMCY from the COB-ID in 1014h, unless other frames have it."""
        cob_id = 0
        with suppress(SdoAbortedError):
            cob_id = sdo.read_number(EMCY_COB_ID)
        if cob_id != self._moved:
            self._move(cob_id)

    def _move(self, cob_id: int) -> None:
        network = self._network
        if self._moved:
            network.unsubscribe(self._moved, self._receive)
        moved = EMCY < cob_id <= STANDARD_ID and not network.is_subscribed(cob_id)
        self._moved = cob_id if moved else 0
        if moved:
            network.subscribe(cob_id, self._receive)

    def after(self, since: int) -> str:
        """The last EMCY as the text of a cause; empty if there was none after this time."""
        text, time = self._last
        return f" after {text}" if time > since else ""

    def _receive(self, data: bytes, now: int) -> None:
        self.on_frame(data)
        if len(data) < SHORTEST_EMCY:
            return
        code = int.from_bytes(data[:2], "little")
        text = f"EMCY {code:04X}h {self._text_of(code)}"
        if code or not self.after(now - SECOND):
            self._last = text, now
        self._on_event(NodeNotice(Notice.EMERGENCY, text, now, code, data[2], data[3:]))
