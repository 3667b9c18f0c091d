"""What goes into a step of an axis beside the cyclic data, and what comes out beside the actual values: plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from pdgw.ds301.node.node import NodeNotice
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.drive_type import DriveType
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, By, FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason


@dataclass(frozen=True, slots=True)
class SdoWrite:
    """A value that the device must accept by SDO before the machine continues."""

    index: int
    subindex: int
    value: int


@dataclass(frozen=True, slots=True)
class RestartAsked:
    """The gateway itself restarts the node (P972): its boot-up and absence are not faults."""


@dataclass(frozen=True, slots=True)
class Configured:
    """The drive was configured again (``restarted``), or only its type was read again; None: unknown type."""

    drive_type: DriveType | None
    homing_method: int = 0
    restarted: bool = True


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """The writes of ``Outputs.writes`` are done (``error`` None) or failed; an answer to other writes counts for nothing.

    An axis compares their values: a restored machine may have an equal request instead of the same object, and whichever of
    two equal requests was carried out, the device has the values.
    """

    writes: tuple[SdoWrite, ...]
    error: str | None


@dataclass(frozen=True, slots=True)
class PresetAnswer:
    """An encoder took the preset of ``Outputs.presets``, or not."""

    write: SdoWrite
    error: str | None


@dataclass(frozen=True, slots=True)
class FaultRead:
    """Fault number of the manufacturer and 603Fh, requested by ``Events.read_fault``; 0 without the object."""

    number: int
    code: int


@dataclass(frozen=True, slots=True, eq=False)
class ProbeWish:
    """Positions to be latched by the drive's touch probe. ``edges``: 0 to 3 as ``dsp402.drive.touch_probe`` counts them.

    No two wishes are equal: a position that was latched for an earlier one does not answer a later one.
    """

    edges: tuple[int, ...]
    zero_pulse: bool = False
    """At the zero pulse of the encoder instead of the first probe."""


@dataclass(frozen=True, slots=True)
class ProbeAnswer:
    """Result of a ``ProbeWish``; an answer to a withdrawn one is ignored. ``positions``: by edge."""

    wish: ProbeWish
    positions: Mapping[int, int]
    error: str | None = None
    supported: bool = True
    """False: the drive has no touch probe."""


News = NodeNotice | RestartAsked | Configured | SdoAnswer | PresetAnswer | FaultRead | ProbeAnswer


def is_answer(item: News, outputs: Outputs) -> bool:
    """It answers the present order of an axis or encoder, not a withdrawn one."""
    if isinstance(item, SdoAnswer):
        return item.writes is outputs.writes
    if isinstance(item, PresetAnswer):
        return item.write in outputs.presets
    return isinstance(item, ProbeAnswer) and item.wish is outputs.probe


CANOPEN_ERRORS: Final = range(0x8100, 0x8300)
"""Error codes 81xxh communication and 82xxh protocol error."""


@dataclass(frozen=True, slots=True)
class FaultRecord:
    """A fault as P945, P947 and P949 show it; ``time_ns`` is monotonic."""

    number: int
    code: int
    value: int
    text: str
    time_ns: int
    is_warning: bool = False
    is_bare: bool = False
    """The device shows a fault, and no code of it can be read."""
    is_older: bool = False
    """It began before the connection: ``time_ns`` is when it was found."""
    by: By | None = None
    """Who caused it, where the row of its number does not say so,"""
    remedy: str = ""
    """and what to do."""

    @property
    def line(self) -> str:
        """The text, with what to do."""
        return f"{self.text}; {self.remedy}" if self.remedy else self.text

    @property
    def of_device(self) -> bool:
        """The drive or encoder reported it, not the gateway."""
        return self.number not in GATEWAY_FAULTS

    @property
    def is_explained(self) -> bool:
        """The device says what it is. A bare fault or an error of the communication may be a consequence of a loss."""
        return not self.is_bare and self.code not in CANOPEN_ERRORS


def gateway_fault(number: FaultNumber, detail: str, now: int, by: By | None = None, remedy: str = "") -> FaultRecord:
    """A fault of the gateway's own table."""
    text = f"{number.title}: {detail}"
    return FaultRecord(number, number.code, 0, text, now, number.is_warning, by=by, remedy=remedy)


class EncoderInput(Protocol):
    """Values of one channel of an encoder; raw object values."""

    @property
    def position(self) -> int:
        """6004h or 6020h/n in measuring units."""

    @property
    def position_time(self) -> int:
        """When the position arrived, monotonic nanoseconds."""

    @property
    def speed(self) -> int | None:
        """6030h/n, None where the device has no speed."""

    @property
    def alarms(self) -> int:
        """6503h."""

    @property
    def warnings(self) -> int:
        """6505h."""

    @property
    def error_register(self) -> int:
        """1001h of the last EMCY."""

    @property
    def error_code(self) -> int:
        """Code of the last EMCY; 0 if it reported the end of all errors."""

    @property
    def valid(self) -> bool:
        """The position is one the device measured."""


@dataclass(slots=True, eq=False)
class Inputs:
    """Inputs of one step of an axis; one object, filled again for each step. The step empties ``news``. The recorder takes every
    field."""

    feedback: DriveFeedback
    now: int = 0
    """Monotonic nanoseconds."""
    setpoints: Sequence[int] | None = None
    """Raw signal values in telegram order; None while there is no valid PLC (silent, provider STOP, IOPS BAD)."""
    fresh: bool = False
    """True if ``setpoints`` arrived in this cycle, False if they are older."""
    gateway_stops: bool = False
    """The gateway is being stopped: of ``setpoints``, only OFF2 and OFF3 count."""
    drive_ok: bool = False
    """The drive is configured and its data is fresh."""
    standstill: bool = False
    """The actual speed is inside the standstill window; the step sets it."""
    standstill_unknown: bool = False
    """The axis may turn or not: its speed is read by SDO, and its answers say neither; the step sets it."""
    speed_asked_ns: int = 0
    """When the newest speed of the feedback was requested by SDO; 0: a TPDO has it."""
    speed_until_ns: int = 0
    """Afterwards this speed is old."""
    position_ns: int = 0
    """When the newest position of the feedback (6064h) came; 0 never."""
    position_asked_ns: int = 0
    """When this position was requested by SDO; 0: a TPDO has it."""
    position_old: bool = False
    """It is too old to count."""
    node_stopped: bool = False
    """The heartbeat of the drive says Stopped (NMT)."""
    fault_code: int = 0
    """The first fault that is not acknowledged (P947); only where the telegram shows it."""
    unacknowledged: bool = False
    """The fault buffer has a fault that is not acknowledged."""
    set_point_refused: bool = False
    """A new setpoint does not reach the drive, because its data could not be written."""
    encoders: list[EncoderInput | None] = field(default_factory=lambda: [None, None])
    """The encoders that are G1 and G2; None for a position of the drive."""
    encoders_ok: list[bool] = field(default_factory=lambda: [False, False])
    """They are configured, and their data is fresh."""
    news: list[News] = field(default_factory=list)

    def position_follows(self, time: int) -> bool:
        """The position was requested after ``time`` (monotonic ns), as far as it is read by SDO."""
        return not self.position_asked_ns or self.position_asked_ns > time


@dataclass(slots=True, eq=False)
class Events:
    """What happened in one step."""

    faults: list[FaultRecord] = field(default_factory=list)
    """New faults and warnings."""
    log_lines: list[str] = field(default_factory=list)
    """Lines for the log."""
    acknowledged: bool = False
    """The fault buffer moves on: the PLC acknowledged and the device has left its fault."""
    read_fault: bool = False
    """The fault number of the drive has to be read from it (``FaultRead``)."""


class Outputs:
    """Results of a step. The object is the same for every step of an axis or encoder."""

    def __init__(self, signals: int, reason: Reason | None) -> None:
        self.command = DriveCommand()
        """For the RPDOs of a drive."""
        self.actuals: list[int] = [0] * signals
        """Raw actual values in telegram order."""
        self.good = False
        """They are valid: IOPS."""
        self.released = False
        """The interlock is released: an OFF does nothing but stop. What has no interlock starts nothing either."""
        self.reason = reason
        """Why the axis does not do what the PLC asks; None: it does."""
        self.warning = 0
        """P953: the active warnings of the gateway and of the device."""
        self.warned = 0
        """Those of the executor: a part of ``warning``."""
        self.events: Events | None = None
        """What happened in this step; None in most of them."""
        self.found: list[tuple[FaultNumber, str]] = []
        """Faults and warnings of the gateway with their details, which the end of the step adds to its events."""
        self.motor_hot = self.stage_hot = False
        """The drive reported an overtemperature and has not left its fault since."""
        self.drive_error = 0
        """603Fh of the drive, or the error code of its last EMCY; 0: none."""
        self.brake: Brake = Brake.NONE
        """Action beside the Controlword because the drive does not follow it."""
        self.known_off = True
        """The drive has no power: it never showed any, or has shown since that it is off. Otherwise, and while it does not follow
        the PLC, the commanded stop is supervised."""
        self.writes: tuple[SdoWrite, ...] | None = None
        """Values for the device; each stays until its ``SdoAnswer``, or until it is withdrawn or replaced."""
        self.presets: list[SdoWrite | None] = [None, None]
        """Presets for the encoders at G1 and G2; a new object for each."""
        self.probe: ProbeWish | None = None
        """Positions that the drive must latch; a new object for each request."""
        self.saturations = 0
        """Number of limited values."""

    def happened(self) -> Events:
        """The events of this step, to add one."""
        if self.events is None:
            self.events = Events()
        return self.events

    def fault(self, record: FaultRecord) -> None:
        """A new fault or warning."""
        self.happened().faults.append(record)

    def warn(self, number: FaultNumber, detail: str) -> None:
        """A warning of the executor is active from now on; it is reported when it begins."""
        bit = warning_bits(number)
        if not self.warned & bit:
            self.warned |= bit
            self.found.append((number, detail))

    def end_warnings(self, bits: int) -> None:
        """These warnings are not active any more."""
        self.warned &= ~bits

    def no_drive_error(self) -> None:
        """The drive has left its fault, or says that it has none."""
        self.motor_hot = self.stage_hot = False
        self.drive_error = 0
