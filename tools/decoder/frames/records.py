"""The packet model: the content of one packet as typed records without I/O; here the PLC side, in ``can_records`` the CAN
side.

There is one ``Record`` for every packet, in capture order. Times are nanoseconds of the capture's own clock. Process data is
in ``units``: one ``ProcessData`` for each axis of a cyclic frame, one for a PDO. It is unpacked on first use, so an unused
record costs little. ``document`` makes plain data of a record (docs/recordings.md).
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

from pdgw.base.durations import MS
from pdgw.profidrive.frame import STATUS_DATA_VALID, STATUS_NO_PROBLEM, STATUS_PRIMARY, STATUS_RUN, TICK
from pdgw.profidrive.parameters.codec import Request, Response
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.frames.fields import Document, Field, Raw

DATA_STATUS_BITS = {
    "primary": STATUS_PRIMARY,
    "data_valid": STATUS_DATA_VALID,
    "run": STATUS_RUN,
    "no_problem": STATUS_NO_PROBLEM,
}
"""Bits of DataStatus by their names in documents."""


class BusKind(enum.StrEnum):
    """Which side of the gateway a packet was seen on."""

    PLC = "plc"
    CAN = "can"


class LinkType(enum.IntEnum):
    """Format of the first bytes of a packet; the numbers are the link types of pcap files (LINKTYPE_...)."""

    NULL = 0
    ETHERNET = 1
    RAW_IP = 101
    LOOP = 108
    LINUX_SLL = 113
    CAN_SOCKETCAN = 227
    IPV4 = 228
    IPV6 = 229
    LINUX_SLL2 = 276


@dataclass(frozen=True, eq=False)
class ProcessDataLayout:
    """The fields of a data unit, in order. ``telegram`` and ``direction`` exist only on the PLC's side."""

    fields: tuple[Field, ...]
    telegram: int = 0
    direction: Direction | None = None

    @cached_property
    def positions(self) -> dict[str, int]:
        """Position of each field by its identifier."""
        return {item.identifier: position for position, item in enumerate(self.fields)}


@dataclass(slots=True)
class ProcessData:
    """The process data of one axis in one packet.

    ``axis`` is its place in the frame or its DO-ID (0 unknown), ``node`` its CANopen node-ID (0 unknown); ``iops`` and
    ``iocs`` are None on CAN.
    """

    axis: int
    node: int
    layout: ProcessDataLayout
    values: tuple[Raw, ...]
    iops: int | None = None
    iocs: int | None = None

    def raw(self, name: str) -> Raw | None:
        """The raw value of a field by name or identifier; None where the unit has none."""
        position = self.layout.positions.get(name)
        if position is None:
            position = next((i for i, item in enumerate(self.layout.fields) if item.name == name), None)
        return None if position is None else self.values[position]

    def items(self) -> Iterator[tuple[Field, Raw]]:
        """Fields with their raw values."""
        return zip(self.layout.fields, self.values, strict=True)

    def document(self) -> Document:
        document: Document = {"axis": self.axis, "node": self.node}
        if self.layout.direction is not None:
            document |= {"telegram": self.layout.telegram, "direction": self.layout.direction.value}
        if self.iops is not None:
            document |= {"iops": self.iops, "iocs": self.iocs}
        document["signals"] = {item.name: item.document(raw) for item, raw in self.items()}
        return document


Base = tuple[int, int, str, bytes]
"""Number, time, channel and bytes of a packet."""


@dataclass(slots=True)
class Record:
    """One packet. ``data`` are its bytes on its bus: RT frame, UDP payload, CAN data."""

    kind: ClassVar[str] = "other"

    number: int
    """Counted from 1 in the source."""
    time_ns: int
    channel: str
    """The interface it was recorded from, as the source names it."""
    data: bytes

    @property
    def bus(self) -> BusKind:
        return BusKind.PLC

    @property
    def units(self) -> tuple[ProcessData, ...]:
        return ()

    @property
    def stream(self) -> object:
        """Packets of one stream repeat each other: same bus, same identifier."""
        return self.kind

    @property
    def summary(self) -> str:
        """Further information besides the units, in one line."""
        return ""

    def details(self) -> Document:
        """The kind's own fields as plain data."""
        return {}

    def document(self, units: tuple[ProcessData, ...] | None = None) -> Document:
        """The record as plain data; ``units`` replaces the own ones (a selection of them)."""
        return {
            "number": self.number,
            "time_ns": self.time_ns,
            "bus": self.bus.value,
            "channel": self.channel,
            "kind": self.kind,
            **self.details(),
            "units": [unit.document() for unit in (self.units if units is None else units)],
        }


# -- the PLC's side ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FrameLayout:
    """The places of all values in a cyclic frame of one length: one struct for the whole frame.

    ``axes`` are (axis, node, layout, first value, position of IOPS, position of IOCS); positions count unpacked values.
    """

    struct: struct.Struct
    direction: Direction | None
    axes: tuple[tuple[int, int, ProcessDataLayout, int, int, int], ...] = ()
    note: str = ""
    tick: int = 0
    """Offset of the tick in the frame; 0: it has none."""


@dataclass(slots=True)
class CyclicRecord(Record):
    """A cyclic RT frame."""

    kind: ClassVar[str] = "frame"

    layout: FrameLayout
    values: tuple[int, ...]
    """FrameID, values, IOPS and IOCS as ``layout`` says, CycleCounter, DataStatus, TransferStatus."""
    age_ns: int | None = None
    """Of a PLC's frame: time since the gateway's frame with the same tick. It is the round trip if captured at the gateway."""

    @property
    def tick(self) -> int:
        """The gateway's clock (31.25 us), which the PLC copies; 0: none."""
        place = self.layout.tick
        return TICK.unpack_from(self.data, place)[0] if place else 0

    @property
    def frame_id(self) -> int:
        return self.values[0]

    @property
    def cycle_counter(self) -> int:
        return self.values[-3]

    @property
    def data_status(self) -> int:
        return self.values[-2]

    @property
    def transfer_status(self) -> int:
        return self.values[-1]

    @property
    def direction(self) -> Direction | None:
        return self.layout.direction

    @property
    def units(self) -> tuple[ProcessData, ...]:
        values = self.values
        return tuple(
            ProcessData(axis, node, unit, values[first:iops], values[iops], values[iocs])
            for axis, node, unit, first, iops, iocs in self.layout.axes
        )

    @property
    def stream(self) -> object:
        return self.values[0]

    @property
    def wrong(self) -> list[str]:
        """Bits of DataStatus that a normal frame has and this one lacks."""
        return [name for name, mask in DATA_STATUS_BITS.items() if not self.data_status & mask]

    @property
    def summary(self) -> str:
        text = f"FrameID {self.frame_id:04X}h counter {self.cycle_counter} status {self.data_status:02X}h"
        if self.wrong:
            text += f" (not {', '.join(self.wrong)})"
        if self.tick:
            text += f" tick {self.tick}"
        if self.age_ns is not None:
            text += f" age {self.age_ns / MS:.1f} ms"
        if self.transfer_status:
            text += f" transfer status {self.transfer_status:02X}h"
        if not self.layout.axes and self.layout.note:
            text += f" ({self.layout.note})"
        return text

    def details(self) -> Document:
        ticks = {"tick": self.tick, "age_ns": self.age_ns} if self.tick else {}
        return {
            "frame_id": self.frame_id,
            "cycle_counter": self.cycle_counter,
            "data_status": {"raw": self.data_status}
            | {name: bool(self.data_status & mask) for name, mask in DATA_STATUS_BITS.items()},
            "transfer_status": self.transfer_status,
            **ticks,
            "direction": self.direction.value if self.direction else None,
        }


@dataclass(slots=True)
class AcyclicRecord(Record):
    """A DCE/RPC packet of PROFINET IO. ``fields`` are those of its headers as plain data."""

    kind: ClassVar[str] = "rpc"

    text: str
    fields: Document
    latency_ns: int | None = None
    """Time from the request to this answer, if the request was captured."""

    @property
    def summary(self) -> str:
        after = f" after {self.latency_ns / MS:.3f} ms" if self.latency_ns is not None else ""
        return self.text + after

    def details(self) -> Document:
        return {**self.fields, "latency_ns": self.latency_ns, "text": self.text}


@dataclass(slots=True)
class ParameterRequestRecord(AcyclicRecord):
    """A write of a record that carries a parameter request."""

    kind: ClassVar[str] = "parameter-request"

    request: Request = field(kw_only=True)

    @property
    def axis(self) -> int:
        """The DO-ID."""
        return self.request.do_id


@dataclass(slots=True)
class ParameterResponseRecord(AcyclicRecord):
    """A record read with a parameter response. ``request``: the request, if it was captured.

    ``latency_ns`` counts from the write of the request.
    """

    kind: ClassVar[str] = "parameter-response"

    response: Response = field(kw_only=True)
    request: Request | None = field(kw_only=True, default=None)

    @property
    def axis(self) -> int:
        """The DO-ID."""
        return self.response.do_id


@dataclass(slots=True)
class OtherRecord(Record):
    """A packet of the PLC's side that is unknown or contradicts itself. ``text`` names what and why."""

    text: str = ""

    @property
    def summary(self) -> str:
        return self.text

    def details(self) -> Document:
        return {"text": self.text, "data": self.data.hex()}
