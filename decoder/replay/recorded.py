"""The data of both captures about one axis: inputs and outputs of the gateway, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.objects import MAX_TORQUE
from pdgw.gateway.axis.settings import AxisSettings, SecondSensor
from pdgw.gateway.axis.values import Configured
from pdgw.profidrive.telegrams import Telegram

UNKNOWN_TORQUE: Final = 0xFFFF
"""Placeholder for the drive's own torque limit (6072h) if the recording does not contain it. Every limit of a task is lower."""
_FAULT_BUFFER: Final = ("FAULT_CODE", "WARN_CODE")


class Setpoints(NamedTuple):
    """From the first time these raw values may be in force, from ``certain_ns`` they are; None without a valid PLC."""

    time_ns: int
    values: tuple[int, ...] | None
    certain_ns: int
    gateway_stops: bool = False
    """The gateway itself is being stopped: the values are in force in one step, and of them only OFF2 and OFF3 count."""


class Feedback(NamedTuple):
    """A TPDO: values by their attribute of ``DriveFeedback``."""

    time_ns: int
    values: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class SdoResult:
    """A completed SDO download; ``error`` is the abort's text."""

    time_ns: int
    index: int
    subindex: int
    data: bytes
    error: str | None = None


class ProbeTransfer(NamedTuple):
    """A completed SDO of the touch probe (60B8h to 60BDh), or its abort."""

    time_ns: int
    address: int
    value: int
    written: bool
    abort: int | None = None


class Learned(NamedTuple):
    """Known facts of the gateway about the drive: it was (re-)configured, or its references were read again or are assumed."""

    time_ns: int
    configured: Configured


class Answer(NamedTuple):
    """Content of a frame to the PLC for one axis: raw actual values, IOPS (the drive is connected), IOCS (the PLC is
    connected).

    Over PROFINET the IOCS does not show whether the PLC is connected: None.
    """

    time_ns: int
    actuals: tuple[int, ...]
    drive_ok: bool
    plc_ok: bool | None


class Sent(NamedTuple):
    """A recorded RPDO."""

    time_ns: int
    data: bytes


@dataclass
class AxisRecording:
    """Everything recorded of one axis, each list in the order of time, on one clock (nanoseconds).

    ``sent`` are the RPDOs by number, repetitions included. ``frames`` are the times of the PLC's accepted frames. ``online`` is
    used where there are no answers: times from which the drive was there or not.
    """

    do_id: int
    node: int
    telegram: Telegram
    settings: AxisSettings = field(default_factory=AxisSettings)
    frames: list[int] = field(default_factory=list)
    setpoints: list[Setpoints] = field(default_factory=list)
    feedback: list[Feedback] = field(default_factory=list)
    sdo: list[SdoResult] = field(default_factory=list)
    probe: list[ProbeTransfer] = field(default_factory=list)
    configured: list[Learned] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)
    sent: dict[int, list[Sent]] = field(default_factory=dict)
    online: list[tuple[int, bool]] = field(default_factory=list)
    can_end_ns: int = 0
    """The last frame of the drive or to it."""
    watchdog_ns: int = 0
    """Silence after which the PLC is lost."""
    paced: bool = False
    """The gateway sends with a timing of its own (PROFINET), whatever the PLC's frames do."""
    rpdos: tuple[Pdo, ...] = ()
    """Those of ``sent``, as they were mapped."""

    in_order: bool = False
    """Times are those at which the gateway dealt with each frame, in its order: a step had all that came before its answer."""

    @property
    def torque_is_known(self) -> bool:
        """Whether the drive's own torque limit is known, so that a limit that was sent can be compared."""
        drives = (item.configured.drive_type for item in self.configured)
        return not any(drive is not None and drive.max_torque == UNKNOWN_TORQUE for drive in drives)

    @property
    def torque_places(self) -> Mapping[int, slice]:
        """The bytes of Max Torque in the payloads of RPDOs, by RPDO number."""
        places = {}
        for pdo in self.rpdos:
            begin = 0
            for entry in pdo.entries:
                end = begin + entry.type.bits // 8
                if entry.address == MAX_TORQUE:
                    places[pdo.number] = slice(begin, end)
                begin = end
        return places

    @property
    def not_computed(self) -> frozenset[int]:
        """Places of the actual values that the axis only hands on.

        The words of G1 or G2 with an encoder of its own (another node), and the numbers of the drive object's fault buffer.
        """
        settings = self.settings
        first, second = settings.g1_is_encoder, settings.second_sensor is SecondSensor.ENCODER
        names = self.telegram.actuals.names
        return frozenset(
            place
            for place, name in enumerate(names)
            if (first and name.startswith("G1_")) or (second and name.startswith("G2_")) or name in _FAULT_BUFFER
        )
