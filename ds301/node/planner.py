"""The planner of a node's PDOs: what its owner needs, put into what the device has.

``PdoCapabilities`` is the data sheet's part, ``Findings`` what the device itself has answered since: after each refusal, the
plan is made again without the refused item. Pure. Source: CiA DS 301 V4.02 chapters 7.2.2 and 7.5.2.35-38 (PDO parameters,
mapping procedure), docs/translation.md "PDO layouts". Left out: bit-granular mappings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from pdgw.ds301.aborts import Abort, CanopenError, SdoAbortedError
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.ds301.configuration import (
    EVENT_DRIVEN,
    EVENT_DRIVEN_PROFILE,
    EVENT_TIMER,
    EVERY_SYNC,
    ON_SYNC_IF_CHANGED,
    SYNC_TYPES,
    SdoStep,
)
from pdgw.ds301.node.plan import Pace, PdoPlan, PlannedPdo
from pdgw.ds301.objects import CanType, Entry, ObjectAddress
from pdgw.ds301.pdo import (
    COB_ID_INVALID,
    PDO_BYTES,
    Pdo,
    PdoCapabilities,
    PdoDirection,
    PdoLayout,
    PdoSlot,
    is_communication_parameter,
    pdo_of,
)

Key = tuple[PdoDirection, int]
"""Direction and number of a PDO."""
_OBJECTS = 8
_COB_IDS = range(0x181, 0x580)
_SENT = (*SYNC_TYPES, *EVENT_DRIVEN)
"""Transmission types of TPDOs that the device sends by itself; with the others it waits for a remote request."""
_DUMMIES = 0x20
"""Objects below this are data types: place holders in a mapping."""


@dataclass
class Findings:
    """Answers of a device beyond its data sheet."""

    cob_ids: dict[Key, int] = field(default_factory=dict)
    """Sub-index 1 of each PDO it has, as it was found."""
    fixed: dict[Key, tuple[int, ...]] = field(default_factory=dict)
    """Mappings that cannot be written, as they are."""
    kept: set[Key] = field(default_factory=set)
    """COB-IDs that cannot be written."""
    dead: set[Key] = field(default_factory=set)
    """PDOs that are not valid and cannot be made so."""
    most: dict[Key, int] = field(default_factory=dict)
    """Maximum number of objects in it."""
    unmappable: set[ObjectAddress] = field(default_factory=set)
    timerless: set[Key] = field(default_factory=set)
    """TPDOs whose event timer cannot be set."""
    types: dict[Key, int] = field(default_factory=dict)
    """Transmission types that cannot be written, as they are."""
    dropped: set[ObjectAddress] = field(default_factory=set)
    """Objects accepted in a mapping whose values never arrived."""


def found_in_data_sheet(device: PdoCapabilities) -> Findings:
    """Facts of the data sheet about a device that was not read yet."""
    slots = dict(_slots(device))
    cob_ids = {key: slot.cob_id or 0 for key, slot in slots.items()}
    findings = _found(device, cob_ids, lambda key: slots[key].mapping)
    findings.types = {key: slot.type for key, slot in slots.items() if slot.type is not None and not slot.type_writable}
    return findings


def _found(device: PdoCapabilities, cob_ids: Mapping[Key, int], mapped: Callable[[Key], tuple[int, ...]]) -> Findings:
    """What the data sheet forbids to write to the PDOs that have these COB-IDs, and these mappings."""
    findings = Findings(dict(cob_ids))
    for key, slot in _slots(device):
        if key not in cob_ids:
            continue
        if not slot.mapping_writable:
            findings.fixed[key] = mapped(key)
        if not slot.cob_id_writable:
            valid = not cob_ids[key] & COB_ID_INVALID
            (findings.kept if valid else findings.dead).add(key)
    return findings


def _slots(device: PdoCapabilities) -> Iterator[tuple[Key, PdoSlot]]:
    for direction, slots in ((PdoDirection.RPDO, device.rpdos), (PdoDirection.TPDO, device.tpdos)):
        for slot in slots:
            yield (direction, slot.number), slot


def plan_pdos(
    needs: PdoLayout,
    device: PdoCapabilities,
    node_id: int,
    findings: Findings,
    *,
    sync: bool,
    sync_rpdos: bool = False,
    event_driven: int = EVENT_DRIVEN_PROFILE,
) -> PdoPlan:
    """The plan for what the owner ``needs``; ``sync``: TPDOs wait for the gateway's SYNC, ``sync_rpdos``: RPDOs too.
    ``event_driven``: transmission type of TPDOs that do not.

    What no PDO can carry is transferred by SDO, also what is essential: the owner decides whether it can operate so. The RPDO
    with an essential object is sent last. CanopenError for an RPDO that is not processed on SYNC as it has to be.
    """
    notes: list[str] = []
    shared = needs, device, node_id, findings, notes, event_driven
    rpdos, written = _Direction(PdoDirection.RPDO, *shared, sync_rpdos).planned()
    tpdos, read = _Direction(PdoDirection.TPDO, *shared, sync).planned()
    # Read values that are sent only on change by SDO as well: a lost frame would otherwise stay undetected.
    on_change = (item.pdo for item in tpdos if item.pace is Pace.CHANGE)
    read += [entry for pdo in on_change for entry in pdo.entries if entry.attribute]
    rpdos.sort(key=lambda item: (not needs.essential.isdisjoint(item.pdo.attributes), -item.pdo.number))
    return PdoPlan(tuple(rpdos), tuple(tpdos), tuple(written), tuple(read), tuple(notes))


@dataclass
class _Direction:
    """The plan of one direction; ``planned`` is called once."""

    direction: PdoDirection
    layout: PdoLayout
    device: PdoCapabilities
    node_id: int
    findings: Findings
    notes: list[str]
    event_driven: int
    sync: bool

    def __post_init__(self) -> None:
        layout = self.layout
        self.needs = layout.rpdos if self.direction is PdoDirection.RPDO else layout.tpdos
        attributes = (name for pdo in self.needs for name in pdo.attributes)
        self.essential = next((name for name in attributes if name in layout.essential), "")
        slots = (slot for key, slot in _slots(self.device) if key[0] is self.direction)
        self.slots = {slot.number: slot for slot in slots if self._is_usable(slot)}
        fixed = self.findings.fixed
        self.fixed = {number: fixed[key] for number in self.slots if (key := self._key(number)) in fixed}

    def _key(self, number: int) -> Key:
        return self.direction, number

    def _is_usable(self, slot: PdoSlot) -> bool:
        key = self._key(slot.number)
        if key not in self.findings.cob_ids or key in self.findings.dead:
            return False
        given = self.findings.types.get(key, EVERY_SYNC)
        if self.direction is PdoDirection.TPDO and given not in _SENT:
            self.notes.append(
                f"TPDO{slot.number} not used: its transmission type {given} is neither on SYNC nor event-driven, and cannot be "
                "written"
            )
            return False
        return self._own_cob_id(slot.number) is not None or self.findings.cob_ids[key] in _COB_IDS

    def _own_cob_id(self, number: int) -> int | None:
        """The COB-ID the gateway gives a PDO; None for one that has none of its own."""
        direction, node_id = self.direction, self.node_id
        return direction.cob_id(number, node_id) if direction.has_cob_id(number, node_id) else None

    # -- assignment -------------------------------------------------------------------------------------------------------

    def planned(self) -> tuple[list[PlannedPdo], list[Entry]]:
        """PDOs, and by SDO the rest."""
        free = [number for number in sorted(self.slots) if number not in self.fixed]
        pdos: list[Pdo] = []
        left: list[Entry] = []
        for pdo in self.needs:
            carried, rest = self._into(pdo, free)
            if carried is not None:
                free.remove(carried.number)
                pdos.append(carried)
            left += rest
        adopted = self._adopt(left)
        taken = {attribute for pdo in adopted for attribute in pdo.attributes}
        self.notes += [
            f"{entry} not available in a PDO: {self.layout.optional[entry.attribute]}"
            for entry in left
            if entry.attribute in self.layout.cyclic_only - taken
        ]
        taken |= self.layout.cyclic_only
        planned = [self._planned(pdo, adopted=pdo in adopted) for pdo in (*pdos, *adopted)]
        return planned, [entry for entry in left if entry.attribute not in taken]

    def _is_mappable(self, entry: Entry) -> bool:
        address = entry.address
        findings = self.findings
        if address in findings.unmappable or address in findings.dropped:
            return False
        return entry.attribute == self.essential or address in self.device.mappable

    def _into(self, pdo: Pdo, free: Sequence[int]) -> tuple[Pdo | None, list[Entry]]:
        """Assign a group to the PDO of its number, else to one that is free for others. Also return the objects left over."""
        group = pdo.entries
        requested = [entry for entry in group if self._is_mappable(entry)]
        spare = sorted({*free} - {item.number for item in self.needs})
        suited = [pdo.number, *spare, *(free if self.essential in pdo.attributes else ())]
        number = next((number for number in suited if number in free), None)
        is_mapped = self.fixed.get(pdo.number) == tuple(entry.mapping for entry in group)
        if number is None or not requested or is_mapped:
            return None, list(group)
        most = self.findings.most.get(self._key(number), _OBJECTS)
        kept = _fitting(requested, most, self.essential)
        return Pdo(self.direction, number, tuple(kept)), [entry for entry in group if entry not in kept]

    # -- mappings of the device ---------------------------------------------------------------------------------------------

    def _adopt(self, left: Sequence[Entry]) -> list[Pdo]:
        """Fixed PDOs for the remaining objects, the most useful first; every object of an RPDO must be known."""
        dropped = self.findings.dropped
        ordered = sorted(left, key=lambda entry: entry.attribute != self.essential)
        requested = {entry.address: entry for entry in ordered if entry.address not in dropped}
        adopted: list[Pdo] = []
        while requested:
            found = [
                (self._gain(pdo, requested), -pdo.number, pdo)
                for number, mapping in self.fixed.items()
                if number not in {item.number for item in adopted}
                and (pdo := self._carried(number, mapping, requested)) is not None
            ]
            if self.direction is PdoDirection.RPDO:
                # The first one has the essential object, and no other one has it.
                needed = any(entry.attribute == self.essential for entry in requested.values())
                found = [item for item in found if (self.essential in item[2].attributes) is needed]
            if not found:
                break
            _, _, best = max(found)
            adopted.append(best)
            carried = set(best.attributes)
            requested = {address: entry for address, entry in requested.items() if entry.attribute not in carried}
        return adopted

    def _gain(self, pdo: Pdo, requested: Mapping[ObjectAddress, Entry]) -> int:
        """The value of a fixed PDO: the first objects count most."""
        order = [entry.attribute for entry in requested.values()]
        return sum(1 << (len(order) - order.index(name)) for name in pdo.attributes)

    def _carried(self, number: int, mapping: tuple[int, ...], requested: Mapping[ObjectAddress, Entry]) -> Pdo | None:
        """A fixed PDO with gaps for unneeded objects; None if it cannot be used."""
        entries: list[Entry] = []
        bits = 0
        for item in mapping:
            address, size = (item >> 16, item >> 8 & 0xFF), item & 0xFF
            entry = requested.get(address)
            bits += size
            if entry is not None and entry.type.bits == size:
                entries.append(entry)
            elif size % 8 or (self.direction is PdoDirection.RPDO and address[0] >= _DUMMIES):
                return None
            else:
                entries += [Entry(*address, "", CanType.U8)] * (size // 8)
        if not any(entry.attribute for entry in entries) or bits > PDO_BYTES * 8:
            return None
        return Pdo(self.direction, number, tuple(entries))

    # -- how it travels -----------------------------------------------------------------------------------------------------

    def _planned(self, pdo: Pdo, *, adopted: bool) -> PlannedPdo:
        key = self._key(pdo.number)
        findings = self.findings
        own, found = self._own_cob_id(pdo.number), findings.cob_ids[key] & STANDARD_ID
        kept = key in findings.kept or own is None
        cob_id = own if own is not None and not (kept and found) else found
        timer = self.slots[pdo.number].event_timer and key not in findings.timerless
        pace, type_ = self._pace(key, timer=timer or self.device.common_timer)
        return PlannedPdo(pdo, cob_id, pace, type_, adopted, kept, timer and pace is Pace.TIMER)

    def _pace(self, key: Key, *, timer: bool) -> tuple[Pace, int]:
        given, number = self.findings.types.get(key), key[1]
        name = f"{self.direction.name}{number}"
        if given == ON_SYNC_IF_CHANGED and self.direction is PdoDirection.TPDO:
            self.notes.append(
                f"{name} on SYNC after a change only: its transmission type cannot be written; heartbeat and SDO monitor the "
                "device"
            )
            return Pace.CHANGE, given
        if given is not None and given in SYNC_TYPES:
            if not self.sync:
                how = "is processed on SYNC" if self.direction is PdoDirection.RPDO else "on SYNC"
                self.notes.append(f"{name} {how}: its transmission type cannot be written")
            return Pace.SYNC, given
        if self.sync and given is None:
            return Pace.SYNC, EVERY_SYNC
        if self.direction is PdoDirection.RPDO:
            if self.sync:
                raise CanopenError(f"{name} transmission type", given, "1: the telegram needs setpoints on SYNC")
            return Pace.AT_ONCE, EVENT_DRIVEN_PROFILE if given is None else given
        if timer:
            return Pace.TIMER, self.event_driven if given is None else given
        if given is None:
            index = self.direction.communication_index + number - 1
            self.notes.append(f"{name} on SYNC: it has no event timer ({index:04X}h/{EVENT_TIMER})")
            return Pace.SYNC, EVERY_SYNC
        self.notes.append(
            f"{name} on change only: neither event timer nor SYNC can be set; heartbeat and SDO monitor the device"
        )
        return Pace.CHANGE, given


def _fitting(entries: Sequence[Entry], most: int, essential: str) -> list[Entry]:
    """As many as go into one PDO, in their order; the essential one in any case."""
    kept: list[Entry] = []
    size = 0
    for entry in sorted(entries, key=lambda entry: entry.attribute != essential):
        size += entry.type.bits // 8
        if size > PDO_BYTES or len(kept) >= most:
            break
        kept.append(entry)
    return [entry for entry in entries if entry in kept]


T = TypeVar("T")
_NOT_NOW = (Abort.CANNOT_STORE, Abort.CANNOT_STORE_LOCAL_CONTROL, Abort.CANNOT_STORE_DEVICE_STATE)
"""Aborts caused by the present state of the device; they prove nothing about its capabilities."""


class DeviceMapping:
    """The findings about one device. ``read`` reads a number by SDO."""

    def __init__(self, read: Callable[[int, int], int]) -> None:
        self._read = read
        self.findings = Findings()

    def survey(self, device: PdoCapabilities, cob_ids: Mapping[int, int]) -> None:
        """Start again with the existing PDOs. An object that was never received is still not trusted."""
        found = _found(device, {pdo_of(index): cob_id for index, cob_id in cob_ids.items()}, self._mapped)
        self.findings = replace(found, dropped=self.findings.dropped)

    def drop(self, address: ObjectAddress) -> None:
        """An object that the device accepts in a mapping but does not send."""
        self.findings.dropped.add(address)

    def learn(self, step: SdoStep, error: SdoAbortedError) -> bool:
        """Learn from a refused write; False if that is not new, or does not concern the device's PDOs."""
        if error.code in _NOT_NOW:
            return False
        findings, key = self.findings, pdo_of(step.index)
        if step.is_cob_id:
            cob_id = findings.cob_ids[key] = self._read(step.index, step.subindex)
            return _is_new(findings.dead if cob_id & COB_ID_INVALID else findings.kept, key)
        if step.is_transmission_type:
            known = key in findings.types
            findings.types[key] = self._read(step.index, step.subindex)
            return not known
        if is_communication_parameter(step.index):
            return step.subindex == EVENT_TIMER and _is_new(findings.timerless, key)
        if step.subindex:
            return _is_new(findings.unmappable, (step.value >> 16, step.value >> 8 & 0xFF))
        if step.value > 1:
            findings.most[key] = step.value - 1
            return True
        known = key in findings.fixed
        findings.fixed[key] = self._mapped(key)
        return not known

    def _mapped(self, key: Key) -> tuple[int, ...]:
        """The mapping of a PDO as it is."""
        direction, number = key
        index = direction.mapping_index + number - 1
        try:
            return tuple(self._read(index, subindex) for subindex in range(1, self._read(index, 0) + 1))
        except SdoAbortedError:
            return ()


def _is_new(known: set[T], item: T) -> bool:
    """Add an item; False if it was there."""
    size = len(known)
    known.add(item)
    return len(known) > size
