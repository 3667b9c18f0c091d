"""Connect requests: their blocks, who sends them, and changes to them."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from uuid import UUID

from pdgw.peers.controller.project import Project
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import Flags, PacketType, RpcHeader
from pdgw.profinet.rpc.records import Operation, PnioStatus, decode_arguments, encode_arguments
from pdgw.profinet.wire import Block
from tests.support.wire.profinet import PLC_IP, PLC_MAC, Wire, project

AR_UUID = UUID(int=0xABC)
INITIATOR = dcerpc.object_uuid(1, 1, 1)
SOURCE = (PLC_IP, 50_000)
AXIS_SUBSLOTS = [(0, 1), (0, 0x8000), (0, 0x8001), (1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)]


class Caller:
    """Sends Connect requests to a device."""

    def __init__(self, wire: Wire | None = None, source: tuple[str, int] = SOURCE) -> None:
        self.wire = wire or Wire()
        self.source = source
        self.sequence = 0
        self.activity = UUID(int=zlib.crc32(source[0].encode()))
        self.addressed: list[object] = []
        """Whom the device sent something to in the last call."""

    def call(
        self, arguments: bytes, operation: int = Operation.CONNECT, maximum: int = 16_384, little: bool = True
    ) -> tuple[PnioStatus, bytes]:
        device_object = dcerpc.object_uuid(1, 0x0402, 0xFFFF)
        header = RpcHeader(
            PacketType.REQUEST,
            device_object,
            self.activity,
            self.sequence,
            operation,
            flags=Flags.IDEMPOTENT,
            little_endian=little,
        )
        self.sequence += 1
        ndr = encode_arguments(maximum, arguments, max(maximum, len(arguments)), little=little)
        before = self.wire.device.outgoing()
        assert not before
        reassembly = dcerpc.Reassembly(1 << 16)
        whole = None
        for packet in dcerpc.encode_fragments(header, ndr):
            self.wire.device.on_datagram(packet, self.source, self.wire.now)
        sent = self.wire.device.outgoing()
        self.addressed = [address for address, _ in sent]
        for address, data in sent:
            if address == self.source:
                answer, body = dcerpc.decode_packet(bytes(data))
                assert answer.packet_type is PacketType.RESPONSE
                whole = reassembly.add(answer, body)
        assert whole is not None
        status, answered = decode_arguments(whole, little=little)
        return PnioStatus.of(status), answered

    def connect(self, blocks: list[Block]) -> tuple[PnioStatus, bytes]:
        return self.call(b"".join(block.encode() for block in blocks))


def blocks(of_project: Project | None = None) -> list[Block]:
    chosen = of_project or project()
    return chosen.blocks(chosen.ar(AR_UUID, 1, PLC_MAC, INITIATOR, "plc-1"))


Change = Callable[[list[Block]], list[Block]]


def change(kind: type[Block], index: int = 0, **values: Any) -> Change:
    """Replace fields of the n-th block of a kind."""

    def apply(items: list[Block]) -> list[Block]:
        place = [number for number, item in enumerate(items) if isinstance(item, kind)][index]
        items[place] = replace(items[place], **values)  # type: ignore[type-var]
        return items

    return apply
