"""The relationship's state machine: every state and event, and every timer by what the controller does not do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from uuid import UUID

import pytest

from pdgw.base.durations import MS
from pdgw.peers.controller.controller import Phase
from pdgw.profinet.alarms import apmx
from pdgw.profinet.alarms.apmx import PduType
from pdgw.profinet.alarms.diagnosis import AlarmSource, Diagnosis
from pdgw.profinet.blocks.alarm import Priority
from pdgw.profinet.blocks.connect_blocks import IocrType, ModuleDiffBlock
from pdgw.profinet.blocks.control import ApplicationReadyRes, ControlCommand, PrmBeginReq, PrmEndReq, ReleaseReq
from pdgw.profinet.connection.application_relation import (
    CONTROL_OPERATION,
    READY_ATTEMPTS,
    READY_INTERVAL_NS,
    ApplicationRelation,
)
from pdgw.profinet.connection.cmdev import ABORTS, TABLE, AbortCode, Action, Event, State
from pdgw.profinet.connection.connect import plan
from pdgw.profinet.device import Disconnected
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import PacketType, RpcHeader
from pdgw.profinet.rpc.records import Operation, PnioStatus, encode_arguments
from tests.support.wire.connect import AR_UUID, INITIATOR, SOURCE, Caller, blocks
from tests.support.wire.profinet import DEVICE_MAC, PLC_IP, PLC_MAC, Wire, model, project

S = 1000 * MS
P, C, A, D, X, END = (
    State.PARAMETERISING,
    State.CONFIRMING,
    State.AWAITING_DATA,
    State.DATA,
    State.ACCESS,
    State.CLOSED,
)
ENDS = [*ABORTS, Event.PEER_ERROR]
RECEIVED = PnioStatus(0xCF, 0x81, 0xFD, 0x24)
"""Of an alarm ERR from the controller."""
EXPECTED: dict[State, dict[Event, State | None]] = {
    # Next state; None: the service is refused. What is not named leaves the state as it is.
    P: {Event.PRM_END: C, Event.PRM_BEGIN: None, **dict.fromkeys(ENDS, END)},
    C: {
        Event.CONFIRMED: A,
        Event.PRM_END: None,
        Event.PRM_BEGIN: None,
        **dict.fromkeys(ENDS, END),
        Event.ACTIVITY_TIMEOUT: C,
    },
    A: {Event.DATA_RECEIVED: D, Event.PRM_END: None, Event.PRM_BEGIN: None, **dict.fromkeys(ENDS, END)},
    D: {Event.PRM_BEGIN: P, Event.PRM_END: None, **dict.fromkeys(ENDS, END), Event.ACTIVITY_TIMEOUT: D},
    X: {Event.PRM_END: None, Event.PRM_BEGIN: None, **dict.fromkeys(ENDS, END)},
    END: {Event.PRM_END: None, Event.PRM_BEGIN: None},
}


ACTIVITY_DUE, READY_DUE, NOW = 111, 222, 1000
TIMEOUT = 200 * 100 * MS
Effect = tuple[int | None, int | None, int, bool]
"""Ends of activity time and of waiting for the confirmation, calls sent, whether statuses are GOOD."""
EFFECTS: dict[tuple[State, Event], Effect] = {
    # What an event does beside the next state; nothing where it is not named.
    (P, Event.RECORD): (NOW + TIMEOUT, READY_DUE, 0, False),
    (P, Event.PRM_END): (None, NOW + READY_INTERVAL_NS, 1, True),
    (C, Event.CONFIRMED): (NOW + TIMEOUT, None, 0, True),
    (A, Event.DATA_RECEIVED): (None, READY_DUE, 0, True),
    (D, Event.PRM_BEGIN): (NOW + TIMEOUT, READY_DUE, 0, False),
    (X, Event.RECORD): (NOW + TIMEOUT, READY_DUE, 0, False),
}


class Sink:
    def __init__(self) -> None:
        self.frames: list[bytes] = []
        self.datagrams: list[bytes] = []

    def frame(self, data: bytes | bytearray) -> None:
        self.frames.append(bytes(data))

    def datagram(self, data: bytes, address: tuple[str, int]) -> None:
        self.datagrams.append(data)


def relation(sink: Sink, *, access: bool = False) -> ApplicationRelation:
    ar = project().ar(AR_UUID, 1, PLC_MAC, INITIATOR, "plc")
    items = [replace(ar, ar_type=6)] if access else project().blocks(ar)
    granted = plan(b"".join(item.encode() for item in items), model())
    alarms = AlarmSource(Diagnosis(), model(), granted.proper)
    return ApplicationRelation(granted, SOURCE, bytes(6), 1, UUID(int=5), alarms, sink, 0)


@pytest.mark.parametrize("event", Event, ids=lambda event: event.name)
@pytest.mark.parametrize("state", State, ids=lambda state: state.name)
def test_every_state_and_event_leads_where_the_standard_says(state: State, event: Event) -> None:
    sink = Sink()
    item = relation(sink, access=state is X)
    item.state = state
    item._activity_due, item._ready_due = ACTIVITY_DUE, READY_DUE
    if item.provider is not None and state in {C, A, D}:
        item.provider.open()

    def effect() -> Effect:
        good = item.provider is not None and any(item.provider.frame[20:-4])
        return item._activity_due, item._ready_due, len(sink.datagrams), good

    before = effect()
    wanted = EXPECTED[state].get(event, state)
    accepted = item.handle(event, NOW, RECEIVED if event is Event.PEER_ERROR else None)
    if wanted is not END or state is END:
        assert effect() == EFFECTS.get((state, event), before)
    if wanted is None:
        assert not accepted
        assert item.state is state
        assert not sink.frames
        return
    assert accepted
    assert item.state is wanted
    if wanted is END and state is not END:
        assert item.ended is not None
        assert item.ended.status == (RECEIVED if event is Event.PEER_ERROR else ABORTS[event].status)
        silent = state is X or event in {Event.RELEASE, Event.PEER_ERROR}
        assert bool(sink.frames) is not silent, "an alarm ERR tells the controller"
        assert not sink.datagrams
        assert item.deadline is None
    else:
        assert not sink.frames


def test_the_table_is_total() -> None:
    assert set(TABLE) == {(state, event) for state in State for event in Event}


def test_ended_relationship_is_inactive() -> None:
    sink = Sink()
    item = relation(sink)
    assert item.plan.alarm is not None
    alarm = bytes(18) + apmx.encode(
        Priority.LOW, item.reference, item.plan.alarm.reference, PduType.DATA, 0xFFFF, 0xFFFE
    )
    item.handle(Event.STOPPED, 0)
    sink.frames.clear()
    for event in Event:
        item.handle(event, 1)
    item.receive_alarm(Priority.LOW, alarm, 18, 1)
    item.poll(1 << 60)
    item.send_alarms(1 << 60)
    assert (sink.frames, sink.datagrams) == ([], [])
    assert not item.alive
    assert all(action in {Action.NOTHING, Action.REFUSE} for (state, _), (_, action) in TABLE.items() if state is END)


def test_an_alarm_of_the_controller_is_acknowledged_at_once() -> None:
    sink = Sink()
    item = relation(sink)
    assert item.plan.alarm is not None
    content = apmx.encode(Priority.LOW, item.reference, item.plan.alarm.reference, PduType.DATA, 0xFFFF, 0xFFFE)
    item.receive_alarm(Priority.LOW, bytes(18) + content, 18, 1)
    (frame,) = sink.frames
    assert apmx.PDU.unpack_from(frame, 18)[3] & 0xF == PduType.ACK


def test_data_loss_during_reparameterisation_precedes_the_activity_timeout() -> None:
    item = relation(Sink())
    for event in (Event.PRM_END, Event.CONFIRMED, Event.DATA_RECEIVED):
        item.handle(event, 5)
    assert item.consumer is not None
    item.consumer.last_ns = 6
    item.handle(Event.PRM_BEGIN, 7)
    assert item.watch_deadline == item.consumer.deadline == 6 + item.consumer.hold_ns


def test_alarm_repetition_is_due_before_a_later_data_hold_timeout() -> None:
    diagnosis = Diagnosis()
    diagnosis.set((1, 1), 0x9000)
    sink = Sink()
    item = relation(sink)
    item.alarms = AlarmSource(diagnosis, model(), item.plan.proper)
    for event in (Event.PRM_END, Event.CONFIRMED, Event.DATA_RECEIVED):
        item.handle(event, 5)
    assert item.consumer is not None
    assert item.plan.alarm is not None
    item.send_alarms(7)
    assert len(sink.frames) == 1, "sent at once"
    due = 7 + item.plan.alarm.rta_timeout * 100 * MS
    for last, nearest in ((due, due), (due - item.consumer.hold_ns - 1, due - 1)):
        item.consumer.last_ns = last
        assert item.watch_deadline == nearest


def test_with_the_loss_of_data_the_alarm_err_is_the_last_frame() -> None:
    sink = Sink()
    item = relation(sink)
    for event in (Event.PRM_END, Event.CONFIRMED, Event.DATA_RECEIVED):
        item.handle(event, 5)
    assert item.consumer is not None
    item.consumer.last_ns = 6
    item.poll(6 + item.consumer.hold_ns - 1)
    sink.frames.clear()
    item.poll(6 + item.consumer.hold_ns + S)
    assert not item.alive
    (frame,) = sink.frames
    assert apmx.PDU.unpack_from(frame, 18)[3] & 0xF == PduType.ERR
    item.poll(6 + item.consumer.hold_ns + 2 * S)
    assert len(sink.frames) == 1


def test_data_that_came_before_the_confirmation_counts_with_it() -> None:
    item = relation(Sink())
    item.handle(Event.PRM_END, 5)
    assert item.consumer is not None
    item.consumer.last_ns = 6
    item.handle(Event.CONFIRMED, 7)
    assert item.state is D


# -- timers, through a whole device -----------------------------------------------------------------------------------


def connected_by_hand() -> Caller:
    caller = Caller()
    status, _ = caller.connect(blocks(project(activity_timeout=5)))
    assert not status.value
    return caller


def pass_time(wire: Wire, ns: int) -> None:
    end = wire.now + ns
    while wire.device.next_deadline() <= end:
        wire.now = max(wire.now, wire.device.next_deadline())
        wire.device.poll(wire.now)
        wire.device.outgoing()
        wire.events += wire.device.events()
    wire.now = end


def ended(wire: Wire) -> AbortCode:
    (event,) = wire.reported(Disconnected)
    return AbortCode(event.ended.status.code2)


def test_without_prm_end_the_activity_time_ends_the_relationship() -> None:
    caller = connected_by_hand()
    pass_time(caller.wire, 499 * MS)
    assert caller.wire.device.relation is not None
    pass_time(caller.wire, 2 * MS)
    assert ended(caller.wire) is AbortCode.ACTIVITY_TIMEOUT


def control(caller: Caller, block: PrmEndReq | PrmBeginReq | ReleaseReq, operation: int) -> PnioStatus:
    return caller.call(block.encode(), operation)[0]


PRM_END = PrmEndReq(ar_uuid=AR_UUID, session_key=1, command=ControlCommand.PRM_END)
PRM_BEGIN = PrmBeginReq(ar_uuid=AR_UUID, session_key=1, command=ControlCommand.PRM_BEGIN)
RELEASE = ReleaseReq(ar_uuid=AR_UUID, session_key=1, command=ControlCommand.RELEASE)


def test_application_ready_is_repeated_and_then_the_relationship_ends() -> None:
    caller = connected_by_hand()
    wire = caller.wire
    assert not control(caller, PRM_END, Operation.CONTROL).value
    sent = 1
    while wire.device.relation is not None:
        wire.now = max(wire.now, wire.device.next_deadline())
        wire.device.poll(wire.now)
        sent += sum(address is not None for address, _ in wire.device.outgoing())
        wire.events += wire.device.events()
    assert sent == READY_ATTEMPTS
    assert wire.now == READY_ATTEMPTS * READY_INTERVAL_NS
    assert ended(wire) is AbortCode.CONTROL


def test_application_ready_comes_after_the_answer_to_prm_end() -> None:
    caller = connected_by_hand()
    control(caller, PRM_END, Operation.CONTROL)
    assert caller.addressed == [SOURCE, (PLC_IP, 34964)]


def test_controller_without_data_after_its_confirmation_is_aborted() -> None:
    wire = Wire(of_project=project(activity_timeout=10))
    wire.plc.start(0)
    wire.run(5 * S, lambda: wire.plc.provider is not None)
    wire.plc.provider = None
    wire.run(5 * S, lambda: bool(wire.reported(Disconnected)))
    assert ended(wire) is AbortCode.ACTIVITY_TIMEOUT


def test_restarted_controller_replaces_its_old_relationship() -> None:
    wire = Wire()
    wire.connect()
    wire.run(20 * MS)
    wire.connect()
    assert [event.ended.status for event in wire.reported(Disconnected)] == [AbortCode.RE_RUN.status]
    wire.run(S)
    assert wire.device.connected


def test_outputs_do_not_count_during_reparameterisation() -> None:
    wire = Wire()
    wire.connect()
    wire.plc.set_output((1, 2), bytes(4))
    wire.run(20 * MS)
    assert wire.device.output((1, 2)) == bytes(4)
    caller = Caller(wire)
    ar_uuid, session = wire.plc.ar_uuid, wire.plc.session
    begin = replace(PRM_BEGIN, ar_uuid=ar_uuid, session_key=session)
    assert not control(caller, begin, Operation.CONTROL).value
    wire.frames.clear()
    wire.run(20 * MS)
    assert wire.device.output((1, 2)) is None
    inputs = [frame for frame in wire.frames if frame[6:12] == DEVICE_MAC and frame[18:20] == b"\x80\x01"]
    plan_of_inputs = wire.plc.project.plan(IocrType.INPUT, 0x8001)
    statuses = [item.iops for item in plan_of_inputs.data.values()] + [*plan_of_inputs.iocs.values()]
    assert inputs
    assert not any(frame[20 + offset] for frame in inputs for offset in statuses)
    wire.plc.phase = Phase.PRM_END
    end = replace(PRM_END, ar_uuid=ar_uuid, session_key=session)
    header_status = control(caller, end, Operation.CONTROL)
    assert not header_status.value
    relation_now = wire.device.relation
    assert relation_now is not None
    assert relation_now.state is State.CONFIRMING
    wire.run(3 * S)
    assert wire.device.connected, "ApplicationReady is repeated and confirmed"
    assert wire.device.output((1, 2)) == bytes(4)


def test_endless_reparameterisation_is_aborted() -> None:
    wire = Wire(of_project=project(activity_timeout=3))
    wire.connect()
    wire.run(20 * MS)
    begin = replace(PRM_BEGIN, ar_uuid=wire.plc.ar_uuid, session_key=wire.plc.session)
    assert not control(Caller(wire), begin, Operation.CONTROL).value
    since = wire.now
    wire.run(10 * S, lambda: bool(wire.reported(Disconnected)))
    assert ended(wire) is AbortCode.ACTIVITY_TIMEOUT
    assert 300 * MS <= wire.now - since <= 310 * MS


def test_deadline_is_the_earliest_active_timeout() -> None:
    access = relation(Sink(), access=True)
    timeout = access.plan.ar.activity_timeout * 100 * MS
    assert access.deadline == access.watch_deadline == timeout
    item = relation(Sink())
    assert item.provider is not None
    assert (item.deadline, item.watch_deadline) == (item.provider.cycle_ns, timeout)
    item.handle(Event.PRM_END, 5)
    assert item.watch_deadline == 5 + READY_INTERVAL_NS
    for event in (Event.CONFIRMED, Event.DATA_RECEIVED):
        item.handle(event, 6)
    assert item.watch_deadline is None
    diagnosis = Diagnosis()
    diagnosis.set((1, 1), 0x9000)
    item.alarms = AlarmSource(diagnosis, model(), item.plan.proper)
    item.send_alarms(7)
    assert item.plan.alarm is not None
    assert item.watch_deadline == 7 + item.plan.alarm.rta_timeout * 100 * MS
    item.handle(Event.STOPPED, 8)
    assert item.deadline is None


@pytest.mark.parametrize("kind", [PacketType.REJECT, PacketType.FAULT])
def test_rejected_application_ready_ends_the_relationship_at_once(kind: PacketType) -> None:
    caller = connected_by_hand()
    wire = caller.wire
    control(caller, PRM_END, Operation.CONTROL)
    relation_now = wire.device.relation
    assert relation_now is not None
    header = RpcHeader(kind, INITIATOR, relation_now.activity, 0, Operation.CONTROL)
    wire.device.on_datagram(dcerpc.encode_packet(header, bytes(4)), ("192.168.0.77", 34964), wire.now)
    assert wire.device.relation is relation_now, "somebody else's rejection"
    wire.device.on_datagram(dcerpc.encode_packet(header, bytes(4)), (PLC_IP, 34964), wire.now)
    wire.events += wire.device.events()
    assert ended(wire) is AbortCode.CONTROL


def test_the_end_of_the_cable_the_device_or_its_name_ends_the_relationship_at_once() -> None:
    cases: list[tuple[Callable[[Wire], None], AbortCode]] = [
        (lambda wire: wire.device.on_link(False, wire.now), AbortCode.LINK_DOWN),
        (lambda wire: wire.device.end(Event.STOPPED, wire.now), AbortCode.REQUESTED),
        (lambda wire: wire.device.end(Event.RESET, wire.now), AbortCode.RESET),
        (lambda wire: wire.device.end(Event.NAME_CHANGED, wire.now), AbortCode.NAME_CHANGED),
    ]
    for happen, code in cases:
        wire = Wire()
        wire.connect()
        happen(wire)
        wire.carry()
        assert ended(wire) is code
        assert wire.device.output((1, 2)) is None
        wire.run(S)
        assert not wire.device.connected, "nothing restarts by itself"


# -- services from others ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("block", "operation", "code"),
    [
        (PRM_END, Operation.CONTROL, 0xDD),
        (PRM_BEGIN, Operation.CONTROL, 0xDD),
        (RELEASE, Operation.RELEASE, 0xDC),
    ],
    ids=["PrmEnd", "PrmBegin", "Release"],
)
def test_services_count_only_from_the_own_controller_and_session(
    block: PrmEndReq | PrmBeginReq | ReleaseReq, operation: int, code: int
) -> None:
    caller = connected_by_hand()
    unknown = PnioStatus(code, 0x81, 0x40, 0x05)
    unknown_sender = Caller(caller.wire, ("192.168.0.9", 50_000))
    assert control(unknown_sender, block, operation) == unknown
    assert control(caller, replace(block, session_key=2), operation) == unknown
    assert control(caller, replace(block, ar_uuid=UUID(int=8)), operation) == unknown
    item = caller.wire.device.relation
    assert item is not None
    assert item.state is State.PARAMETERISING


def test_a_service_in_the_wrong_state_is_refused_and_the_relationship_untouched() -> None:
    caller = connected_by_hand()
    assert control(caller, PRM_BEGIN, Operation.CONTROL) == PnioStatus(0xDD, 0x81, 0x40, 0x06)
    assert not control(caller, PRM_END, Operation.CONTROL).value
    assert control(caller, PRM_END, Operation.CONTROL) == PnioStatus(0xDD, 0x81, 0x40, 0x06)
    item = caller.wire.device.relation
    assert item is not None
    assert item.state is State.CONFIRMING


def test_a_damaged_control_or_release_names_its_field() -> None:
    caller = connected_by_hand()
    wrong = replace(PRM_END, command=ControlCommand.RELEASE)
    assert control(caller, wrong, Operation.CONTROL) == PnioStatus(0xDD, 0x81, 0x14, 8)
    assert control(caller, replace(RELEASE, command=ControlCommand.DONE), Operation.RELEASE) == PnioStatus(
        0xDC, 0x81, 0x28, 8
    )
    assert caller.call(RELEASE.encode()[:-1], Operation.RELEASE)[0] == PnioStatus(0xDC, 0x81, 0x28, 1)
    assert caller.call(RELEASE.encode(), Operation.CONTROL)[0] == PnioStatus(0xDD, 0x81, 0x40, 0x01)


def test_only_the_controllers_own_answer_confirms_application_ready() -> None:
    caller = connected_by_hand()
    control(caller, PRM_END, Operation.CONTROL)
    wire = caller.wire
    item = wire.device.relation
    assert item is not None
    assert item.state is State.CONFIRMING
    ar = item.plan.ar
    right = ApplicationReadyRes(ar_uuid=ar.ar_uuid, session_key=ar.session_key, command=ControlCommand.DONE)
    header = dcerpc.RpcHeader(dcerpc.PacketType.RESPONSE, INITIATOR, item.activity, 0, CONTROL_OPERATION)

    def confirm(host: str, header: dcerpc.RpcHeader, body: bytes) -> None:
        wire.device.on_datagram(
            dcerpc.encode_packet(header, encode_arguments(0, body, 4096, little=True)), (host, 1), 0
        )

    confirm("192.168.0.9", header, right.encode())
    confirm(PLC_IP, replace(header, sequence=7), right.encode())
    confirm(PLC_IP, replace(header, activity=UUID(int=1)), right.encode())
    confirm(PLC_IP, header, b"nonsense")
    confirm(PLC_IP, replace(header, packet_type=PacketType.WORKING), right.encode())
    assert item.state is State.CONFIRMING
    confirm(PLC_IP, header, right.encode())
    assert item.state is State.AWAITING_DATA


@pytest.mark.parametrize(
    ("status", "changes"),
    [
        (0xDD814006, {}),
        (0, {"session_key": 2}),
        (0, {"ar_uuid": UUID(int=8)}),
        (0, {"command": ControlCommand.RELEASE}),
    ],
    ids=["error", "session", "AR", "command"],
)
def test_unconfirmed_application_ready_ends_the_relationship(status: int, changes: dict[str, Any]) -> None:
    caller = connected_by_hand()
    control(caller, PRM_END, Operation.CONTROL)
    wire = caller.wire
    item = wire.device.relation
    assert item is not None
    right = ApplicationReadyRes(ar_uuid=AR_UUID, session_key=item.plan.ar.session_key, command=ControlCommand.DONE)
    header = RpcHeader(PacketType.RESPONSE, INITIATOR, item.activity, 0, CONTROL_OPERATION)
    body = encode_arguments(status, replace(right, **changes).encode(), 4096, little=True)
    wire.device.on_datagram(dcerpc.encode_packet(header, body), (PLC_IP, 1), 0)
    wire.events += wire.device.events()
    (event,) = wire.reported(Disconnected)
    assert event.ended.status == (PnioStatus.of(status) if status else AbortCode.CONTROL.status)


def test_application_ready_names_the_submodules_that_differ() -> None:
    sink = Sink()
    item = relation(sink)
    item.handle(Event.PRM_END, 5)
    assert item.plan.diff is None
    plain = sink.datagrams.pop()
    item = relation(sink)
    diff = ModuleDiffBlock(apis=())
    item.plan = replace(item.plan, diff=diff)
    item.handle(Event.PRM_END, 5)
    assert len(sink.datagrams[0]) == len(plain) + len(diff.encode())
    assert diff.encode() in sink.datagrams[0]
