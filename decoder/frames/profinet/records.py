"""Records of PROFINET beside cyclic frames and parameters: relationships that come and go, DCP, LLDP, alarms."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import ClassVar

from pdgw.decoder.frames.profinet.connect import Connection
from pdgw.decoder.frames.records import AcyclicRecord


class Change(enum.Enum):
    """Changes of a relationship."""

    REQUESTED = "requested"
    GRANTED = "granted"
    READY = "confirmed: cyclic data is valid"
    PAUSED = "parameterised again: cyclic data is not valid"
    ENDED = "ended"


@dataclass(slots=True)
class RelationRecord(AcyclicRecord):
    """A call that changes a relationship of the station that is read, where its Connect was seen."""

    change: Change = field(kw_only=True)
    connection: Connection = field(kw_only=True)


@dataclass(slots=True)
class StationRecord(AcyclicRecord):
    """A frame of the station itself, no call. ``kind`` is that of the protocol."""


@dataclass(slots=True)
class DcpRecord(StationRecord):
    """Discovery and configuration: stations, names and addresses."""

    kind: ClassVar[str] = "dcp"


@dataclass(slots=True)
class LldpRecord(StationRecord):
    """Name of the LLDP neighbour."""

    kind: ClassVar[str] = "lldp"


@dataclass(slots=True)
class AlarmRecord(StationRecord):
    """A PDU of an alarm relationship."""

    kind: ClassVar[str] = "alarm"

    slot: int = field(kw_only=True, default=0)
    """Slot of the submodule in a notification; 0 in others and for the device itself."""
    is_notification: bool = field(kw_only=True, default=False)
    """Whether it is a notification and not an acknowledgement."""
    ended: Connection | None = field(kw_only=True, default=None)
    """The relationship an ERR ends, where its Connect was seen."""
