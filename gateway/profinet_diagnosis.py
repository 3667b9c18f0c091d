"""Faults of drives and encoders as PROFINET diagnosis: which message class an error code belongs to.

Source: CiA DS 301 and DSP 402 (error codes of EMCY), PROFIdrive profile (message classes). The longest prefix decides.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from pdgw.ds301.client import NodeStatus
from pdgw.gateway.drive_object import DriveObject
from pdgw.profinet.blocks.alarm import MessageClass

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


def message_class(error_code: int) -> MessageClass:
    """The class of an error code (603Fh or EMCY)."""
    digits = f"{error_code:04X}"
    for length in (3, 2, 1):
        found = MESSAGE_CLASSES.get(digits[:length])
        if found is not None:
            return found
    return MessageClass.GENERAL


def present_classes(item: DriveObject) -> set[MessageClass]:
    """What is wrong with a drive object now; empty when nothing is."""
    if item.client.status is not NodeStatus.ONLINE:
        return {MessageClass.INTERNAL_COMMUNICATION}
    if not item.faulty:
        return set()
    codes = [fault.code for fault in item.faults if not fault.is_warning]
    return {message_class(codes[-1])} if codes else {MessageClass.GENERAL}
