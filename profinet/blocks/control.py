"""Blocks of the Control and Release services.

Source: IEC 61158-6-10 (ControlBlockConnect, ReleaseBlock), as scapy and tshark read them.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import ClassVar, Final
from uuid import UUID

from pdgw.profinet.wire import Block, u16, uuid


class ControlCommand(enum.IntFlag):
    """ControlCommand."""

    PRM_END = 0x0001
    APPLICATION_READY = 0x0002
    RELEASE = 0x0004
    DONE = 0x0008
    PRM_BEGIN = 0x0040


@dataclass(frozen=True, kw_only=True)
class ControlBlock(Block):
    """All of them have these fields."""

    ERROR_CODE1: ClassVar[int] = 0x14
    reserved: int = u16(default=0)
    ar_uuid: UUID = uuid()
    session_key: int = u16()
    reserved_2: int = u16(default=0)
    command: int = u16()
    properties: int = u16(default=0)


@dataclass(frozen=True, kw_only=True)
class PrmEndReq(ControlBlock):
    """The controller has written its parameters."""

    TYPE: ClassVar[int] = 0x0110


@dataclass(frozen=True, kw_only=True)
class PrmEndRes(ControlBlock):
    TYPE: ClassVar[int] = 0x8110


@dataclass(frozen=True, kw_only=True)
class ApplicationReadyReq(ControlBlock):
    """The device's data is valid; sent to the controller."""

    TYPE: ClassVar[int] = 0x0112


@dataclass(frozen=True, kw_only=True)
class ApplicationReadyRes(ControlBlock):
    TYPE: ClassVar[int] = 0x8112


@dataclass(frozen=True, kw_only=True)
class ReleaseReq(ControlBlock):
    """The controller ends the relationship."""

    TYPE: ClassVar[int] = 0x0114
    ERROR_CODE1: ClassVar[int] = 0x28


@dataclass(frozen=True, kw_only=True)
class ReleaseRes(ControlBlock):
    TYPE: ClassVar[int] = 0x8114


@dataclass(frozen=True, kw_only=True)
class PrmBeginReq(ControlBlock):
    """The controller starts to write parameters again."""

    TYPE: ClassVar[int] = 0x0118


@dataclass(frozen=True, kw_only=True)
class PrmBeginRes(ControlBlock):
    TYPE: ClassVar[int] = 0x8118


ANSWERS: Final[dict[type[ControlBlock], type[ControlBlock]]] = {
    PrmEndReq: PrmEndRes,
    PrmBeginReq: PrmBeginRes,
    ApplicationReadyReq: ApplicationReadyRes,
    ReleaseReq: ReleaseRes,
}
COMMANDS: Final[dict[int, tuple[type[ControlBlock], ControlCommand]]] = {
    PrmEndReq.TYPE: (PrmEndReq, ControlCommand.PRM_END),
    PrmBeginReq.TYPE: (PrmBeginReq, ControlCommand.PRM_BEGIN),
}
"""Block and command of each Control service."""
