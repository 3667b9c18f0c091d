"""What travels in which PDO of one node, and how: a value that is shown, counted and carried out.

Source: CiA DS 301 V4.02 chapters 7.2.2 (PDO) and 7.5.2.35-38 (parameters, mapping procedure). A device profile makes the plan;
``plan_steps`` are the SDO writes that bring it about.
"""

from __future__ import annotations

import enum
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from pdgw.ds301.bus.load import GATEWAY, CyclicFrames
from pdgw.ds301.configuration import EVENT_DRIVEN_PROFILE, SYNC_TYPES, SdoStep, disable_pdo, map_pdo
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo, PdoDirection, pdo_of

_DATA_PDO_RATE = 100.0
"""Frames per second allowed for in PDOs without Controlword or Statusword."""


class Pace(enum.Enum):
    """When a PDO is sent, or taken by the device."""

    TIMER = "on change and by event timer"
    SYNC = "on SYNC"
    CHANGE = "on change only, and also read by SDO"
    """There is no event timer, and no frame for each SYNC: a frame that is lost does not come again, and silence says nothing."""
    AT_ONCE = "at once"
    """Effect of an RPDO."""


@dataclass(frozen=True)
class PlannedPdo:
    """One PDO in use."""

    pdo: Pdo
    cob_id: int
    pace: Pace
    type: int = EVENT_DRIVEN_PROFILE
    """Transmission type."""
    adopted: bool = False
    """The mapping is the device's own; it is not written."""
    keeps_cob_id: bool = False
    """The COB-ID is the device's own; it is not written."""
    event_timer: bool = False
    """Its event timer is written."""

    def __str__(self) -> str:
        names = ", ".join(str(entry) for entry in self.pdo.entries if entry.attribute)
        own = (("its own mapping", self.adopted), ("its own COB-ID", self.keeps_cob_id))
        said = [self.pace.value] if self.pace is not Pace.AT_ONCE else []
        return f"{self.pdo} {self.cob_id:03X}h: {'; '.join([names, *said, *(text for text, holds in own if holds)])}"


@dataclass(frozen=True)
class PdoPlan:
    """The PDOs of one node, and what travels by SDO for want of them."""

    rpdos: tuple[PlannedPdo, ...]
    """In the order they are sent; that of the command is the last."""
    tpdos: tuple[PlannedPdo, ...]
    written: tuple[Entry, ...] = ()
    """Objects that are written by SDO when they change."""
    read: tuple[Entry, ...] = ()
    """Objects that are read by SDO periodically."""
    notes: tuple[str, ...] = field(default=())
    """Decisions and their reasons, for the user."""

    @property
    def needs_sync(self) -> bool:
        """Whether the gateway has to send SYNC."""
        return any(item.type in SYNC_TYPES for item in (*self.rpdos, *self.tpdos))

    def uses(self, index: int) -> bool:
        """Whether a communication or mapping parameter is that of a PDO in use."""
        used = (item.pdo for item in (*self.rpdos, *self.tpdos))
        return any(index in (pdo.communication_index, pdo.mapping_index) for pdo in used)

    @property
    def commanded(self) -> Iterator[Entry]:
        """The objects that only the exchange writes."""
        for item in self.rpdos:
            yield from item.pdo.entries
        yield from self.written

    @property
    def shown(self) -> Iterator[str]:
        """The image attributes that are known of the device."""
        for item in self.tpdos:
            yield from item.pdo.attributes
        yield from (entry.attribute for entry in self.read)

    @property
    def lines(self) -> tuple[str, ...]:
        """For the user: each PDO, the objects transferred by SDO, and the notes."""
        by_sdo = ((self.written, "written by SDO when they change"), (self.read, "read by SDO every 100 ms"))
        by_sdo_lines = [f"{what}: {', '.join(map(str, entries))}" for entries, what in by_sdo if entries]
        return (*map(str, (*self.rpdos, *self.tpdos)), *by_sdo_lines, *self.notes)

    def frames(self, node_id: int, cycle_rate: float, tpdo_rate: float, often: Collection[str]) -> list[CyclicFrames]:
        """The frames of its PDOs when every value changes in every cycle; rates per second, of event-driven TPDOs ``tpdo_rate``.

        ``often``: what may change in every cycle; tasks and the slow values of PDOs without any of it do not.
        """
        found = []
        for item in (*self.rpdos, *self.tpdos):
            received = item.pdo.direction is PdoDirection.RPDO
            sender = GATEWAY if received else node_id
            rate = cycle_rate if received or item.pace is Pace.SYNC else tpdo_rate
            slow = item.pace is not Pace.SYNC and set(item.pdo.attributes).isdisjoint(often)
            rate = min(rate, _DATA_PDO_RATE) if slow else rate
            found.append(CyclicFrames(f"{item.pdo} {node_id}", item.pdo.size, rate, item.cob_id, sender))
        return found


def plan_steps(
    plan: PdoPlan, node_id: int, available: Collection[int], *, event_ms: int, inhibit_us: int
) -> list[SdoStep]:
    """The SDO writes of a plan, in the order CiA 301 demands; ``available``: communication parameters of the node."""
    planned = (*plan.rpdos, *plan.tpdos)
    used = {item.pdo.communication_index for item in planned}
    steps: list[SdoStep] = []
    for index in sorted(available):
        direction, number = pdo_of(index)
        if index not in used and direction.has_cob_id(number, node_id):
            steps.append(disable_pdo(direction, number, direction.cob_id(number, node_id)))
    for item in sorted(planned, key=lambda item: item.pdo.communication_index):
        timer = event_ms if item.event_timer else None
        writes = map_pdo(item.pdo, item.cob_id, item.type, event_ms=timer, inhibit_us=inhibit_us)
        steps += [step for step in writes if not _is_kept(item, step)]
    return steps


def _is_kept(item: PlannedPdo, step: SdoStep) -> bool:
    if step.index == item.pdo.mapping_index:
        return item.adopted
    return item.keeps_cob_id and step.is_cob_id
