"""Connect, Control and Release: the calls that make, confirm and end relationships.

Source: IEC 61158-5-10/-6-10 (CMRPC, CMSM). Cyclic data counts once the controller has confirmed ApplicationReady.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final
from uuid import UUID

from pdgw.decoder.frames.bounded_dict import BoundedDict
from pdgw.decoder.frames.fields import Document
from pdgw.decoder.frames.profinet.blocks import documents, named, read_blocks
from pdgw.decoder.frames.profinet.connect import Connection, read_request
from pdgw.decoder.frames.profinet.cyclic import CyclicDecoder
from pdgw.decoder.frames.profinet.records import Change, RelationRecord
from pdgw.decoder.frames.profinet.stations import StationNames
from pdgw.decoder.frames.records import AcyclicRecord, Base
from pdgw.durations import MS
from pdgw.profinet.blocks.control import ApplicationReadyRes, ControlBlock, PrmBeginRes, ReleaseRes
from pdgw.profinet.rpc.dcerpc import RpcHeader
from pdgw.profinet.rpc.records import Operation

OPERATIONS: Final = frozenset({Operation.CONNECT, Operation.RELEASE, Operation.CONTROL})
_CHANGES: Final[dict[type[ControlBlock], Change]] = {
    ApplicationReadyRes: Change.READY,
    PrmBeginRes: Change.PAUSED,
    ReleaseRes: Change.ENDED,
}
"""Answers that change a relationship."""


class RelationCalls:
    """All relationships of a capture. ``cyclic`` decodes their frames."""

    def __init__(self, cyclic: CyclicDecoder, names: StationNames) -> None:
        self._cyclic = cyclic
        self._names = names
        self._asked: BoundedDict[tuple[UUID, int], Connection] = BoundedDict()
        self._granted: BoundedDict[UUID, Connection] = BoundedDict()

    def between(self, addresses: bytes) -> Connection | None:
        """The relationship of frames with this destination and source."""
        return next((item for item in self._granted.newest() if item.is_between(addresses)), None)

    def record(
        self,
        base: Base,
        header: RpcHeader,
        head: str,
        arguments: bytes,
        fields: Document,
        latency: int | None,
        *,
        is_request: bool,
    ) -> AcyclicRecord:
        """The record of one call with arguments; ProfidriveError when its blocks are damaged."""
        fields["blocks"] = blocks = documents(arguments)
        if header.operation == Operation.CONNECT:
            key = (header.activity, header.sequence)
            if is_request:
                connection = read_request(arguments)
                self._asked.put(key, connection)
                text = f"{head}: {_asked_text(connection, fields)}"
                if not self._cyclic.request(connection):
                    return AcyclicRecord(*base, text, fields, latency)
                return RelationRecord(*base, text, fields, latency, change=Change.REQUESTED, connection=connection)
            return self._answered(base, head, self._asked.pop(key), arguments, fields, latency)
        text = f"{head}: {named(blocks)}"
        if not is_request:
            for cls, change in _CHANGES.items():
                for block in read_blocks(arguments, cls):
                    uuid = block.ar_uuid
                    known = self._granted.pop(uuid) if change is Change.ENDED else self._granted.get(uuid)
                    if known is not None:
                        return RelationRecord(*base, text, fields, latency, change=change, connection=known)
        return AcyclicRecord(*base, text, fields, latency)

    def refuse(self, header: RpcHeader) -> None:
        """The device has rejected a call."""
        connection = self._asked.pop((header.activity, header.sequence))
        if connection is not None:
            self._cyclic.end_request(connection)

    def _answered(
        self,
        base: Base,
        head: str,
        asked: Connection | None,
        arguments: bytes,
        fields: Document,
        latency: int | None,
    ) -> AcyclicRecord:
        if asked is None:
            return AcyclicRecord(*base, f"{head}: request missing", fields, latency)
        connection = asked.answered(arguments)
        if connection.device_mac is not None:
            if connection.station:
                self._names.learn(connection.device_mac, connection.station)
            connection = replace(connection, station=self._names.of(connection.device_mac))
        if connection.ar is not None:
            self._names.learn(connection.ar.initiator_mac, connection.controller)
        text = f"{head}: {_asked_text(connection, fields)}"
        if not self._cyclic.connect(connection) or connection.ar is None:
            return AcyclicRecord(*base, text, fields, latency)
        self._granted.put(connection.ar.ar_uuid, connection)
        return RelationRecord(*base, text, fields, latency, change=Change.GRANTED, connection=connection)


def _asked_text(connection: Connection, fields: Document) -> str:
    """The request or response in one line; ``fields`` gets the relationships."""
    fields["relations"] = [
        {"direction": direction.value, "frame_id": plan.frame_id, "submodules": len(plan.data)}
        for direction, plan in connection.relations
    ]
    parts = [f"{direction.value}s FrameID {plan.frame_id:04X}h" for direction, plan in connection.relations]
    if not parts:
        parts.append("no cyclic relationship")
    else:
        block = connection.relations[0][1].block
        parts.append(f"cycle {block.cycle_ns / MS:g} ms, data hold {block.hold_ns / MS:g} ms")
    if connection.controller:
        parts.append(f"controller {connection.controller}")
    if connection.station:
        parts.append(f"device {connection.station}")
    return ", ".join(parts)
