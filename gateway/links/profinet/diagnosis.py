"""Faults of drives and encoders as PROFINET diagnosis: which message class an error code belongs to.

Source: CiA DS 301 and DSP 402 (error codes of EMCY), PROFIdrive profile (message classes). The longest prefix decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Final, Protocol

from pdgw.ds301.node.node import NodeStatus
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, FaultNumber
from pdgw.gateway.objects.fault_buffer import FaultLog
from pdgw.profinet.blocks.alarm import MessageClass
from pdgw.profinet.device import ProfinetDevice
from pdgw.profinet.model import ACCESS_POINT_SUBSLOT, TELEGRAM_SUBSLOT

MESSAGE_CLASSES: Final = MappingProxyType(
    {
        "1": MessageClass.GENERAL,
        "2": MessageClass.POWER_ELECTRONICS,
        "21": MessageClass.EARTH_FAULT,
        "3": MessageClass.POWER_ELECTRONICS,
        "31": MessageClass.MAINS,
        "32": MessageClass.DC_LINK,
        "4": MessageClass.TEMPERATURE,
        "43": MessageClass.MOTOR_OVERLOAD,
        "5": MessageClass.HARDWARE_SOFTWARE,
        "51": MessageClass.SUPPLY,
        "6": MessageClass.HARDWARE_SOFTWARE,
        "63": MessageClass.PARAMETERS,
        "7": MessageClass.AUXILIARY,
        "711": MessageClass.BRAKE,
        "712": MessageClass.MOTOR_OVERLOAD,
        "73": MessageClass.ACTUAL_VALUE,
        "8": MessageClass.APPLICATION,
        "81": MessageClass.INTERNAL_COMMUNICATION,
        "9": MessageClass.EXTERNAL,
        "F": MessageClass.GENERAL,
    }
)
"""Message class by the leading digits of an error code."""


_OF_THE_GATEWAY: Final = {
    GATEWAY_FAULTS[number].code: MessageClass.CONTROLLER_COMMUNICATION
    for number in (FaultNumber.PLC_LOST, FaultNumber.SIGN_OF_LIFE)
}
_PREFIXES = (3, 2, 1)


def message_class(error_code: int) -> MessageClass:
    """The class of an error code (603Fh, EMCY, or of the gateway's own faults)."""
    if error_code in _OF_THE_GATEWAY:
        return _OF_THE_GATEWAY[error_code]
    digits = f"{error_code:04X}"
    found = (MESSAGE_CLASSES.get(digits[:length]) for length in _PREFIXES)
    return next((item for item in found if item is not None), MessageClass.GENERAL)


class Node(Protocol):
    """A node of a drive object, with its status."""

    @property
    def status(self) -> NodeStatus: ...


class Diagnosed(Protocol):
    """The properties of a drive object for its diagnosis."""

    fault_log: FaultLog

    @property
    def client(self) -> Node: ...


def present_classes(item: Diagnosed) -> set[MessageClass]:
    """Problems of a drive object: unacknowledged faults, and a lost node."""
    found = {message_class(fault.code) for fault in item.fault_log.unacknowledged()}
    if item.client.status is not NodeStatus.ONLINE:
        found.add(MessageClass.INTERNAL_COMMUNICATION)
    return found


class DiagnosisReport:
    """Reports the problems of the drive objects as diagnosis of their access points."""

    def __init__(self, device: ProfinetDevice, objects: Sequence[Diagnosed]) -> None:
        self._device = device
        self._objects = objects
        self._reported: list[set[MessageClass]] = [set() for _ in objects]

    def report(self) -> bool:
        """Report what has begun or ended since the last report; whether there was anything."""
        changed = False
        for index, item in enumerate(self._objects):
            present = present_classes(item)
            reported = self._reported[index]
            if present == reported:
                continue
            point = (index + 1, ACCESS_POINT_SUBSLOT)
            for number in reported - present:
                self._device.clear_diagnosis(point, number)
            for number in present - reported:
                self._device.set_diagnosis(point, number)
            if MessageClass.INTERNAL_COMMUNICATION in reported - present:
                self._device.returned((index + 1, TELEGRAM_SUBSLOT))
            self._reported[index] = present
            changed = True
        return changed
