"""Why the data of a controller does not count: its start-up, its frames, its project, or the end of its relationship."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from pdgw.base.durations import SECOND
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.base.steps import Remedy
from pdgw.profidrive.frame import STATUS_NORMAL
from pdgw.profinet.blocks.connect_blocks import ExpectedSlot, IocrType
from pdgw.profinet.connection.application_relation import ApplicationRelation, Ended
from pdgw.profinet.connection.cmdev import State
from pdgw.profinet.connection.cpm import STATUS_IGNORE, Consumer, Verdict
from pdgw.profinet.device import Refused
from pdgw.profinet.model import ACCESS_POINT_IDENT, TELEGRAM_IDENT, Module, ObjectKind, Submodule
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import Station

_NAMED_NS: Final = 30 * SECOND
"""Time for which frames that did not count are the cause."""
_DIFFERENCES: Final = 3
"""Differences of other slots that are named; the log has all."""
START_UP: Final = {
    State.PARAMETERISING: (
        "but its PrmEnd has not come",
        "read the controller's diagnostics: it must write its parameter records, then send PrmEnd",
    ),
    State.CONFIRMING: (
        "but has not confirmed ApplicationReady",
        f"let the controller receive and answer calls to its UDP port {ACYCLIC_PORT} (firewall, another PROFINET program)",
    ),
    State.AWAITING_DATA: (
        "but its first cyclic frame has not come",
        "check that the controller sends its output data, and that the switches forward frames of EtherType 8892h",
    ),
}
"""Of each state before the data: the frame that is missing, and what to do."""
_REFUSED: Final = {
    "IocrBlockReq.data_hold": "shorten this device's update time in the controller's project, or lower the number of update "
    "cycles of its watchdog",
    "IocrBlockReq.watchdog": "set the number of update cycles of this device's watchdog in the controller's project",
    "IocrBlockReq.reduction_ratio": "lengthen this device's update time in the controller's project, or shorten cycle_time_ms",
}
"""What to do about a field of a refused Connect; about others: compare the project."""


_IS_IT_ON: Final = "check that the controller is on, and its cable"


def _controller(relation: ApplicationRelation) -> str:
    return f"controller {relation.plan.ar.station_name} ({relation.source[0]})"


def of_start_up(relation: ApplicationRelation, now: int) -> Finding:
    """Which frame is missing until the data of a relationship counts, and since when."""
    if relation.state is State.AWAITING_DATA and (found := of_frames(relation, now)) is not None:
        return found
    missing, remedy = START_UP[relation.state]
    text = f"the {_controller(relation)} has connected, {missing}"
    return Finding(Reason.NO_RELATIONSHIP, text, (remedy,), since_ns=relation.since_ns)


def of_refused(refused: Refused) -> Finding:
    """Why a Connect was refused."""
    return Finding.of(Reason.NO_RELATIONSHIP, refused.text, _REFUSED.get(refused.field, ""))


def of_end(relation: ApplicationRelation, ended: Ended, now: int) -> Finding:
    """Why a relationship has ended."""
    text = f"the relationship has ended: {ended.text}"
    hold_ns = 0 if relation.consumer is None else relation.consumer.hold_ns
    frames = of_frames(relation, now, hold_ns >> 1) if ended.state in (State.AWAITING_DATA, State.DATA) else None
    if frames is not None:
        return frames._replace(evidence=f"{text}; {frames.evidence}")
    if (phase := START_UP.get(ended.state)) is not None:
        return Finding(
            Reason.NO_RELATIONSHIP, f"{text}: the {_controller(relation)} has connected, {phase[0]}", (phase[1],)
        )
    return Finding.of(Reason.PLC_LOST, text)


class EndedRelationship(NamedTuple):
    """A relationship that has ended."""

    finding: Finding
    """Why."""
    owner: str
    """Address of its controller."""


def without_relationship(
    station: Station, interface: str | None, refused: Refused | None, ended: EndedRelationship | None
) -> Finding:
    """Why there is no relationship. ``refused``: the newest Connect that was; ``ended``: the newest relationship."""
    if not station.link_up:
        text = f"the Ethernet cable of {interface} is off"
        return Finding.of(Reason.NO_RELATIONSHIP, text, "plug the cable; check the switch and the controller's port")
    if refused is not None and (ended is None or ended.owner == refused.host):
        return of_refused(refused)
    if not station.name:
        text = "this device has no name of station"
        return Finding.of(Reason.NO_RELATIONSHIP, text, "give it the name of the controller's project (DCP)")
    if ended is not None:
        end, beside = ended.finding, "" if refused is None else f"; {refused.text}"
        lost = "PLC lost: " if end.reason is Reason.PLC_LOST else ""
        return end._replace(evidence=f"{lost}{end.evidence}{beside}")
    text = f"no controller has connected to the name of station {station.name}"
    return Finding(Reason.NO_RELATIONSHIP, text, (_IS_IT_ON, *Reason.NO_RELATIONSHIP.remedy))


# -- frames -----------------------------------------------------------------------------------------------------------


def of_frames(relation: ApplicationRelation, now: int, silence_ns: int = 0) -> Finding | None:
    """What is wrong with the newest frames of a relationship; None if they count, or if there were none for some time.

    ``silence_ns``: time since the last data at which a frame is more than a late copy.
    """
    consumer = relation.consumer
    if consumer is None or consumer.refused is None:
        return None
    verdict, frame, refused_ns = consumer.refused
    counted_ns = -_NAMED_NS if consumer.data_ns is None else consumer.data_ns
    if refused_ns - counted_ns <= silence_ns or now - refused_ns > _NAMED_NS:
        return None
    reason, wrong, remedy = _wrong(verdict, frame, consumer)
    return Finding(reason, f"frames of the {_controller(relation)} come and do not count: {wrong}", remedy)


def _wrong(verdict: Verdict, frame: bytes, consumer: Consumer) -> tuple[Reason, str, Remedy]:
    if verdict is Verdict.LENGTH:
        return (
            Reason.FRAME_LAYOUT,
            f"{len(frame)} bytes, expected {consumer.size}",
            ("download the controller's project again",),
        )
    status, transfer = frame[consumer.trailer + 2 : consumer.size]
    if verdict is Verdict.STALE:
        return Reason.FRAME_COUNTER, "their cycle counter does not increase", Reason.FRAME_COUNTER.remedy
    if verdict is Verdict.TRANSFER_STATUS:
        text = f"TransferStatus {transfer:02X}h, expected 00h"
        return Reason.FRAME_INVALID, text, ("check the network card of the controller and the switches",)
    if verdict is Verdict.NOT_VALID:
        bit, remedy = "bit 2 (data valid) is 0", "set the controller to RUN; its program must provide output data"
    elif status & STATUS_IGNORE:
        bit, remedy = "bit 7 (ignore) is 1", "the controller must send its own data without the bit"
    else:
        bit, remedy = "bit 0 (primary) is 0", "make this controller the primary one"
    return Reason.FRAME_INVALID, f"DataStatus {status:02X}h, {bit}, expected {STATUS_NORMAL:02X}h", (remedy,)


# -- project ----------------------------------------------------------------------------------------------------------


def differences(expected: Iterable[ExpectedSlot], modules: Mapping[int, Module]) -> dict[int, str]:
    """What the project has and what is configured, by slot; without the slots where they agree."""
    project = {
        slot.slot: Module(
            slot.api,
            slot.ident,
            {
                item.subslot: Submodule(item.ident, item.length(IocrType.INPUT), item.length(IocrType.OUTPUT))
                for item in slot.submodules
            },
        )
        for slot in expected
    }
    found = {}
    for slot in sorted(project.keys() | modules.keys()):
        theirs, ours = project.get(slot), modules.get(slot)
        if not _agree(theirs, ours):
            text = _name if _name(theirs) != _name(ours) else _content
            found[slot] = f"slot {slot}: the controller's project has {text(theirs)}, configured is {text(ours)}"
    return found


def of_differences(texts: Mapping[int, str], slot: int) -> Finding:
    """Why the drive object of a slot has no setpoints: what its slot has, then some others."""
    others = [text for other, text in texts.items() if other != slot]
    return Finding.of(Reason.NO_RELATIONSHIP, "; ".join([*filter(None, [texts.get(slot)]), *others[:_DIFFERENCES]]))


def _agree(theirs: Module | None, ours: Module | None) -> bool:
    """A project may omit submodules without data."""
    if ours is None:
        return False
    needed = {subslot for subslot, item in ours.submodules.items() if item.inputs or item.outputs}
    if theirs is None:
        return not needed
    return (
        (theirs.api, theirs.ident) == (ours.api, ours.ident)
        and all(ours.submodules.get(subslot) == item for subslot, item in theirs.submodules.items())
        and needed <= theirs.submodules.keys()
    )


def _name(module: Module | None) -> str:
    if module is None:
        return "nothing"
    kinds = {kind.ident: kind.name.lower() for kind in ObjectKind}
    numbers = [item.ident - TELEGRAM_IDENT for item in module.submodules.values()]
    telegrams = [f"telegram {number}" for number in numbers if 0 < number < ACCESS_POINT_IDENT - TELEGRAM_IDENT]
    return " with ".join([kinds.get(module.ident, f"module {module.ident:08X}h"), *telegrams])


def _content(module: Module | None) -> str:
    if module is None:
        return _name(module)
    parts = [
        f"{subslot:X}h: {item.ident:08X}h, {item.inputs} + {item.outputs} bytes"
        for subslot, item in sorted(module.submodules.items())
    ]
    return f"{_name(module)} in API {module.api:X}h (subslots {'; '.join(parts)})"
