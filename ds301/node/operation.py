"""What a node does by one plan of its PDOs: a record that is made with the plan, and dropped at the next bring-up.

Whatever belongs to one operation is here, so nothing of it has to be set back when another one begins. Beside the PDOs, the parts
of its client read and write objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from pdgw.base.durations import MS
from pdgw.ds301.configuration import EVERY_SYNC
from pdgw.ds301.node.doubles import Doubles, Jumps, SecondTpdos
from pdgw.ds301.node.node import NodeSettings, TpdoSlot
from pdgw.ds301.node.plan import Pace, PdoPlan

NEVER: Final = 1 << 62
"""A time that never comes."""
_MISSED: Final = 4
"""So often may a TPDO be missed that does not come with each SYNC."""


class Unconfirmed(NamedTuple):
    """Why the cyclic side must not use a node although it is online: what the gateway relies on was written, or is now."""

    text: str
    check_at: int = NEVER
    """When the node is brought up again because of it."""


class Operation:
    """One operation of a node. Without TPDOs: that of a node that was not mapped yet."""

    def __init__(self, slots: Sequence[TpdoSlot] = (), timeout_ns: int = 0, length_errors: int = 0) -> None:
        self._length_errors = length_errors
        """TPDOs of earlier operations that were shorter than their mapping."""
        self.slots = slots
        """The newest data of each TPDO."""
        self.timeout_ns = timeout_ns
        """Longest time between two frames of a TPDO whose silence is a loss."""
        self.sends = False
        """The node takes RPDOs: from the end of the bring-up, also after a loss, until it answers again."""
        self.stopped = False
        """Its owner has stopped it by NMT."""
        self.bus_failures = 0
        """Failures of the bus before the node came online."""
        self.parts: list[Part] = []
        """What is done beside the PDOs, in this order."""
        self.lost = ""
        """Empty, or what a part has found: the node counts as lost."""
        self.position = ("", 0)
        """Attribute of the image with the position, and position units of one revolution; 0: unknown."""

    @property
    def length_errors(self) -> int:
        """TPDOs of this and of earlier operations that were shorter than their mapping, and ignored."""
        return self._length_errors + sum(slot.errors for slot in self.slots)

    def begin(self, parts: Iterable[Part], bus_failures: int) -> None:
        """The node is online."""
        self.parts = [part for part in parts if part.has_work]
        self.sends = True
        self.bus_failures = bus_failures

    def missing(self) -> list[str]:
        """The TPDOs that have not come yet."""
        return [str(slot.pdo) for slot in self.slots if slot.data is None and slot.watched]

    def compare_positions(self, doubles: Doubles) -> None:
        """Begin to look for positions that contradict each other: two devices send them."""
        attribute, turn = self.position
        for slot in self.slots:
            if turn and attribute in slot.pdo.attributes:
                slot.jumps = Jumps(doubles, slot.pdo, attribute, turn)


class Part:
    """One part of a client, beside the PDOs of its node. It may set ``lost`` of an operation."""

    @property
    def has_work(self) -> bool:
        """Whether it may have work in the operation that begins now."""
        return True

    def configure(self, plan: PdoPlan, operation: Operation) -> None:
        """The PDOs were mapped for another operation."""

    def due(self, now: int) -> bool:
        """Whether there is work now; asked every 20 ms while the node is online."""
        return False

    def work(self, now: int) -> None:
        """Read and write objects, in the node's task."""


def planned(plan: PdoPlan, settings: NodeSettings, image: object, doubles: Doubles, length_errors: int) -> Operation:
    """The operation by a plan. ``image`` takes the values of the TPDOs; ``length_errors`` are those of earlier operations."""
    slots = [TpdoSlot(item.pdo, image, item.cob_id, watched=item.pace is not Pace.CHANGE) for item in plan.tpdos]
    for slot, item in zip(slots, plan.tpdos, strict=True):
        slot.second = SecondTpdos(doubles, str(slot.pdo)) if item.pace is Pace.SYNC else None
    timeout_ns = settings.tpdo_limit_ns
    if plan.needs_sync:
        syncs = max((item.type for item in plan.tpdos if item.pace is Pace.SYNC), default=EVERY_SYNC)
        cycles = max(settings.tpdo_timeout_factor, _MISSED * syncs)
        timeout_ns = max(timeout_ns, cycles * settings.cycle_ms * MS)
    return Operation(slots, timeout_ns, length_errors)
