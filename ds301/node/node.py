"""A node for its owner: settings, status, events, and the newest data of its TPDOs.

Source: CiA DS 301 (heartbeat, EMCY, PDO).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from pdgw.base.durations import MS
from pdgw.base.errors import ValueNotAllowedError
from pdgw.ds301.node.doubles import Jumps, SecondTpdos
from pdgw.ds301.pdo import Pdo, PdoReceiver
from pdgw.ds301.values import DeviceValues


class NodeStatus(enum.Enum):
    """Steps of a node towards operation."""

    OFFLINE = "offline"
    """Not seen yet, or stopped by us."""
    CONFIGURING = "configuring"
    ONLINE = "online"
    LOST = "lost"
    """Was online; heartbeat or TPDO stopped, or the bus failed. Re-configures by itself, never restarts motion."""
    REFUSED = "refused"
    """Answers, but is the wrong device or does not take the configuration; retried slowly."""


class Cause(NamedTuple):
    """Why a node is not in operation: what was seen, and what to do. An empty remedy: nothing can be advised."""

    evidence: str
    remedy: str = ""

    @classmethod
    def of(cls, error: ValueNotAllowedError) -> Cause:
        """That of an error."""
        return cls(error.evidence, error.remedy)

    @property
    def text(self) -> str:
        """Both in one line."""
        return self.evidence + (self.remedy and f"; {self.remedy}")


class Loss(enum.Enum):
    """Who ended the operation of a node that was online, if it was not the node itself."""

    OWN_STOP = "NMT stop by its owner"
    OTHER_MASTER = "NMT command of another master"
    OTHER_TOOL = "SDO write of another tool"


class Lost(NamedTuple):
    """Why a node that was online is lost, and by whom. ``by`` None: by the node itself, or by its bus."""

    cause: Cause
    by: Loss | None = None


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Choices for one node; times in milliseconds."""

    node_id: int
    eds: Path | None = None
    """A user's EDS/DCF; None takes the one in the package."""
    heartbeat_ms: int = 100
    """Producer time of both sides; consumers expire after ``heartbeat_factor`` times that."""
    heartbeat_factor: int = 3
    tpdo_event_ms: int = 50
    tpdo_inhibit_us: int = 0
    tpdo_timeout_factor: int = 4
    sdo_timeout_ms: int = 500
    sync: bool = False
    """TPDOs on SYNC (type 1) instead of event-driven."""
    sync_period_us: int = 0
    """RPDOs use SYNC with this period (1006h), too; 0: they take effect on arrival."""
    cycle_ms: int = 0
    """Time between two SYNC of the gateway."""
    values: DeviceValues = field(default_factory=DeviceValues)
    """What its objects must have at each bring-up."""

    @property
    def heartbeat_limit_ns(self) -> int:
        """Longest time between two heartbeats of a node that is there."""
        return self.heartbeat_ms * self.heartbeat_factor * MS

    @property
    def tpdo_limit_ns(self) -> int:
        """The same of event-driven TPDOs; a TPDO on SYNC may have a longer one."""
        return self.tpdo_event_ms * self.tpdo_timeout_factor * MS


class Notice(enum.Enum):
    """What has happened to a node. Recordings have the names."""

    EMERGENCY = "EMCY"
    BOOT = "boot-up during operation"
    REFUSED = "wrong device or configuration"
    TWO_DEVICES = "two devices with its node-ID"
    SET_POINT_REFUSED = "data of a setpoint rejected"
    LOST = "lost after it was online"
    BUS_LOST = "CAN bus lost"
    OFF = "without power before it was configured"
    UNITS_CHANGED = "an object that defines its units has changed"
    UNITS_READ = "its units were read again"
    ONLINE = "in operation"
    ABSENT = "does not answer"
    PROGRESS = "anything else"


@dataclass(frozen=True, slots=True)
class NodeNotice:
    """One event of a node, made where it happens; ``time_ns`` is monotonic.

    ``code``, ``register`` and ``data`` (the manufacturer's bytes) are those of an EMCY. ``by``: who caused a loss or a boot-up;
    None: the node itself. ``remedy``: what to do.
    """

    notice: Notice
    text: str
    time_ns: int
    code: int = 0
    register: int = 0
    data: bytes = b""
    by: Loss | None = None
    remedy: str = ""


class TpdoSlot(PdoReceiver):
    """The newest frame of one TPDO and the image its values go to, in the next cycle."""

    def __init__(self, pdo: Pdo, image: object, cob_id: int, *, watched: bool) -> None:
        self.pdo = pdo
        self.image = image
        self.cob_id = cob_id
        self.watched = watched
        """Silence is a loss."""
        self.data: bytes | None = None
        self.compared = False
        """``changed`` is still in use, which takes longer than all else of a frame."""
        self.changed = 0
        """Bits that differed between two frames, little-endian."""
        self.taken: bytes | None = None
        self.time = 0
        self.second: SecondTpdos | None = None
        """Of a TPDO that one device sends once for each SYNC."""
        self.jumps: Jumps | None = None
        """Of its position, while it is examined whether two devices send it."""
        self.errors = 0
        self.short: int | None = None
        """Bytes of the last frame that was shorter than the mapping."""

    def receive(self, data: bytes, now: int) -> None:
        """A frame of the TPDO. One shorter than the mapping is not a sign of life: its values would be kept permanently."""
        if len(data) < self.pdo.size:
            self.errors += 1
            self.short = len(data)
            return
        before, self.data = self.data, data
        if before is not None and data != before:
            if self.compared:
                self.changed |= int.from_bytes(data, "little") ^ int.from_bytes(before, "little")
            if self.jumps is not None:
                self.jumps.see(data, now)
        self.time = now
