"""COB-IDs, NMT states and commands, and the communication objects (1000h-1FFFh).

The pre-defined connection set: COB-IDs of the services of CiA 301, declared once. Those of PDOs are in ``ds301.pdo``. Source:
CiA DS 301 V4.02 chapter 7.3.5. A base plus the node-ID is the COB-ID of that node's service. NMT states and commands, once.
Source: CiA DS 301 V4.02 chapters 7.2.8.2 (commands) and 7.2.8.3.2 (states in the heartbeat). Communication objects
(1000h-1FFFh) of every simulated device. Source: CiA DS 301 V4.01 chapter 9.6. A device profile adds its own identity values
and PDO counts.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from typing import Final

from pdgw.ds301.configuration import EVENT_DRIVEN_PROFILE
from pdgw.ds301.objects import Access, CanType, Entry, ObjectKind, ObjectSpec, array, var
from pdgw.ds301.pdo import COB_ID_INVALID, Pdo, PdoDirection

NODE_IDS: Final = range(1, 128)
DEFAULT_GATEWAY_NODE_ID: Final = 127
"""Node-ID of the gateway on a bus whose configuration has none."""

NMT: Final = 0x000
SYNC: Final = 0x080
EMCY: Final = 0x080
"""Base: 081h to 0FFh."""
TIME: Final = 0x100
SDO_RESPONSE: Final = 0x580
"""Base: from the server."""
SDO_REQUEST: Final = 0x600
"""Base: to the server."""
ERROR_CONTROL: Final = 0x700
"""Base: heartbeat, boot-up and node guarding."""
LSS_RESPONSE: Final = 0x7E4
LSS_REQUEST: Final = 0x7E5
LSS_NO_NODE_ID: Final = 0xFF
"""Node-ID of a device that has none: it answers LSS only."""
LSS_BIT_TIMINGS: Final = {
    1_000_000: 0,
    800_000: 1,
    500_000: 2,
    250_000: 3,
    125_000: 4,
    50_000: 6,
    20_000: 7,
    10_000: 8,
}
"""Bit rates of CiA 301, each with its number in table 0 of LSS. Source: CiA 305."""


HEARTBEAT_STATE: Final = 0x7F
"""The bits of a heartbeat that hold the state."""
GUARD_TOGGLE: Final = 0x80
"""Bit 7 of a heartbeat is reserved, and alternates in the answers of node guarding."""


class NmtState(enum.IntEnum):
    """NMT states as the heartbeat shows them."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127

    @staticmethod
    def text(state: int) -> str:
        """Name of a state in a heartbeat, such as "Pre-operational"; its number for one that the standard does not have."""
        return NmtState(state).name.replace("_", "-").capitalize() if state in NMT_STATES else f"{state:02X}h"


NMT_STATES: Final = frozenset(NmtState)


class NmtCommand(enum.IntEnum):
    """NMT command specifiers."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


RO, RW, CONST = Access.RO, Access.RW, Access.CONST
U8, U16, U32 = CanType.U8, CanType.U16, CanType.U32

DEVICE_TYPE = 0x1000
ERROR_REGISTER = 0x1001
PREDEFINED_ERROR_FIELD = 0x1003
SYNC_COB_ID = 0x1005
SYNC_PRODUCER: Final = 1 << 30
"""Bit of 1005h: the node sends SYNC."""
SYNC_PERIOD = 0x1006
"""Communication cycle period in microseconds."""
SYNC_WINDOW = 0x1007
SYNC_COUNTER = 0x1019
"""Synchronous counter overflow value: not 0 if the SYNC has a counter. It can be written while 1006h is 0 only."""
DEVICE_NAME = 0x1008
GUARD_TIME = 0x100C
LIFE_TIME_FACTOR = 0x100D
STORE_PARAMETERS = 0x1010
RESTORE_PARAMETERS = 0x1011
TIME_COB_ID = 0x1012
EMCY_COB_ID = 0x1014
CONSUMER_HEARTBEAT = 0x1016
PRODUCER_HEARTBEAT = 0x1017
VERIFY_CONFIGURATION = 0x1020
"""Date and time of the stored configuration: sub-index 1 days since 1984-01-01, 2 milliseconds since midnight."""
IDENTITY = 0x1018
IDENTITY_VENDOR = (IDENTITY, 1)
IDENTITY_PRODUCT = (IDENTITY, 2)
IDENTITY_REVISION = (IDENTITY, 3)
IDENTITY_SERIAL = (IDENTITY, 4)

ERROR_BEHAVIOUR = 0x1029
SDO_SERVERS = range(0x1200, 0x1280)
SDO_CLIENTS = range(0x1280, 0x1400)
NMT_STARTUP = 0x1F80

SAVE_SIGNATURE = int.from_bytes(b"save", "little")
LOAD_SIGNATURE = int.from_bytes(b"load", "little")


def profile_of(device_type: int) -> int:
    """The number of the device profile in the value of 1000h, such as 402; 0 for none."""
    return device_type & 0xFFFF


def _fixed_array(
    index: int, name: str, count: int, type_: CanType, access: Access, item: str, default: int
) -> ObjectSpec:
    return array(
        index,
        name,
        *(Entry(index, sub, f"{item} {sub}", type_, access, default=default) for sub in range(1, count + 1)),
    )


def communication_objects(
    device_type: int, device_name: str, identity: tuple[int, int, int, int], versions: tuple[str, str]
) -> tuple[ObjectSpec, ...]:
    """The common objects.

    ``identity`` is (vendor, product, revision, serial number) of 1018h; ``versions`` (hardware, software).
    """
    names = ("Vendor-ID", "Product code", "Revision number", "Serial number")
    return (
        var(DEVICE_TYPE, "Device type", U32, RO, default=device_type),
        var(ERROR_REGISTER, "Error register", U8, RO, default=0, pdo=True, attribute="error_register"),
        _fixed_array(PREDEFINED_ERROR_FIELD, "Pre-defined error field", 8, U32, RO, "Error", 0),
        var(SYNC_COB_ID, "COB-ID SYNC", U32, RW, default=SYNC),
        var(DEVICE_NAME, "Manufacturer device name", CanType.VISIBLE_STRING, CONST, default=device_name),
        var(0x1009, "Manufacturer hardware version", CanType.VISIBLE_STRING, CONST, default=versions[0]),
        var(0x100A, "Manufacturer software version", CanType.VISIBLE_STRING, CONST, default=versions[1]),
        _fixed_array(STORE_PARAMETERS, "Store parameters", 1, U32, RW, "Save all parameters", 1),
        _fixed_array(RESTORE_PARAMETERS, "Restore default parameters", 1, U32, RW, "Restore all parameters", 1),
        var(EMCY_COB_ID, "COB-ID EMCY", U32, RO, default=EMCY),
        _fixed_array(CONSUMER_HEARTBEAT, "Consumer heartbeat time", 1, U32, RW, "Consumer heartbeat time", 0),
        var(PRODUCER_HEARTBEAT, "Producer heartbeat time", U16, RW, default=0, unit="ms"),
        array(
            IDENTITY,
            "Identity object",
            *(
                Entry(IDENTITY, sub, name, U32, RO, default=value)
                for sub, (name, value) in enumerate(zip(names, identity, strict=True), 1)
            ),
            kind=ObjectKind.RECORD,
        ),
    )


def pdo_objects(
    rpdos: int | Sequence[int],
    tpdos: int | Sequence[int],
    defaults: tuple[Pdo, ...],
    mappable: int = 8,
    *,
    tpdo_types: Mapping[int, int] | None = None,
    event_timer: bool = True,
    time_out: bool = False,
) -> tuple[ObjectSpec, ...]:
    """Communication and mapping parameters of the device's PDOs; PDOs without a default are invalid and unmapped.

    ``rpdos`` and ``tpdos`` are how many it has, or which numbers. ``tpdo_types`` gives default transmission types (255 for
    the others); without ``event_timer`` the TPDOs end with the inhibit time; with ``time_out`` the RPDOs have one.
    """
    by_key = {(pdo.direction, pdo.number): pdo for pdo in defaults}
    objects: list[ObjectSpec] = []
    for direction, numbers in ((PdoDirection.RPDO, rpdos), (PdoDirection.TPDO, tpdos)):
        for number in range(1, numbers + 1) if isinstance(numbers, int) else numbers:
            pdo = by_key.get((direction, number))
            base = direction.bases[number - 1] | (0 if pdo else COB_ID_INVALID)
            index = direction.communication_index + number - 1
            # The COB-ID default is relative: the node-ID is added by EDS ($NODEID+...) and simulator.
            type_ = EVENT_DRIVEN_PROFILE
            if direction is PdoDirection.TPDO and tpdo_types is not None:
                type_ = tpdo_types.get(number, type_)
            entries = [
                Entry(index, 1, "COB-ID", U32, RW, default=base),
                Entry(index, 2, "Transmission type", U8, RW, default=type_),
            ]
            if direction is PdoDirection.TPDO:
                entries.append(Entry(index, 3, "Inhibit time", U16, RW, default=0, unit="100 us"))
                if event_timer:
                    entries.append(Entry(index, 5, "Event timer", U16, RW, default=0, unit="ms"))
            elif time_out:
                entries.append(Entry(index, 5, "Event timer", U16, RW, default=0, unit="ms"))
            objects.append(
                array(
                    index,
                    f"{direction.name}{number} communication parameter",
                    *entries,
                    kind=ObjectKind.RECORD,
                )
            )
            index = direction.mapping_index + number - 1
            mapped = [entry.mapping for entry in pdo.entries] if pdo else []
            slots = [
                Entry(
                    index,
                    sub,
                    f"Mapped object {sub}",
                    U32,
                    RW,
                    default=mapped[sub - 1] if sub <= len(mapped) else 0,
                )
                for sub in range(1, mappable + 1)
            ]
            count_entry = Entry(index, 0, "Number of mapped objects", U8, RW, default=len(mapped), high=mappable)
            objects.append(
                ObjectSpec(
                    index,
                    f"{direction.name}{number} mapping parameter",
                    ObjectKind.RECORD,
                    (count_entry, *slots),
                )
            )
    return tuple(objects)
