"""What a device consists of: modules in slots, submodules in subslots, with their identifications and data lengths.

Source: IEC 61158-5-10 (slot model), PROFIdrive on PROFINET (slot n = drive object, subslot 1 = module and parameter access point,
subslot 2 = telegram). The numbers of this project's modules are declared here; device and GSDML take them from here.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.rpc.identification import PROFILE_ID
from pdgw.profinet.station import Identity

API_DEFAULT: Final = 0
API_PROFIDRIVE: Final = PROFILE_ID
"""3A00h."""
DAP_SLOT: Final = 0
DAP_SUBSLOT: Final = 0x0001
INTERFACE_SUBSLOT: Final = 0x8000
PORT_SUBSLOT: Final = 0x8001
ACCESS_POINT_SUBSLOT: Final = 1
"""Module access point and parameter access point of a drive object."""
TELEGRAM_SUBSLOT: Final = 2
DAP_IDENT: Final = 0x0000_0001
INTERFACE_IDENT: Final = 0x0000_0002
PORT_IDENT: Final = 0x0000_0003
DAP_MODULE_IDENT: Final = 0x0000_0001
ACCESS_POINT_IDENT: Final = 0x0001_FFFF
TELEGRAM_IDENT: Final = 0x0001_0000
"""Plus the telegram's number."""
OBJECTS_MAX: Final = 254
"""Drive objects of a device: as many as there are DO-IDs."""
SEND_CLOCKS: Final = (8, 16, 32)
"""Send clocks in 31.25 us: 0.25, 0.5 and 1 ms. Every device supports the last one."""

Subslot = tuple[int, int]
"""Slot and subslot."""


class ObjectKind(enum.Enum):
    """Kinds of drive object with their module identification."""

    AXIS = 0x1001
    ENCODER = 0x1002

    @property
    def ident(self) -> int:
        """ModuleIdentNumber."""
        return self.value


@dataclass(frozen=True, slots=True)
class Submodule:
    """Submodule in a subslot; lengths in bytes, seen from the controller."""

    ident: int
    inputs: int = 0
    outputs: int = 0


@dataclass(frozen=True, slots=True)
class Module:
    """Module in a slot."""

    api: int
    ident: int
    submodules: Mapping[int, Submodule]


def telegram_ident(telegram: Telegram) -> int:
    """Identification of the submodule of a telegram."""
    return TELEGRAM_IDENT + telegram.number


def access_module() -> Module:
    """Slot 0: the device itself, its interface and its port."""
    submodules = {
        DAP_SUBSLOT: Submodule(DAP_IDENT),
        INTERFACE_SUBSLOT: Submodule(INTERFACE_IDENT),
        PORT_SUBSLOT: Submodule(PORT_IDENT),
    }
    return Module(API_DEFAULT, DAP_MODULE_IDENT, submodules)


def object_module(kind: ObjectKind, telegram: Telegram) -> Module:
    """A drive object with its telegram."""
    submodules = {
        ACCESS_POINT_SUBSLOT: Submodule(ACCESS_POINT_IDENT),
        TELEGRAM_SUBSLOT: Submodule(telegram_ident(telegram), telegram.actuals.size, telegram.setpoints.size),
    }
    return Module(API_PROFIDRIVE, kind.ident, submodules)


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """A device: its identity, and its modules by slot."""

    identity: Identity
    modules: Mapping[int, Module]
    min_device_interval: int = SEND_CLOCKS[-1]
    """Shortest cycle in 31.25 us, one of ``SEND_CLOCKS``."""

    def submodule(self, slot: int, subslot: int) -> Submodule | None:
        """The submodule in this place."""
        module = self.modules.get(slot)
        return None if module is None else module.submodules.get(subslot)


def drive_model(
    identity: Identity,
    objects: list[tuple[ObjectKind, Telegram]],
    min_device_interval: int = SEND_CLOCKS[-1],
) -> DeviceModel:
    """A device with these drive objects from slot 1 on."""
    modules = {DAP_SLOT: access_module()}
    for slot, (kind, telegram) in enumerate(objects, start=1):
        modules[slot] = object_module(kind, telegram)
    return DeviceModel(identity, modules, min_device_interval)
