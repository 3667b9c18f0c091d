"""The gateway's own fault numbers: one table, with what each does, who causes it and what to do.

``pdgw status``, the log, P947 and P953 show them. Source: docs/translation.md.
"""

from __future__ import annotations

import enum
from types import MappingProxyType
from typing import Final

from pdgw.ds301.emcy import BUS_OFF_RECOVERED, HEARTBEAT_ERROR
from pdgw.gateway.base.steps import Bits, Give, Remedy, Step


class By(enum.Enum):
    """Who began a stop."""

    PLC = "PLC"
    DRIVE = "device"
    NODE = "node"
    BUS = "bus"
    GATEWAY = "gateway"
    OTHER_MASTER = "another master"


class Weight(enum.Enum):
    """What a fault of the gateway does."""

    WARNING = "warning"
    FAULT = "fault"
    SEVERE = "severe fault"
    """The drive did not execute a command, or did more than commanded. The axis is in fault until an acknowledgement."""


CHECK_UNITS: Final = "check velocity_unit and counts_per_revolution with pdgw axis test"
_WARNING, _SEVERE = Weight.WARNING, Weight.SEVERE
SET_NAMED: Final = "set the named key or object"
"""The remedy of fault 104 where no key helps."""
_SUPPLY: Final = "check plug, cable and supply of the node"
_BUS: Final = "check CAN cable, termination, bit rate and the interface"
_CONFIGURATION: Final = "compare the device with the configuration, see pdgw config check --bus"
_POSITION: Final = "check the setpoint, and whether the axis is blocked"
_FRAMES: Final = "check the cable, the PLC's operating mode (STOP) and its cycle time"
_STOPS: Final = "check brake resistor, the quick stop ramp (6085h, 605Ah), brake and mechanics"


class FaultNumber(enum.IntEnum):
    """The gateway's own faults and warnings by number (P947); from 101 on they keep clear of the manufacturer's 1-12."""

    title: str
    code: int
    """P945."""
    by: By
    """Who causes it."""
    remedy: Remedy
    """Without the acknowledge."""
    weight: Weight

    def __new__(
        cls, number: int, title: str, code: int, by: By, todo: Step, weight: Weight = Weight.FAULT
    ) -> FaultNumber:
        member = int.__new__(cls, number)
        member._value_ = number
        member.title, member.code, member.by, member.remedy = title, code, by, (todo,)
        member.weight = weight
        return member

    @property
    def is_warning(self) -> bool:
        """The drive stays in operation."""
        return self.weight is Weight.WARNING

    @property
    def warning_mask(self) -> int:
        """The bit of a warning in P953; 0 for a fault."""
        return 1 << (self - FIRST_WARNING) if self.is_warning else 0

    NODE_LOST = (101, "node lost", HEARTBEAT_ERROR, By.NODE, _SUPPLY)
    BUS_LOST = (102, "CAN bus lost", BUS_OFF_RECOVERED, By.BUS, _BUS)
    PLC_LOST = (103, "PLC lost", 0xFF01, By.PLC, _FRAMES)
    REFERENCE = (
        104,
        "100 %, mode of operation or an option of the drive is not usable",
        0xFF02,
        By.DRIVE,
        SET_NAMED,
    )
    NODE_RESTARTED = (105, "node restarted during operation", 0xFF03, By.NODE, _SUPPLY)
    NODE_REFUSED = (106, "node identity or configuration rejected", 0xFF04, By.NODE, _CONFIGURATION)
    STATE_UNKNOWN = (
        107,
        "drive state unknown",
        0xFF05,
        By.DRIVE,
        "check the device and its PDO mapping: the Statusword is not a CiA 402 state",
        _SEVERE,
    )
    HOMING_METHOD = (
        108,
        "homing method not supported",
        0xFF06,
        By.DRIVE,
        "set a homing_method that the drive supports",
        _WARNING,
    )
    HOMING = (109, "homing error", 0xFF07, By.DRIVE, "check the home switch and the homing speeds", _WARNING)
    MODE_NOT_CONFIRMED = (
        110,
        "mode of operation not confirmed",
        0xFF08,
        By.DRIVE,
        "use a drive that supports the mode of operation of this telegram",
        _WARNING,
    )
    HOMING_PARAMETERS = (
        111,
        "drive rejected the homing parameters",
        0xFF09,
        By.DRIVE,
        "choose a homing_method and speeds that the drive accepts",
        _WARNING,
    )
    INTERNAL_LIMIT = (
        112,
        "internal limit of the drive reached",
        0xFF0A,
        By.DRIVE,
        "check limit switches and the drive's own limits",
        _WARNING,
    )
    POSITIONER = (113, "positioner: task rejected or changed", 0xFF0B, By.PLC, _POSITION, _WARNING)
    DSC_GAIN = (114, "gain of DSC limited", 0xFF0C, By.PLC, "lower KPC", _WARNING)
    VELOCITY_DEVIATES = (115, "speed and position do not match exactly", 0xFF0D, By.DRIVE, CHECK_UNITS, _WARNING)
    PRESET = (118, "preset of the encoder failed", 0xFF0F, By.DRIVE, "see its manual", _WARNING)
    SET_POINT = (119, "drive rejected the data of a setpoint", 0xFF10, By.DRIVE, _POSITION, _WARNING)
    CONTROL_LOST = (120, "control by PLC removed in operation", 0xFF15, By.PLC, Bits(("STW1.10",)), _WARNING)
    NODE_ABSENT = (121, "node does not answer", 0xFF11, By.NODE, _SUPPLY)
    LEFT_OPERATION = (
        122,
        "drive acts without a command",
        0xFF12,
        By.DRIVE,
        "check safe torque off (STO), enable input and supply of the drive",
    )
    OTHER_MASTER = (123, "another master on the bus", 0xFF13, By.OTHER_MASTER, "switch the other master off")
    SIGN_OF_LIFE = (
        124,
        "sign of life of the PLC lost",
        0xFF14,
        By.PLC,
        "check the PLC's program; count in the clock of the frames, or raise P925",
    )
    STOP_IGNORED = (125, "drive does not stop", 0xFF16, By.DRIVE, _STOPS, _SEVERE)
    ENABLE_UNASKED = (
        126,
        "Enable Operation without a command of the PLC",
        0xFF18,
        By.GATEWAY,
        "report this with the flight recorder: the gateway's last guard has stopped the axis",
        _SEVERE,
    )
    FRAME_CHANGED = (
        127,
        "frame of the PLC changed by P922",
        0xFF17,
        By.PLC,
        "give the PLC the layout that pdgw map prints",
    )
    VELOCITY = (128, "speed contradicts the units of the drive", 0xFF19, By.DRIVE, CHECK_UNITS, _SEVERE)
    NOT_ACKNOWLEDGED = (129, "setpoint not acknowledged", 0xFF1A, By.DRIVE, _POSITION, _WARNING)
    MOVES_UNASKED = (130, "drive moves without a task", 0xFF1B, By.DRIVE, Give("task", "send the next task"), _WARNING)
    STALLED = (
        133,
        "axis at standstill before the end of its motion",
        0xFF1E,
        By.DRIVE,
        "check brake, torque limit and mechanics",
        _WARNING,
    )
    DSC_OUT_OF_DATE = (134, "DSC stopped the axis: no new setpoint", 0xFF1F, By.PLC, _FRAMES, _WARNING)
    NOT_ENTERED = (
        131,
        "drive does not enter or leave operation as commanded",
        0xFF1C,
        By.DRIVE,
        "check safe torque off (STO), the enable input, the brake and 605Ch of the drive",
    )
    TURNS_OFF = (
        132,
        "drive reports power off and does not slow down",
        0xFF1D,
        By.DRIVE,
        "check what turns the shaft, brake and power stage",
        _WARNING,
    )


GATEWAY_FAULTS: Final = MappingProxyType({fault.value: fault for fault in FaultNumber})
"""Every fault and warning of the gateway by its number."""
INTERNAL_FAULT: Final = 10
"""Number of the manufacturer's table for a fault of the device without its own number."""
FIRST_WARNING = 108
"""Number of the warning with bit 0 of P953; the others follow."""
EMCY_WARNING: Final = 1 << 14
"""The bit of P953 for an EMCY of a device that shows no fault."""
DEVICE_WARNING: Final = 1 << 15
"""That of Statusword.7, or of 6505h of an encoder."""


def first_warning(bits: int) -> int:
    """The lowest number among warnings of P953, 0 for none."""
    return FIRST_WARNING + (bits & -bits).bit_length() - 1 if bits else 0


def warning_bits(*numbers: FaultNumber) -> int:
    """The bits of these warnings in P953."""
    return sum(number.warning_mask for number in numbers)
