"""What has to be written to a drive before it may operate: pure lists of SDO writes, in the order CiA 301 demands.

Source: CiA DS 301 V4.02 chapter 7.5.2.36 (PDO mapping procedure), docs/translation.md "Loss and doubt". Mapping order:
PDO invalid, count 0, mapped objects, count, communication parameters, PDO valid.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ds301.objects import CanType
from ds301.pdo import COB_ID_INVALID, Pdo, PdoDirection
from dsp402.errors import Dsp402Error
from dsp402.pdo import PdoLayout

CONSUMER_HEARTBEAT = (0x1016, 1)
PRODUCER_HEARTBEAT = (0x1017, 0)
ABORT_OPTION = (0x6007, 0)
_EVENT_DRIVEN = 255
_EVERY_SYNC = 1


@dataclass(frozen=True, slots=True)
class SdoStep:
    """One SDO write and what it is for. ``optional``: a drive without the object works as well."""

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
            raise Dsp402Error(f"{self.meaning} {self.index:04X}h/{self.subindex}", self.value, f"{low}..{high}")

    @property
    def data(self) -> bytes:
        """The bytes of the download."""
        return self.value.to_bytes(self.type.bits // 8, "little", signed=self.value < 0)


def map_pdo(pdo: Pdo, node_id: int, *, sync: bool = False, event_ms: int = 0, inhibit_us: int = 0) -> list[SdoStep]:
    """The writes that make a PDO carry its entries. Times are for TPDOs only."""
    cob_id = pdo.cob_id(node_id)
    communication, mapping = pdo.communication_index, pdo.mapping_index
    steps = [
        SdoStep(communication, 1, CanType.U32, cob_id | COB_ID_INVALID, f"{pdo} invalid while it is mapped"),
        SdoStep(mapping, 0, CanType.U8, 0, f"{pdo} without mapping"),
    ]
    for position, entry in enumerate(pdo.entries, 1):
        steps.append(SdoStep(mapping, position, CanType.U32, entry.mapping, f"{pdo} carries {entry}"))
    steps.append(SdoStep(mapping, 0, CanType.U8, len(pdo.entries), f"{pdo} has {len(pdo.entries)} objects"))
    cyclic = sync and pdo.direction is PdoDirection.TPDO
    transmission = _EVERY_SYNC if cyclic else _EVENT_DRIVEN
    steps.append(SdoStep(communication, 2, CanType.U8, transmission, f"{pdo} transmission type"))
    if pdo.direction is PdoDirection.TPDO and not sync:
        inhibit = inhibit_us // 100
        steps.append(SdoStep(communication, 3, CanType.U16, inhibit, f"{pdo} inhibit time", optional=True))
        steps.append(SdoStep(communication, 5, CanType.U16, event_ms, f"{pdo} event timer"))
    steps.append(SdoStep(communication, 1, CanType.U32, cob_id, f"{pdo} valid"))
    return steps


def disable_pdo(direction: PdoDirection, number: int, node_id: int) -> SdoStep:
    """The write that keeps an unused PDO off the bus."""
    cob_id = direction.cob_id(number, node_id) | COB_ID_INVALID
    index = direction.communication_index + number - 1
    return SdoStep(index, 1, CanType.U32, cob_id, f"{direction.label}{number} unused")


def pdo_steps(
    layout: PdoLayout, node_id: int, available: Collection[int], *, sync: bool, event_ms: int, inhibit_us: int
) -> list[SdoStep]:
    """All PDO writes for a layout. ``available``: communication parameter indices the drive has."""
    steps: list[SdoStep] = []
    used = {pdo.communication_index for pdo in (*layout.rpdos, *layout.tpdos)}
    for direction in PdoDirection:
        for number in range(1, len(direction.bases) + 1):
            index = direction.communication_index + number - 1
            if index in available and index not in used and (number <= 4 or node_id <= 0x3F):
                steps.append(disable_pdo(direction, number, node_id))
    for pdo in (*layout.rpdos, *layout.tpdos):
        if pdo.communication_index in available:
            steps += map_pdo(pdo, node_id, sync=sync, event_ms=event_ms, inhibit_us=inhibit_us)
    return steps


def guard_steps(gateway_node_id: int, consumer_ms: int, producer_ms: int, abort_option: int) -> list[SdoStep]:
    """Heartbeat both ways and what the drive does when the gateway's stops; each is read back.

    Dsp402Error when a time does not fit into its object (65535 ms) or the node-ID is none.
    """
    if not 1 <= gateway_node_id <= 127:
        raise Dsp402Error("gateway node-ID", gateway_node_id, "1..127")
    if not 0 <= consumer_ms <= 0xFFFF:
        raise Dsp402Error("heartbeat consumer time", f"{consumer_ms} ms", "0..65535 ms")
    return [
        SdoStep(*CONSUMER_HEARTBEAT, CanType.U32, gateway_node_id << 16 | consumer_ms, "the drive guards the gateway"),
        SdoStep(*ABORT_OPTION, CanType.I16, abort_option, "reaction to a lost gateway"),
        SdoStep(*PRODUCER_HEARTBEAT, CanType.U16, producer_ms, "the drive's heartbeat"),
    ]
