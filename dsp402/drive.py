"""The drive client: brings one CiA 402 drive into operation on a bus and keeps watching it.

The cyclic side (``refresh``, ``send``) never blocks; identity check, PDO configuration, references and user SDO jobs
run on the drive's own worker thread.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ds301.network import CanNetwork
from dsp402.images import DriveCommand, DriveFeedback, References
from dsp402.modes import Mode
from dsp402.pdo import PdoLayout

T = TypeVar("T")


class DriveStatus(enum.Enum):
    """Where the drive is on its way to operation."""

    OFFLINE = "offline"
    """Not seen yet, or stopped by us."""
    CONFIGURING = "configuring"
    ONLINE = "online"
    LOST = "lost"
    """Was online; heartbeat or TPDO stopped, or the bus failed. Re-configures by itself, never restarts motion."""
    REFUSED = "refused"
    """Answers, but is the wrong device or does not take the configuration; retried slowly."""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """Choices for one drive; times in milliseconds."""

    node_id: int
    eds: Path | None = None
    """A user's EDS/DCF; None takes the one in the package."""
    gateway_node_id: int = 127
    heartbeat_ms: int = 100
    """Producer time of both sides; consumers expire after ``heartbeat_factor`` times that."""
    heartbeat_factor: int = 3
    tpdo_event_ms: int = 50
    tpdo_inhibit_us: int = 0
    tpdo_timeout_factor: int = 4
    rpdo_refresh_ms: int = 100
    sdo_timeout_ms: int = 500
    sync: bool = False
    """TPDOs on SYNC (type 1) instead of event-driven (255)."""
    abort_option: int = 3
    """6007h, when the gateway's heartbeat stops: 0 nothing, 1 malfunction, 2 disable voltage, 3 quick stop."""
    allow_unguarded: bool = False
    """Operate a drive that refuses 1016h or 6007h."""
    initial_mode: Mode | None = None
    """6060h to set and confirm (6061h) while configuring, for layouts that do not carry 6060h."""


@dataclass(frozen=True, slots=True)
class DriveEvent:
    """Something the axis must know: ``kind`` is one of status, emcy, boot, refused.

    For ``emcy``: ``code`` the error code, ``register`` the error register, ``data`` the manufacturer bytes.
    """

    kind: str
    text: str
    code: int = 0
    register: int = 0
    data: bytes = b""
    time_ns: int = 0


class DriveClient:
    """One drive. ``on_event`` is called from the worker or reader thread and must only queue."""

    def __init__(
        self,
        network: CanNetwork,
        settings: DriveSettings,
        layout: PdoLayout,
        on_event: Callable[[DriveEvent], None],
    ) -> None:
        self.network = network
        self.settings = settings
        self.layout = layout
        self.on_event = on_event
        self.status = DriveStatus.OFFLINE
        self.status_text = ""
        self.feedback = DriveFeedback()
        self.references: References | None = None
        self.homing_method = 0
        self.generation = 0
        """Counts completed configurations, so that the axis sees each restart exactly once."""

    def start(self) -> None:
        """Start the worker: waits for the drive, checks identity, configures, goes operational, supervises."""
        raise NotImplementedError

    def refresh(self, now: int) -> bool:
        """Cyclic: take the newest TPDO data into ``feedback``; True when online and no TPDO is overdue."""
        raise NotImplementedError

    def send(self, command: DriveCommand, now: int) -> None:
        """Cyclic: send the RPDOs that changed or are due for refresh, data first, RPDO 1 (Controlword) last."""
        raise NotImplementedError

    def submit(self, job: Callable[[DriveClient], T]) -> Future[T]:
        """Run a job with SDO access on the worker thread; never delays the cyclic side."""
        raise NotImplementedError

    def read(self, index: int, subindex: int = 0) -> bytes:
        """SDO upload, on the worker thread only; raises canopen's SdoAbortedError / SdoCommunicationError."""
        raise NotImplementedError

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """SDO download, on the worker thread only."""
        raise NotImplementedError

    def read_references(self) -> References:
        """Read the reference objects again (worker thread) and keep them in ``references``."""
        raise NotImplementedError

    def reconfigure(self, layout: PdoLayout, settings: DriveSettings) -> None:
        """Another telegram: map the PDOs anew; the drive must not be in operation."""
        raise NotImplementedError

    def stop(self) -> None:
        """NMT pre-operational and end of the worker. The axis has stopped the drive before."""
        raise NotImplementedError
