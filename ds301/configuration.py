"""What has to be written to a device before it may operate: pure lists of SDO writes, in the order CiA 301 demands.

Source: CiA DS 301 V4.02 chapter 7.5.2.36 (PDO mapping procedure). Mapping order: PDO invalid, count 0, mapped objects,
count, communication parameters, PDO valid. A device profile adds its own objects.
"""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import CanType
from pdgw.ds301.pdo import COB_ID_INVALID, COB_ID_NO_REMOTE, Pdo, PdoDirection, is_communication_parameter

EVENT_DRIVEN_MANUFACTURER = 254
EVENT_DRIVEN_PROFILE = 255
ON_SYNC_IF_CHANGED = 0
"""A TPDO is sent on the SYNC that follows a change."""
EVERY_SYNC = 1
SYNC_TYPES = range(241)
"""Transmission types of PDOs that wait for a SYNC."""
_COB_ID, TRANSMISSION_TYPE, EVENT_TIMER = 1, 2, 5
"""Sub-indices of a communication parameter."""
EVENT_DRIVEN = (EVENT_DRIVEN_MANUFACTURER, EVENT_DRIVEN_PROFILE)


@dataclass(frozen=True, slots=True)
class SdoStep:
    """One SDO write and its purpose. ``optional``: a device without the object works as well.

    ``time``: milliseconds, in the low 16 bits. A device may round them to the step of its timer: CiA 301 requires no resolution.
    """

    index: int
    subindex: int
    type: CanType
    value: int
    meaning: str
    optional: bool = False
    time: bool = False

    def __post_init__(self) -> None:
        low, high = self.type.integer_range
        if not low <= self.value <= high:
            raise CanopenError(f"{self.meaning} {self.index:04X}h/{self.subindex}", self.value, f"{low}..{high}")

    @property
    def data(self) -> bytes:
        """The bytes of the download."""
        return self.value.to_bytes(self.type.bits // 8, "little", signed=self.value < 0)

    def is_held_by(self, found: int) -> bool:
        """Whether a device that reads ``found`` has accepted the value. It may round a time up or down, by half of it at most."""
        if not self.time:
            return found == self.value
        return found >> 16 == self.value >> 16 and abs(found - self.value) <= (self.value & 0xFFFF) // 2

    @property
    def is_cob_id(self) -> bool:
        """The COB-ID of a PDO."""
        return is_communication_parameter(self.index) and self.subindex == _COB_ID

    @property
    def is_transmission_type(self) -> bool:
        """The transmission type of a PDO."""
        return is_communication_parameter(self.index) and self.subindex == TRANSMISSION_TYPE


def map_pdo(
    pdo: Pdo, cob_id: int, type_: int = EVENT_DRIVEN_PROFILE, *, event_ms: int | None = None, inhibit_us: int = 0
) -> list[SdoStep]:
    """The writes that make a PDO carry its entries with this COB-ID and transmission type.

    Times are for TPDOs that do not wait for a SYNC only; ``event_ms``: None for one whose event timer is not used.
    """
    communication, mapping = pdo.communication_index, pdo.mapping_index
    steps = [
        SdoStep(communication, _COB_ID, CanType.U32, cob_id | COB_ID_INVALID, f"{pdo} invalid while it is mapped"),
        SdoStep(mapping, 0, CanType.U8, 0, f"{pdo} without mapping"),
    ]
    for position, entry in enumerate(pdo.entries, 1):
        steps.append(SdoStep(mapping, position, CanType.U32, entry.mapping, f"{pdo} carries {entry}"))
    steps.append(SdoStep(mapping, 0, CanType.U8, len(pdo.entries), f"{pdo} has {len(pdo.entries)} objects"))
    steps.append(SdoStep(communication, TRANSMISSION_TYPE, CanType.U8, type_, f"{pdo} transmission type"))
    if pdo.direction is PdoDirection.TPDO and type_ not in SYNC_TYPES:
        inhibit = inhibit_us // 100
        steps.append(SdoStep(communication, 3, CanType.U16, inhibit, f"{pdo} inhibit time", optional=True))
        if event_ms is not None:
            steps.append(SdoStep(communication, EVENT_TIMER, CanType.U16, event_ms, f"{pdo} event timer"))
    steps.append(SdoStep(communication, _COB_ID, CanType.U32, cob_id, f"{pdo} valid"))
    return steps


def disable_pdo(direction: PdoDirection, number: int, cob_id: int) -> SdoStep:
    """The write that keeps an unused PDO off the bus, with the COB-ID that it has or would have."""
    index = direction.communication_index + number - 1
    return SdoStep(index, _COB_ID, CanType.U32, cob_id | COB_ID_INVALID, f"{direction.name}{number} unused")


def has_effect(step: SdoStep, found: int) -> bool:
    """Whether a communication parameter that a device does not accept already has the effect of ``step``.

    A COB-ID that stays valid is right while its PDO is mapped, and for an unused one: it is the node's own. Remote requests
    are never made, and both event-driven transmission types come with the event timer.
    """
    if step.subindex == _COB_ID:
        return found | COB_ID_NO_REMOTE in (
            step.value | COB_ID_NO_REMOTE,
            step.value & ~COB_ID_INVALID | COB_ID_NO_REMOTE,
        )
    if step.subindex == TRANSMISSION_TYPE and step.value in EVENT_DRIVEN:
        return found in EVENT_DRIVEN
    return found == step.value
