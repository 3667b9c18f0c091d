"""Alarm notifications and their acknowledgement, and the channel diagnosis they carry.

Source: IEC 61158-6-10 (AlarmNotification-PDU, AlarmAck-PDU, DiagnosisData), PROFIdrive profile (message classes 9000h to 9013h).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Final

from pdgw.profinet.wire import Block, Structure, rest, u16, u32


class Priority(enum.Enum):
    """The two alarm priorities; each counts its own sequence."""

    HIGH = "high"
    LOW = "low"


class AlarmType(enum.IntEnum):
    """Alarms this device sends, with the priority of each."""

    DIAGNOSIS = 0x0001
    PROCESS = 0x0002
    PULL = 0x0003
    PLUG = 0x0004
    PLUG_WRONG = 0x000A
    RETURN_OF_SUBMODULE = 0x000B
    DIAGNOSIS_DISAPPEARS = 0x000C
    PORT_CHANGE = 0x000E


SEQUENCE_MASK: Final = 0x07FF
CHANNEL_DIAGNOSIS: Final = 0x0800
SUBMODULE_DIAGNOSIS: Final = 0x2000
AR_DIAGNOSIS: Final = 0x8000
"""Bits of AlarmSpecifier: what there is, of the submodule and of the relationship."""

USI_CHANNEL_DIAGNOSIS: Final = 0x8000
USI_EXTENDED_DIAGNOSIS: Final = 0x8002
WHOLE_SUBMODULE: Final = 0x8000
"""ChannelNumber."""


@dataclass(frozen=True, kw_only=True)
class AlarmNotification(Block):
    """An event of a submodule."""

    alarm_type: int = u16()
    api: int = u32()
    slot: int = u16()
    subslot: int = u16()
    module_ident: int = u32()
    submodule_ident: int = u32()
    specifier: int = u16()
    payload: bytes = rest()
    """UserStructureIdentifier and data, or nothing."""


@dataclass(frozen=True, kw_only=True)
class AlarmNotificationHigh(AlarmNotification):
    TYPE: ClassVar[int] = 0x0001


@dataclass(frozen=True, kw_only=True)
class AlarmNotificationLow(AlarmNotification):
    TYPE: ClassVar[int] = 0x0002


@dataclass(frozen=True, kw_only=True)
class AlarmAck(Block):
    """The peer's application has seen the event; ``status`` is a PNIO status."""

    alarm_type: int = u16()
    api: int = u32()
    slot: int = u16()
    subslot: int = u16()
    specifier: int = u16()
    status: int = u32()


@dataclass(frozen=True, kw_only=True)
class AlarmAckHigh(AlarmAck):
    TYPE: ClassVar[int] = 0x8001


@dataclass(frozen=True, kw_only=True)
class AlarmAckLow(AlarmAck):
    TYPE: ClassVar[int] = 0x8002


NOTIFICATIONS: Final[dict[Priority, type[AlarmNotification]]] = {
    Priority.HIGH: AlarmNotificationHigh,
    Priority.LOW: AlarmNotificationLow,
}
ACKS: Final[dict[Priority, type[AlarmAck]]] = {Priority.HIGH: AlarmAckHigh, Priority.LOW: AlarmAckLow}


class Specifier(enum.IntEnum):
    """ChannelProperties.Specifier."""

    APPEARS = 1
    DISAPPEARS = 2
    OTHERS_REMAIN = 3


class Severity(enum.IntEnum):
    """ChannelProperties.Maintenance."""

    FAULT = 0
    MAINTENANCE_REQUIRED = 1
    MAINTENANCE_DEMANDED = 2


SPECIFIER_SHIFT: Final = 11
SEVERITY_SHIFT: Final = 9
DIRECTION_SHIFT: Final = 13
DIRECTION_BOTH: Final = 3


@dataclass(frozen=True, kw_only=True)
class ChannelDiagnosis(Structure):
    """One entry of channel diagnosis."""

    channel: int = u16(default=WHOLE_SUBMODULE)
    properties: int = u16()
    error_type: int = u16()


@dataclass(frozen=True, kw_only=True)
class ExtendedDiagnosis(ChannelDiagnosis):
    """One entry of extended channel diagnosis: its error type has subtypes."""

    ext_error_type: int = u16()
    ext_value: int = u32(default=0)


@dataclass(frozen=True, kw_only=True)
class DiagnosisBlock(Block):
    """Record of diagnosis of one submodule; BlockVersionLow 1 has the API. All entries are of one ``usi``."""

    TYPE: ClassVar[int] = 0x0010
    VERSION: ClassVar[tuple[int, int]] = (1, 1)
    api: int = u32()
    slot: int = u16()
    subslot: int = u16()
    channel: int = u16(default=WHOLE_SUBMODULE)
    properties: int = u16(default=CHANNEL_DIAGNOSIS)
    usi: int = u16(default=USI_CHANNEL_DIAGNOSIS)
    entries: bytes = rest()


class MessageClass(enum.IntEnum):
    """Fault classes of PROFIdrive: ChannelErrorType of a drive object's diagnosis."""

    HARDWARE_SOFTWARE = 0x9000
    MAINS = 0x9001
    SUPPLY = 0x9002
    DC_LINK = 0x9003
    POWER_ELECTRONICS = 0x9004
    TEMPERATURE = 0x9005
    EARTH_FAULT = 0x9006
    MOTOR_OVERLOAD = 0x9007
    CONTROLLER_COMMUNICATION = 0x9008
    SAFETY = 0x9009
    ACTUAL_VALUE = 0x900A
    INTERNAL_COMMUNICATION = 0x900B
    INFEED = 0x900C
    BRAKE = 0x900D
    FILTER = 0x900E
    EXTERNAL = 0x900F
    APPLICATION = 0x9010
    PARAMETERS = 0x9011
    GENERAL = 0x9012
    AUXILIARY = 0x9013


MESSAGE_CLASS_TEXTS: Final = MappingProxyType(
    {
        MessageClass.HARDWARE_SOFTWARE: "Microcontroller hardware or software error",
        MessageClass.MAINS: "Mains fault",
        MessageClass.SUPPLY: "Low voltage supply fault",
        MessageClass.DC_LINK: "DC link overvoltage or undervoltage",
        MessageClass.POWER_ELECTRONICS: "Power electronics faulted",
        MessageClass.TEMPERATURE: "Overtemperature of the electronic components",
        MessageClass.EARTH_FAULT: "Earth or phase fault",
        MessageClass.MOTOR_OVERLOAD: "Motor overload",
        MessageClass.CONTROLLER_COMMUNICATION: "Communication error to the higher-level control system",
        MessageClass.SAFETY: "Safety monitoring channel has identified an error",
        MessageClass.ACTUAL_VALUE: "Actual position or speed value incorrect or not available",
        MessageClass.INTERNAL_COMMUNICATION: "Internal (CAN) communication error",
        MessageClass.INFEED: "Infeed faulted",
        MessageClass.BRAKE: "Brake controller or braking module faulted",
        MessageClass.FILTER: "Line filter faulted",
        MessageClass.EXTERNAL: "External measured value or signal state out of its range",
        MessageClass.APPLICATION: "Application or technological function faulted",
        MessageClass.PARAMETERS: "Error in the parameterisation or commissioning",
        MessageClass.GENERAL: "General drive fault",
        MessageClass.AUXILIARY: "Auxiliary unit faulted",
    }
)
"""Text of each class as GSDML shows it."""
