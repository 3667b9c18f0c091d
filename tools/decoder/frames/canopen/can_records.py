"""Records of the CAN side without I/O: PDOs, SDO transfers and the other CANopen services."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pdgw.tools.decoder.frames.fields import Document, Raw
from pdgw.tools.decoder.frames.records import BusKind, ProcessData, ProcessDataLayout, Record


@dataclass(slots=True)
class CanRecord(Record):
    """A CAN frame that no CANopen service claims; base of all others."""

    kind: ClassVar[str] = "can"

    cob_id: int
    node: int = 0
    """The node the COB-ID belongs to; 0 for none."""
    text: str = ""

    @property
    def bus(self) -> BusKind:
        return BusKind.CAN

    @property
    def stream(self) -> object:
        return (self.channel, self.cob_id)

    @property
    def summary(self) -> str:
        return self.text

    def details(self) -> Document:
        return {"cob_id": self.cob_id, "node": self.node, "text": self.text, "data": self.data.hex()}


@dataclass(frozen=True, eq=False)
class PdoLayout:
    """The mapping of one PDO in force: its name, its fields, and its source."""

    name: str
    node: int
    axis: int
    unit: ProcessDataLayout
    size: int
    origin: str
    struct: struct.Struct | None
    """None where an object is not a whole standard type: then ``cuts`` (bits, signed, shown) cut the bits."""
    cuts: tuple[tuple[int, bool, bool], ...] = ()
    addresses: tuple[tuple[int, int], ...] = ()
    """Index and sub-index of each value."""

    def unpack(self, data: bytes) -> tuple[Raw, ...]:
        """The values; ``data`` is at least ``size`` long."""
        if self.struct is not None:
            return self.struct.unpack_from(data)
        number = int.from_bytes(data[: self.size], "little")
        values = []
        for width, signed, shown in self.cuts:
            value = number & ((1 << width) - 1)
            number >>= width
            if shown:
                values.append(value - (1 << width) if signed and value >> (width - 1) else value)
        return tuple(values)


@dataclass(slots=True)
class PdoRecord(CanRecord):
    """A PDO whose mapping is known."""

    kind: ClassVar[str] = "pdo"

    layout: PdoLayout = field(kw_only=True)

    @property
    def units(self) -> tuple[ProcessData, ...]:
        layout = self.layout
        return (ProcessData(layout.axis, layout.node, layout.unit, layout.unpack(self.data)),)

    @property
    def summary(self) -> str:
        return self.layout.name

    def details(self) -> Document:
        return {"cob_id": self.cob_id, "node": self.node, "pdo": self.layout.name, "mapping": self.layout.origin}


@dataclass(slots=True)
class NmtRecord(CanRecord):
    """An NMT command; ``node`` 0 means all nodes."""

    kind: ClassVar[str] = "nmt"

    command: int = field(kw_only=True)

    def details(self) -> Document:
        return {"cob_id": self.cob_id, "node": self.node, "command": self.command, "text": self.text}


@dataclass(slots=True)
class SyncRecord(CanRecord):
    """SYNC, with its counter where the producer sends one."""

    kind: ClassVar[str] = "sync"

    counter: int | None = field(kw_only=True, default=None)

    def details(self) -> Document:
        return {"cob_id": self.cob_id, "counter": self.counter}


@dataclass(slots=True)
class TimeRecord(CanRecord):
    """TIME: milliseconds after midnight and days since 1 January 1984."""

    kind: ClassVar[str] = "time"

    milliseconds: int = field(kw_only=True)
    days: int = field(kw_only=True)

    def details(self) -> Document:
        return {"cob_id": self.cob_id, "milliseconds": self.milliseconds, "days": self.days, "text": self.text}


@dataclass(slots=True)
class EmcyRecord(CanRecord):
    """An emergency: error code, error register and the manufacturer's bytes."""

    kind: ClassVar[str] = "emcy"

    code: int = field(kw_only=True)
    register: int = field(kw_only=True)
    manufacturer: bytes = field(kw_only=True)

    def details(self) -> Document:
        return {
            "cob_id": self.cob_id,
            "node": self.node,
            "code": self.code,
            "register": self.register,
            "manufacturer": self.manufacturer.hex(),
            "text": self.text,
        }


@dataclass(slots=True)
class HeartbeatRecord(CanRecord):
    """Heartbeat, boot-up or node guarding answer; ``previous`` is the state last seen (None: the first)."""

    kind: ClassVar[str] = "heartbeat"

    state: int = field(kw_only=True)
    previous: int | None = field(kw_only=True)

    @property
    def changed(self) -> bool:
        return self.state != self.previous

    def details(self) -> Document:
        return {
            "cob_id": self.cob_id,
            "node": self.node,
            "state": self.state,
            "previous": self.previous,
            "text": self.text,
        }


@dataclass(slots=True)
class SdoRecord(CanRecord):
    """One frame of an SDO transfer.

    ``step`` is its place in the transfer (``SdoStep``); ``index``/``subindex`` are those of the transfer, None if its start
    was not seen. ``value`` (complete bytes) and ``decoded`` are in the frame that completes the transfer; ``abort`` is in an
    abort. ``latency_ns`` of a server's frame is the time since the client's last frame.
    """

    kind: ClassVar[str] = "sdo"

    step: str = field(kw_only=True)
    from_client: bool = field(kw_only=True)
    index: int | None = field(kw_only=True, default=None)
    subindex: int | None = field(kw_only=True, default=None)
    name: str = field(kw_only=True, default="")
    value: bytes | None = field(kw_only=True, default=None)
    decoded: Any = field(kw_only=True, default=None)
    abort: int | None = field(kw_only=True, default=None)
    latency_ns: int | None = field(kw_only=True, default=None)

    def details(self) -> Document:
        return {
            "cob_id": self.cob_id,
            "node": self.node,
            "step": self.step,
            "from_client": self.from_client,
            "index": self.index,
            "subindex": self.subindex,
            "name": self.name,
            "value": None if self.value is None else self.value.hex(),
            "decoded": self.decoded.hex() if isinstance(self.decoded, bytes) else self.decoded,
            "abort": self.abort,
            "latency_ns": self.latency_ns,
            "text": self.text,
        }
