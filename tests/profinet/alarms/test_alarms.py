"""The alarm machine's table walked, and diagnosis as the controller sees it."""

from __future__ import annotations

import dataclasses

import pytest

from pdgw.base.durations import MS
from pdgw.profinet.alarms import apmx
from pdgw.profinet.alarms.apmx import PDU, TABLE, AlarmMachine, AlarmRelation, Event, PduType, State
from pdgw.profinet.alarms.diagnosis import AlarmSource, Diagnosis, Notification
from pdgw.profinet.blocks.alarm import (
    ACKS,
    AR_DIAGNOSIS,
    CHANNEL_DIAGNOSIS,
    SUBMODULE_DIAGNOSIS,
    AlarmNotification,
    AlarmType,
    MessageClass,
    Priority,
    Severity,
)
from pdgw.profinet.connection.cmdev import AbortCode
from pdgw.profinet.device import Disconnected
from tests.support.wire.profinet import DEVICE_MAC, PLC_MAC, Wire, model, project

POINT = (1, 1)
OWN, PEER = 7, 0x42
RELATION = AlarmRelation(PLC_MAC, DEVICE_MAC, PEER, OWN, 100 * MS, 3)
START = 18


def notification() -> Notification:
    diagnosis = Diagnosis()
    diagnosis.set(POINT, MessageClass.MAINS)
    found = AlarmSource(diagnosis, model(), frozenset(project().submodules)).next()
    assert found is not None
    return found


def machine() -> AlarmMachine:
    return AlarmMachine(RELATION, Priority.LOW)


def pdu(kind: PduType, sequence: int, ack: int, content: bytes = b"", *, own: int = OWN, peer: int = PEER) -> bytes:
    """A PDU of the controller with a tagged header."""
    return bytes(START) + apmx.encode(Priority.LOW, own, peer, kind, sequence, ack, content)


def fields(frame: bytes) -> tuple[int, ...]:
    """Type, SendSeqNum, AckSeqNum."""
    _, _, _, kind, _, sequence, ack, _ = PDU.unpack_from(frame, START)
    return kind & 0xF, sequence, ack


def alarm_ack(item: Notification, **changes: int) -> bytes:
    block = item.block
    return dataclasses.replace(
        ACKS[Priority.LOW](
            alarm_type=block.alarm_type,
            api=block.api,
            slot=block.slot,
            subslot=block.subslot,
            specifier=block.specifier,
            status=0,
        ),
        **changes,  # type: ignore[arg-type]
    ).encode()


IDLE, SENT, ACKED = State.IDLE, State.WAIT_ACK, State.WAIT_ALARM_ACK
EXPECTED: dict[State, dict[Event, tuple[State, list[PduType]]]] = {
    # Next state and what is sent. Written down here a second time: a table that is wrong fails.
    IDLE: {
        Event.SEND: (SENT, [PduType.DATA]),
        Event.ACK: (IDLE, []),
        Event.ALARM_ACK: (IDLE, [PduType.ACK]),
        Event.OTHER_DATA: (IDLE, [PduType.ACK]),
        Event.REPEATED: (IDLE, [PduType.ACK]),
        Event.TIMEOUT: (IDLE, []),
        Event.EXHAUSTED: (IDLE, []),
    },
    SENT: {
        Event.SEND: (SENT, []),
        Event.ACK: (ACKED, []),
        Event.ALARM_ACK: (IDLE, [PduType.ACK]),
        Event.OTHER_DATA: (SENT, [PduType.ACK]),
        Event.REPEATED: (SENT, [PduType.ACK]),
        Event.TIMEOUT: (SENT, [PduType.DATA]),
        Event.EXHAUSTED: (IDLE, []),
    },
    ACKED: {
        Event.SEND: (ACKED, []),
        Event.ACK: (ACKED, []),
        Event.ALARM_ACK: (IDLE, [PduType.ACK]),
        Event.OTHER_DATA: (ACKED, [PduType.ACK]),
        Event.REPEATED: (ACKED, [PduType.ACK]),
        Event.TIMEOUT: (ACKED, []),
        Event.EXHAUSTED: (ACKED, []),
    },
}


def test_the_table_is_total() -> None:
    assert set(TABLE) == {(state, event) for state in State for event in Event}


@pytest.mark.parametrize("event", Event, ids=lambda event: event.name)
@pytest.mark.parametrize("state", State, ids=lambda state: state.name)
def test_every_state_and_event_leads_where_the_standard_says(state: State, event: Event) -> None:
    item = machine()
    reported = notification()
    if state is not IDLE:
        item.send(reported, 0)
    if state is ACKED:
        item.receive(pdu(PduType.ACK, 0xFFFE, 0xFFFF), START, 0)
    assert item.state is state
    item.frames.clear()
    content = alarm_ack(reported)
    if event is Event.SEND:
        assert item.send(reported, 1) is (state is IDLE)
    elif event is Event.ACK:
        item.receive(pdu(PduType.ACK, 0xFFFE, 0xFFFF), START, 1)
    elif event is Event.ALARM_ACK:
        item.receive(pdu(PduType.DATA, 0xFFFF, 0xFFFF, content), START, 1)
    elif event is Event.OTHER_DATA:
        item.receive(pdu(PduType.DATA, 0xFFFF, 0xFFFE, b"anything"), START, 1)
    elif event is Event.REPEATED:
        item.receive(pdu(PduType.DATA, 0xFFFE, 0xFFFE, b"anything"), START, 1)
    elif event is Event.TIMEOUT:
        item.poll(100 * MS)
    elif event is Event.EXHAUSTED:
        for attempt in range(1, 5):
            item.frames.clear()
            item.poll(attempt * 100 * MS)
    after, sent = EXPECTED[state][event]
    assert item.state is after
    assert [fields(frame)[0] for frame in item.frames] == sent
    assert item.failed is ((state, event) == (SENT, Event.EXHAUSTED))
    started = {(IDLE, Event.SEND): 1, (SENT, Event.TIMEOUT): 100 * MS}.get((state, event), 0)
    assert item.deadline == (started + 100 * MS if after is SENT else None)
    if item.failed:
        return
    # What is outstanding can still be finished, and the next notification has the next number.
    outstanding = after is not IDLE
    finished = outstanding or state is not IDLE
    if outstanding:
        peer = 0x0000 if event is Event.OTHER_DATA else 0xFFFF
        item.receive(pdu(PduType.DATA, peer, 0xFFFF, content), START, 2)
        assert item.state is IDLE
    item.frames.clear()
    assert item.send(reported, 3)
    assert [fields(frame)[:2] for frame in item.frames] == [(PduType.DATA, 0x0000 if finished else 0xFFFF)]


def test_sequence_numbers_start_at_ffff_and_wrap_below_8000() -> None:
    item = machine()
    own, peer = 0xFFFF, 0xFFFF
    for turn in range(8):
        if turn == 4:  # the numbers between have nothing of their own
            own = peer = item._sequence = item._expected = 0x7FFE
        reported = notification()
        assert item.send(reported, 0)
        assert fields(item.frames.pop())[1] == own
        item.receive(pdu(PduType.ACK, 0, own), START, 0)
        item.receive(pdu(PduType.DATA, peer, own, alarm_ack(reported)), START, 0)
        assert fields(item.frames.pop()) == (PduType.ACK, own, peer)
        own, peer = apmx.following(own), apmx.following(peer)
    assert own == 2


def test_a_repetition_has_the_same_sequence_number_and_the_number_of_them_is_agreed() -> None:
    item = machine()
    item.send(notification(), 0)
    for attempt in range(1, 5):
        item.poll(attempt * 100 * MS)
    assert [fields(frame) for frame in item.frames] == [(PduType.DATA, 0xFFFF, 0xFFFE)] * 4
    assert item.failed


def test_each_notification_has_all_its_repetitions() -> None:
    item = machine()
    reported = notification()
    item.send(reported, 0)
    for attempt in range(1, 4):
        item.poll(attempt * 100 * MS)
    item.receive(pdu(PduType.DATA, 0xFFFF, 0xFFFF, alarm_ack(reported)), START, 301 * MS)
    item.frames.clear()
    item.send(reported, 400 * MS)
    for attempt in range(5, 8):
        item.poll(attempt * 100 * MS)
    assert len(item.frames) == 4
    assert not item.failed
    item.poll(800 * MS)
    assert item.failed


@pytest.mark.parametrize(
    ("priority", "frame_id", "tag", "ack_block"),
    [(Priority.HIGH, "fc01", "c000", 0x8001), (Priority.LOW, "fe01", "a000", 0x8002)],
)
def test_an_alarm_exchange_byte_by_byte(priority: Priority, frame_id: str, tag: str, ack_block: int) -> None:
    item = AlarmMachine(RELATION, priority)
    reported = notification()
    item.send(reported, 0)
    head = f"020000000001 020000000002 8100{tag} 8892 {frame_id} 0042 0007"
    content = reported.block.encode()
    data = bytes.fromhex(f"{head} 11 11 ffff fffe {len(content):04x}") + content
    assert item.frames == [data.ljust(60, b"\0")]
    item.frames.clear()
    ack = bytes.fromhex(f"{frame_id} 0007 0042 13 01 fffe ffff 0000")
    assert not item.receive(bytes(START) + ack, START, 1)
    assert item.state is State.WAIT_ALARM_ACK
    block = ACKS[priority](
        alarm_type=1, api=reported.block.api, slot=1, subslot=1, specifier=reported.block.specifier, status=0
    ).encode()
    assert int.from_bytes(block[:2], "big") == ack_block
    answer = bytes.fromhex(f"{frame_id} 0007 0042 11 11 ffff ffff {len(block):04x}") + block
    item.receive(bytes(START) + answer, START, 2)
    assert item.idle
    assert item.frames == [bytes.fromhex(f"{head} 13 01 ffff ffff 0000").ljust(60, b"\0")]
    assert item.error(0xCF81FD05) == bytes.fromhex(f"{head} 14 01 ffff ffff 0004 cf81fd05").ljust(60, b"\0")


def test_answer_to_another_notification_is_ignored() -> None:
    item = machine()
    reported = notification()
    item.send(reported, 0)
    item.receive(pdu(PduType.DATA, 0xFFFF, 0x0000, alarm_ack(reported)), START, 0)
    assert item.state is State.WAIT_ACK


@pytest.mark.parametrize(
    "frame",
    [
        pdu(PduType.ACK, 0, 0xFFFF, own=8),
        pdu(PduType.ACK, 0, 0xFFFF, peer=8),
        pdu(PduType.ACK, 0, 0x0000),
        pdu(PduType.NACK, 0xFFFF, 0xFFFF),
        pdu(PduType.DATA, 0x0005, 0xFFFF, b"out of sequence"),
        pdu(PduType.ACK, 0, 0xFFFF)[:-1],
        pdu(PduType.DATA, 0xFFFF, 0xFFFF, b"longer")[:-3],
        pdu(PduType.ACK, 0, 0xFFFF)[: START + 6] + b"\x23" + pdu(PduType.ACK, 0, 0xFFFF)[START + 7 :],
        pdu(PduType.ERR, 0, 0, b"1234", own=8),
    ],
    ids=["own reference", "peer reference", "sequence", "NACK", "DATA sequence", "short", "length", "version", "ERR"],
)
def test_invalid_alarm_pdus_are_dropped_without_an_effect(frame: bytes) -> None:
    item = machine()
    item.send(notification(), 0)
    item.frames.clear()
    assert item.receive(frame, START, 1) is None
    assert (item.state, item.frames, item.failed, item.dropped) == (State.WAIT_ACK, [], False, 1)


def test_data_without_alarm_ack_is_acknowledged_but_finishes_nothing() -> None:
    item = machine()
    item.send(notification(), 0)
    item.frames.clear()
    item.receive(pdu(PduType.DATA, 0xFFFF, 0xFFFF, b"anything"), START, 1)
    assert item.state is SENT
    assert [fields(frame)[0] for frame in item.frames] == [PduType.ACK]


def test_an_alarm_ack_of_another_alarm_is_acknowledged_but_finishes_nothing() -> None:
    item = machine()
    reported = notification()
    item.send(reported, 0)
    item.receive(pdu(PduType.DATA, 0xFFFF, 0xFFFF, alarm_ack(reported, slot=9)), START, 0)
    assert item.state is State.WAIT_ACK
    item.receive(pdu(PduType.DATA, 0x0000, 0xFFFF, alarm_ack(reported, status=0xDE80B000)), START, 0)
    assert (item.state, item.refused) == (State.IDLE, 1)


def source(diagnosis: Diagnosis, places: frozenset[tuple[int, int]] | None = None) -> AlarmSource:
    return AlarmSource(diagnosis, model(), frozenset(project().submodules) if places is None else places)


def test_each_alarm_of_a_relationship_has_the_next_sequence_number_and_its_own_place() -> None:
    diagnosis = Diagnosis()
    item = source(diagnosis)
    for number in range(0x802):
        if number % 2:
            diagnosis.clear((2, 1), MessageClass.MAINS)
        else:
            diagnosis.set((2, 1), MessageClass.MAINS)
        reported = item.next()
        assert reported is not None
        block = reported.block
        assert (block.api, block.slot, block.subslot) == (0x3A00, 2, 1)
        assert (block.module_ident, block.submodule_ident) == (0x1001, 0x1FFFF)
        assert block.specifier & 0x7FF == number & 0x7FF
        assert item.next() is None
        assert not item.pending


def test_returning_submodules_of_the_project_are_reported_in_order() -> None:
    item = source(Diagnosis(), frozenset({(1, 2), (3, 2)}))
    for place in ((3, 2), (2, 2), (1, 2), (3, 2)):
        item.returned(place)
    found = [item.next() for _ in range(3)]
    reported = [(entry.block.slot, entry.block.specifier, entry.block.payload) for entry in found if entry is not None]
    assert reported == [(3, 0, b""), (1, 1, b"")]


def test_the_record_of_diagnosis_names_the_place_of_each_entry() -> None:
    diagnosis = Diagnosis()
    diagnosis.set((3, 1), MessageClass.ACTUAL_VALUE, Severity.MAINTENANCE_DEMANDED)
    diagnosis.set((2, 1), MessageClass.MAINS)
    assert diagnosis.record(model(), [(2, 1), (1, 1), (3, 1)], set(Severity)) == bytes.fromhex(
        "0010 0016 01 01 00003a00 0002 0001 8000 0800 8000 8000 6800 9001 0000"
        "0010 0016 01 01 00003a00 0003 0001 8000 0800 8000 8000 6c00 900a"
    )
    diagnosis.clear((2, 1), MessageClass.MAINS)
    assert not diagnosis.of((2, 1))
    assert diagnosis.of((3, 1))
    assert diagnosis.record(model(), [(2, 1)], set(Severity)) == b""


# -- through a device and a controller --------------------------------------------------------------------------------


def reported(wire: Wire) -> list[tuple[int, tuple[int, int], int]]:
    """Alarm type, place and error type (0 without)."""
    return [
        (item.alarm_type, (item.slot, item.subslot), int.from_bytes(item.payload[6:8], "big"))
        for item in wire.plc.learned.alarms
    ]


def test_each_class_of_a_drive_appears_and_disappears_once() -> None:
    wire = Wire()
    wire.connect()
    for number in MessageClass:
        wire.device.set_diagnosis(POINT, number)
        wire.device.set_diagnosis(POINT, number)
    wire.run(200 * MS)
    assert reported(wire) == [(AlarmType.DIAGNOSIS, POINT, number) for number in MessageClass]
    wire.plc.learned.alarms.clear()
    wire.device.clear_diagnosis(POINT)
    wire.run(200 * MS)
    assert reported(wire) == [(AlarmType.DIAGNOSIS_DISAPPEARS, POINT, number) for number in MessageClass]
    last: list[AlarmNotification] = wire.plc.learned.alarms
    specifiers = [int.from_bytes(item.payload[4:6], "big") >> 11 & 3 for item in last]
    assert specifiers == [3] * (len(last) - 1) + [2]
    assert last[-1].specifier & (SUBMODULE_DIAGNOSIS | AR_DIAGNOSIS) == 0
    assert last[0].specifier & (SUBMODULE_DIAGNOSIS | AR_DIAGNOSIS) == SUBMODULE_DIAGNOSIS | AR_DIAGNOSIS
    assert all(item.specifier & CHANNEL_DIAGNOSIS for item in last)


def test_new_controller_gets_the_present_diagnosis() -> None:
    wire = Wire()
    wire.device.set_diagnosis(POINT, MessageClass.SAFETY)
    wire.device.set_diagnosis((3, 1), MessageClass.TEMPERATURE, severity=Severity.MAINTENANCE_REQUIRED)
    wire.connect()
    wire.run(100 * MS)
    assert reported(wire) == [
        (AlarmType.DIAGNOSIS, POINT, MessageClass.SAFETY),
        (AlarmType.DIAGNOSIS, (3, 1), MessageClass.TEMPERATURE),
    ]
    severities = [int.from_bytes(item.payload[4:6], "big") >> 9 & 3 for item in wire.plc.learned.alarms]
    assert severities == [Severity.FAULT, Severity.MAINTENANCE_REQUIRED]


def test_intermittent_fault_does_not_fill_the_alarm_queue() -> None:
    wire = Wire()
    wire.connect()
    wire.plc.answer_alarms = False
    for _ in range(1000):
        wire.device.set_diagnosis(POINT, MessageClass.MAINS)
        wire.run(MS // 10)
        wire.device.clear_diagnosis(POINT, MessageClass.MAINS)
    wire.plc.answer_alarms = True
    wire.run(500 * MS)
    assert [kind for kind, _, _ in reported(wire)] == [AlarmType.DIAGNOSIS, AlarmType.DIAGNOSIS_DISAPPEARS]


def test_returning_drive_is_one_return_of_submodule_alarm() -> None:
    wire = Wire()
    wire.connect()
    wire.device.returned((1, 2))
    wire.device.returned((1, 2))
    wire.run(50 * MS)
    assert reported(wire) == [(AlarmType.RETURN_OF_SUBMODULE, (1, 2), 0)]


def test_a_controller_that_acknowledges_no_alarm_loses_its_relationship() -> None:
    wire = Wire()
    wire.connect()
    wire.plc.answer_alarms = False
    wire.device.set_diagnosis(POINT, MessageClass.MAINS)
    since = wire.now
    wire.run(2000 * MS, lambda: not wire.device.connected)
    assert wire.now - since == 4 * 100 * MS
    (event,) = wire.reported(Disconnected)
    assert event.ended.status == AbortCode.ALARM_UNACKNOWLEDGED.status


def test_an_alarm_err_of_the_controller_ends_the_relationship_without_an_answer() -> None:
    wire = Wire()
    wire.connect()
    relation = wire.device.relation
    assert relation is not None
    header = DEVICE_MAC + PLC_MAC + bytes.fromhex("8100a0008892")
    content = AbortCode.REQUESTED.status.value.to_bytes(4, "big")
    right = header + apmx.encode(Priority.LOW, relation.reference, 0x42, PduType.ERR, 0, 0, content)
    unknown_sender = bytearray(right)
    unknown_sender[11] = 0x77
    wire.device.on_frame(bytes(unknown_sender), wire.now)
    assert wire.device.connected
    sent = len(wire.device.outgoing())
    wire.device.on_frame(right, wire.now)
    assert sent == 0
    assert not wire.device.outgoing()
    assert not wire.device.connected
    assert [type(event) for event in wire.device.events()] == [Disconnected]
