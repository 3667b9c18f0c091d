"""Why frames of a relationship over UDP do not count, with what to do. Source: docs/plc.md "Frames over UDP"."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.base.udp import Address
from pdgw.gateway.links.new_frames import NewFrames, Verdict
from pdgw.profidrive.frame import C_SDU_MIN, HEADER, STATUS_NORMAL, TRAILER, CSduLayout
from pdgw.profidrive.telegrams import Telegram

STATUS_OFFSET: Final = 2
"""DataStatus follows the CycleCounter."""


class Refusals:
    """The texts of one layout of frames. ``header``: the FrameID of the PLC's frames; ``fixed_peer``: the configured PLC."""

    def __init__(
        self,
        consumer: CSduLayout,
        provider: CSduLayout,
        telegrams: Sequence[Telegram],
        header: bytes,
        new_frames: NewFrames,
        fixed_peer: str | None,
    ) -> None:
        self._consumer = consumer
        self._provider = provider
        self._telegrams = tuple(item.number for item in telegrams)
        self._header = header
        self._new_frames = new_frames
        self._fixed_peer = fixed_peer

    def why(self, verdict: Verdict, source: Address, data: bytes, peer: Address | None) -> Finding:
        """Why a frame does not count. ``peer``: the PLC."""
        frames = "frames of {}:{} do not count".format(*source)
        new_frames, place = self._new_frames, self._consumer.tick
        match verdict:
            case Verdict.FOREIGN_SENDER:
                return self._of_other(source, peer)
            case Verdict.NO_TICK:
                return Finding.of(Reason.FRAME_TICK, f"{frames}: without a tick of this gateway", self._copy_tick)
            case Verdict.TOO_OLD:
                limit_ns = new_frames.age_limit_ns or 0
                age = f"{new_frames.refused_age_ns / MS:.0f} ms old, limit {limit_ns / MS:g} ms"
                return Finding.of(Reason.FRAME_OLD, f"{frames}: they are {age}")
            case Verdict.STALE:
                return Finding.of(Reason.FRAME_COUNTER, f"{frames}: their cycle counter does not increase")
            case Verdict.WRONG_TELEGRAM:
                byte = next(at for at in range(HEADER.size + self._consumer.used, place) if data[at])
                text = f"{frames}: byte {byte} is not 0, and the last object ends before it; {self.expected}"
                return Finding.of(Reason.FRAME_LAYOUT, text)
            case Verdict.WRONG_FRAME_ID:
                text = f"{frames}: FrameID {data[: HEADER.size].hex().upper()}h, expected {self._header.hex().upper()}h"
                return Finding.of(Reason.FRAME_INVALID, text)
            case Verdict.NOT_VALID | Verdict.NOT_PRIMARY:
                status = data[self._consumer.trailer + STATUS_OFFSET]
                bit = "bit 2 (data valid)" if verdict is Verdict.NOT_VALID else "bit 0 (primary)"
                text = f"{frames}: DataStatus {status:02X}h, {bit} is 0, expected {STATUS_NORMAL:02X}h"
                return Finding.of(Reason.FRAME_INVALID, text)
            case _:
                text = f"{frames}: {len(data)} bytes; {self.expected}"
                without_tick = HEADER.size + max(C_SDU_MIN, self._consumer.used) + TRAILER.size
                if len(data) == without_tick != self._consumer.frame_size:
                    return Finding.of(Reason.FRAME_TICK, f"{text}, this is the layout without a tick", self._copy_tick)
                return Finding.of(Reason.FRAME_LAYOUT, text)

    def _of_other(self, sender: Address, peer: Address | None) -> Finding:
        plc = self._fixed_peer if peer is None else "{}:{}".format(*peer)
        host, port = sender
        remedy = Reason.OTHER_SENDER.remedy
        if self._fixed_peer not in (None, host):
            remedy += (f'if {host} is the PLC, set peer = "{host}"',)
        return Finding(Reason.OTHER_SENDER, f"frames of {host}:{port} do not count: the PLC is {plc}", remedy)

    @property
    def expected(self) -> str:
        """The size of the PLC's frames."""
        return f"expected: {self._consumer.frame_size} bytes for telegrams {', '.join(map(str, self._telegrams))}"

    @property
    def _copy_tick(self) -> str:
        of_gateway, place = self._provider.tick, self._consumer.tick
        return (
            f"the PLC must receive the gateway's frames and copy bytes {of_gateway} to {of_gateway + 3} of the newest one to "
            f"bytes {place} to {place + 3} of its own, before the cycle counter (docs/plc.md)"
        )
