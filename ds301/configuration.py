"""What has to be written to a device before it may operate: pure lists of SDO writes, in the order CiA 301 demands.

Source: CiA DS 301 V4.02 chapter 7.5.2.36 (PDO mapping procedure). Mapping order: PDO invalid, count 0, mapped objects,
count, communication parameters, PDO valid. A device profile adds its own objects.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from pdgw.ds301.errors import CanopenError
from pdgw.ds301.objects import CanType
from pdgw.ds301.pdo import COB_ID_INVALID, COB_ID_NO_REMOTE, Pdo, PdoDirection, PdoLayout

CONSUMER_HEARTBEAT = (0x1016, 1)
PRODUCER_HEARTBEAT = (0x1017, 0)
EVENT_DRIVEN_MANUFACTURER = 254
EVENT_DRIVEN_PROFILE = 255
EVERY_SYNC = 1
_COB_ID, _TRANSMISSION_TYPE = 1, 2
_EVENT_DRIVEN = (EVENT_DRIVEN_MANUFACTURER, EVENT_DRIVEN_PROFILE)


@dataclass(frozen=True, slots=True)
class SdoStep:
    """One SDO write and what it is for. ``optional``: a device without the object works as well."""

    index: int
    subindex: int
    type: CanType
    value: int
    meaning: str
    optional: bool = False

    def __post_init__(self) -> None:
        bits = self.type.bits
        low, high = (-1 << bits - 1, (1 << bits - 1) - 1) if self.type.char.islower() else (0, (1 << bits) - 1)
        if not low <= self.value <= high:
            raise CanopenError(f"{self.meaning} {self.index:04X}h/{self.subindex}", self.value, f"{low}..{high}")

    @property
    def data(self) -> bytes:
        """The bytes of the download."""
        return self.value.to_bytes(self.type.bits // 8, "little", signed=self.value < 0)


def map_pdo(
    pdo: Pdo,
    node_id: int,
    *,
    sync: bool = False,
    sync_rpdos: bool = False,
    event_ms: int | None = 0,
    inhibit_us: int = 0,
    asynchronous: int = EVENT_DRIVEN_PROFILE,
) -> list[SdoStep]:
    """The writes that make a PDO carry its entries.

    Times are for TPDOs only; ``event_ms`` is None for a device without event timers. ``sync``: TPDOs are sent on SYNC,
    ``sync_rpdos``: RPDOs are taken on SYNC. ``asynchronous`` is the transmission type without: 254 (the manufacturer's event)
    or 255 (the profile's).
    """
    cob_id = pdo.cob_id(node_id)
    communication, mapping = pdo.communication_index, pdo.mapping_index
    steps = [
        SdoStep(communication, 1, CanType.U32, cob_id | COB_ID_INVALID, f"{pdo} invalid while it is mapped"),
        SdoStep(mapping, 0, CanType.U8, 0, f"{pdo} without mapping"),
    ]
    for position, entry in enumerate(pdo.entries, 1):
        steps.append(SdoStep(mapping, position, CanType.U32, entry.mapping, f"{pdo} carries {entry}"))
    steps.append(SdoStep(mapping, 0, CanType.U8, len(pdo.entries), f"{pdo} has {len(pdo.entries)} objects"))
    cyclic = sync if pdo.direction is PdoDirection.TPDO else sync_rpdos
    transmission = EVERY_SYNC if cyclic else asynchronous
    steps.append(SdoStep(communication, 2, CanType.U8, transmission, f"{pdo} transmission type"))
    if pdo.direction is PdoDirection.TPDO and not sync:
        inhibit = inhibit_us // 100
        steps.append(SdoStep(communication, 3, CanType.U16, inhibit, f"{pdo} inhibit time", optional=True))
        if event_ms is not None:
            steps.append(SdoStep(communication, 5, CanType.U16, event_ms, f"{pdo} event timer"))
    steps.append(SdoStep(communication, 1, CanType.U32, cob_id, f"{pdo} valid"))
    return steps


def disable_pdo(direction: PdoDirection, number: int, node_id: int) -> SdoStep:
    """The write that keeps an unused PDO off the bus."""
    cob_id = direction.cob_id(number, node_id) | COB_ID_INVALID
    index = direction.communication_index + number - 1
    return SdoStep(index, 1, CanType.U32, cob_id, f"{direction.label}{number} unused")


def pdo_steps(
    layout: PdoLayout,
    node_id: int,
    available: Collection[int],
    *,
    sync: bool,
    sync_rpdos: bool = False,
    event_ms: int | None,
    inhibit_us: int,
    asynchronous: int = EVENT_DRIVEN_PROFILE,
) -> list[SdoStep]:
    """All PDO writes for a layout. ``available``: communication parameter indices the device has."""
    steps: list[SdoStep] = []
    used = {pdo.communication_index for pdo in (*layout.rpdos, *layout.tpdos)}
    for direction in PdoDirection:
        for number in range(1, len(direction.bases) + 1):
            index = direction.communication_index + number - 1
            if index in available and index not in used and (number <= 4 or node_id <= 0x3F):
                steps.append(disable_pdo(direction, number, node_id))
    for pdo in (*layout.rpdos, *layout.tpdos):
        if pdo.communication_index in available:
            steps += map_pdo(
                pdo,
                node_id,
                sync=sync,
                sync_rpdos=sync_rpdos,
                event_ms=event_ms,
                inhibit_us=inhibit_us,
                asynchronous=asynchronous,
            )
    return steps


def is_communication_parameter(index: int) -> bool:
    """Whether an index is in the area of the PDO communication parameters."""
    return 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00


def is_taken(step: SdoStep, found: int) -> bool:
    """Whether a communication parameter that a device does not let be written does what ``step`` wants.

    A COB-ID that stays valid is right while its PDO is mapped, and for one that is not used: it is the node's own. Remote
    requests are never made, and both event-driven transmission types come with the event timer.
    """
    if step.subindex == _COB_ID:
        return found | COB_ID_NO_REMOTE in (
            step.value | COB_ID_NO_REMOTE,
            step.value & ~COB_ID_INVALID | COB_ID_NO_REMOTE,
        )
    if step.subindex == _TRANSMISSION_TYPE and step.value in _EVENT_DRIVEN:
        return found in _EVENT_DRIVEN
    return found == step.value
