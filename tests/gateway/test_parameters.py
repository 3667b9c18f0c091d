"""The parameter channel of a running gateway: records, SDO to simulated drives."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from uuid import UUID

import pytest
from canopen.sdo import SdoAbortedError

from pdgw.ds301.aborts import ABORT_TEXTS, Abort
from pdgw.ds301.loop import SECOND, Event
from pdgw.ds301.objects import Entry
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.parameters.objects import error_of_abort
from pdgw.gateway.reasons import FaultNumber
from pdgw.gateway.status import snapshot
from pdgw.gateway.store import ParameterStore
from pdgw.peers.drive.family import DRIVE_FAULTS
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import LIST_PNUS, PARAMETERS, Scope
from pdgw.profidrive.parameters.codec import Address, Attribute, Values, decode_response
from pdgw.profidrive.parameters.description import Description
from pdgw.profidrive.parameters.errors import ParameterErrorNumber as Number
from pdgw.profinet.rpc import identification
from pdgw.tools.parameters.client import ParameterClient
from pdgw.tools.status_text import status_lines
from tests.support.daemon import OFF, Plc, axis, configuration, drive_of, exchanging, serving, until
from tests.support.daemon import client as client_of


def gateway(axes: str, *, transport: str = "") -> AbstractContextManager[tuple[Daemon, ParameterClient]]:
    return serving(configuration(axes, transport=transport), 1)


@pytest.fixture(scope="module")
def shared() -> Iterator[tuple[Daemon, ParameterClient]]:
    """One axis, no PLC on the cyclic side; for tests that change nothing."""
    with gateway(axis(1)) as pair:
        yield pair


def value(client: ParameterClient, pnu: int, subindex: int = 0, elements: int = 0) -> Values:
    (answer,) = client.request([Address(pnu, subindex, elements)])
    return answer


def number(client: ParameterClient, pnu: int, subindex: int = 0, elements: int = 0) -> int:
    answer = value(client, pnu, subindex, elements)
    assert not answer.failed, answer.text
    return int(answer.values[0])


def write(client: ParameterClient, pnu: int, content: Values, subindex: int = 0, elements: int = 0) -> Values:
    (answer,) = client.request([Address(pnu, subindex, elements)], [content])
    return answer


def word(content: int) -> Values:
    return Values(DataType.WORD, (content,))


def error(answer: Values) -> int:
    assert answer.failed, answer.text
    return int(answer.values[0])


# -- worked examples of docs/parameter-channel.md, byte for byte --------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("02 01 00 01 10 00 03 C5 00 00", "02 01 00 01 06 01 03 29"),
        ("01 01 00 01 10 01 10 18 00 03", "01 01 00 01 07 01 00 03 00 4A"),
        ("05 01 01 01 10 00 13 88 00 00", "05 81 01 01 44 01 00 00"),
    ],
)
def test_worked_examples_that_read(shared: tuple[Daemon, ParameterClient], request_: str, response: str) -> None:
    assert shared[1].exchange(bytes.fromhex(request_)) == bytes.fromhex(response)


def test_worked_example_that_changes_the_telegram() -> None:
    with gateway(axis(1)) as (daemon, client):
        answer = client.exchange(bytes.fromhex("03 02 01 01 10 00 03 9A 00 00 42 01 00 09"))
        assert answer == bytes.fromhex("03 02 01 01")
        drive = daemon.axes[0].drive
        until(daemon, lambda: drive.generation == 2, "mapped anew")
        assert number(client, 922) == 9
        expected = [(pdo.number, pdo.size) for pdo in drive_layout(9).rpdos]
        assert [(pdo.number, pdo.size) for pdo in drive.layout.rpdos] == expected
        plc = Plc(daemon, [9])
        plc.endpoint.set(0, {"STW1": 0x043E})
        plc.until(lambda: plc.state() == 0x01, "ready under telegram 9")


def test_worked_example_of_a_partly_failed_change(shared: tuple[Daemon, ParameterClient]) -> None:
    request = bytes.fromhex("07 02 01 02 10 00 60 81 00 00 10 00 60 41 00 00 43 01 00 00 03 E8 42 01 00 00")
    assert shared[1].exchange(request) == bytes.fromhex("07 82 01 02 40 00 44 01 00 01")


# -- refusals -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ("09 05 01 01 10 00 03 C5 00 00", "09 85 01 01 44 01 00 21"),  # unknown service
        ("09 01 01 01 10 00 03 C5", "09 81 01 01 44 01 00 18"),  # too short
        ("09 01 01 00", "09 81 01 01 44 01 00 18"),  # no parameter
        ("09 02 01 01 10 00 03 9A 00 00 99 01 00 09", "09 82 01 01 44 01 00 17"),  # unknown format
        ("09 01 05 01 10 00 03 C5 00 00", "09 81 05 01 44 01 00 19"),  # no such DO
        ("09 01 01 01 77 00 03 C5 00 00", "09 81 01 01 44 01 00 16"),  # unknown attribute
        ("09 01 01 01 10 00 00 00 00 00", "09 81 01 01 44 01 00 00"),  # PNU 0
        ("09 01 01 01 10 FF 03 B1 00 00", "09 81 01 01 44 01 00 16"),  # 255 elements
        ("09 01 01 01 10 01 03 B1 FF FF", "09 81 01 01 44 01 00 16"),  # subindex 65535
        ("09 01 01 01 10 00 03 B1 00 00", "09 81 01 01 44 01 00 16"),  # an array without elements
        ("09 01 01 01 10 01 03 B1 00 40", "09 81 01 01 44 01 00 03"),  # P945[64]
        ("09 01 01 01 10 04 03 B1 00 3E", "09 81 01 01 44 02 00 03 00 40"),  # P945[62..65]: 64 is the first missing
        ("09 01 01 01 10 01 03 C5 00 01", "09 81 01 01 44 01 00 04"),  # P965[1]
        ("09 01 01 01 30 00 03 C5 00 00", "09 81 01 01 44 01 00 0F"),  # no texts
        ("09 02 01 01 20 00 03 9A 00 00 42 01 00 09", "09 82 01 01 44 01 00 07"),  # description
        ("09 02 01 01 30 00 03 9A 00 00 42 01 00 09", "09 82 01 01 44 01 00 20"),  # text
        ("09 02 01 01 10 00 03 C5 00 00 42 01 00 09", "09 82 01 01 44 01 00 01"),  # read-only
        ("09 02 01 01 10 00 03 9A 00 00 43 01 00 00 00 09", "09 82 01 01 44 01 00 05"),  # double word into a word
        ("09 02 01 01 10 00 03 9A 00 00 42 02 00 09 00 09", "09 82 01 01 44 01 00 18"),  # two values for one
        ("09 02 01 01 10 00 03 9A 00 00 42 01 00 07", "09 82 01 01 44 01 00 14"),  # telegram 7 is not there
        ("09 02 01 01 10 00 03 9F 00 00 42 01 00 02", "09 82 01 01 44 01 00 02"),  # P927 := 2
        ("09 02 01 01 10 00 03 B8 00 00 42 01 00 02", "09 82 01 01 44 01 00 06"),  # P952 := 2: only resetting
    ],
)
def test_refusals_have_the_profile_s_error_number(
    shared: tuple[Daemon, ParameterClient], request_: str, expected: str
) -> None:
    assert shared[1].exchange(bytes.fromhex(request_)).hex(" ") == expected.lower()


def test_a_request_without_a_header_is_refused_as_a_record(shared: tuple[Daemon, ParameterClient]) -> None:
    with pytest.raises(GatewayError, match="invalid parameter"):
        shared[1].exchange(b"\x01\x01\x01")


def test_operation_priority_lets_nothing_be_written_but_itself() -> None:
    with gateway(axis(1)) as (_, client):
        assert not write(client, 927, word(0)).failed
        assert error(write(client, 925, word(5))) == Number.NO_OPERATION_PRIORITY
        assert error(write(client, 0x6081, Values(DataType.UNSIGNED32, (1000,)))) == Number.NO_OPERATION_PRIORITY
        assert number(client, 927) == 0
        assert not write(client, 927, word(1)).failed
        assert not write(client, 925, word(5)).failed
        assert number(client, 925) == 5


# -- every parameter of the profile --------------------------------------------------------------------------------------


def test_every_parameter_of_an_axis_is_there_with_type_description_and_place_in_the_list(
    shared: tuple[Daemon, ParameterClient],
) -> None:
    _, client = shared
    expected = {
        pnu for pnu, spec in PARAMETERS.items() if spec.scope is not Scope.ENCODER and pnu not in {979, *LIST_PNUS}
    }
    listed = []
    follower = LIST_PNUS[0]
    while follower:
        description = Description.decode(
            bytes(client.request([Address(follower, 0, 0, Attribute.DESCRIPTION)])[0].values)  # type: ignore[arg-type]
        )
        *pnus, next_list = value(client, follower, 0, description.count).values
        listed += [int(pnu) for pnu in pnus]
        follower = int(next_list)
    assert expected <= set(listed)
    assert listed == sorted(set(listed))
    assert {0x6041, 0x1018, 0x2003} <= set(listed)
    for pnu in sorted(expected):
        spec = PARAMETERS[pnu]
        (raw,) = client.request([Address(pnu, 0, 0, Attribute.DESCRIPTION)])
        description = Description.decode(bytes(raw.values))  # type: ignore[arg-type]
        assert (description.type, description.name, description.array) == (spec.type, spec.name, spec.array), pnu
        assert description.writable == spec.writable, pnu
        elements = min(description.count, 50) if spec.array else 0
        answer = value(client, pnu, 0, elements)
        assert answer.format is spec.type, (pnu, answer.text)
        if spec.array:
            assert len(answer.values) == elements


def test_identification_of_unit_and_drive_object(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    assert number(client, 918) == 1
    assert value(client, 919).values == b"axis 1"
    assert value(client, 922).values == (1,)
    assert value(client, 915, 0, 2).values == (1, 5)
    assert value(client, 916, 0, 2).values == (2, 6)
    assert value(client, 923, 1, 8).values == (967, 968, 0, 0, 0x60FF, 0x606C, 0x60FF, 0x606C)
    assert number(client, 930) == 1
    assert number(client, 963) == 1000
    unit = value(client, 964, 0, 6).values
    assert unit[5] == 1
    identity = value(client, 975, 0, 8).values
    assert identity[:5] == unit[:5]
    assert identity[5] == 1
    assert identity[7] == 1
    assert value(client, 974, 0, 3).values == (4096, 39, 200)
    assert value(client, 978, 0, 1).values == (1,)
    assert value(client, 60000).values == (3000.0,)
    assert value(client, 61000).values == b"pdgw"
    assert value(client, 61001).values == bytes((127, 0, 0, 1))


def test_elements_of_a_description_and_texts_of_a_word(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    identifier, count, name, low, high = client.request(
        [Address(922, element, 0, Attribute.DESCRIPTION) for element in (1, 2, 6, 7, 8)]
    )
    assert identifier.values == (0x0106,), "Unsigned16, not standardised, writable"
    assert count.values == (0,)
    assert bytes(name.values).rstrip() == b"Telegram"  # type: ignore[arg-type]
    assert (low.values, high.values) == (b"\0\0\0\1", b"\0\0\xff\xff")
    (read_only,) = client.request([Address(945, 1, 0, Attribute.DESCRIPTION)])
    assert read_only.values == (0x4306,), "Unsigned16, not standardised, read-only, array"
    (texts,) = client.request([Address(968, 2, 2, Attribute.TEXT)])
    assert texts.values == b"operation enable" + b"fault".ljust(16)


def test_stw1_and_zsw1_are_those_last_exchanged() -> None:
    with gateway(axis(1)) as (daemon, client):
        plc = Plc(daemon, [1])
        plc.enable()
        assert number(client, 967) == 0x047F
        assert number(client, 968) & 0x4F == 0x07


# -- CANopen objects ------------------------------------------------------------------------------------------------------


def test_every_object_of_the_catalogue_reads_with_the_type_of_the_eds(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    entries = list(DRIVE_OBJECTS.entries)
    answers = client.read_many([Address(entry.index, entry.subindex, 1) for entry in entries])
    for entry, answer in zip(entries, answers, strict=True):
        assert not answer.failed, (str(entry), answer.text)
        prefix = {"U": "UNSIGNED", "I": "INTEGER"}[entry.type.name[0]]
        assert answer.format.name == f"{prefix}{entry.type.bits}", str(entry)


def test_strings_arrays_and_limits(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    name = value(client, 0x1008)
    assert (name.format, name.values) == (DataType.VISIBLE_STRING, b"ENGEL HBI")
    assert value(client, 0x607B, 1, 2).values == (-500000, 500000)
    assert error(value(client, 0x607B, 1, 3)) == Number.FAULTY_SUBINDEX
    assert value(client, 0x607B, 1, 3).values == (Number.FAULTY_SUBINDEX, 3)
    assert value(client, 0x1018, 0, 2).values == (Number.ADDRESS_IMPERMISSIBLE, 1), "u8 and u32 together"
    assert error(write(client, 0x6083, Values(DataType.DOUBLE_WORD, (0,)))) == Number.LIMIT_EXCEEDED
    assert error(write(client, 0x6083, word(5))) == Number.INCORRECT_DATA_TYPE
    assert not write(client, 0x6083, Values(DataType.DOUBLE_WORD, (500,))).failed
    assert number(client, 0x6083) == 500


def test_a_written_reference_is_used_by_the_axis() -> None:
    with gateway(axis(1)) as (daemon, client):
        plc = Plc(daemon, [1])
        assert not write(client, 0x6080, Values(DataType.UNSIGNED32, (1500,))).failed
        assert number(client, 0x6080) == 1500
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": 0x4000})
        plc.until(lambda: plc.value("NIST_A") == 0x4000, "100 %")
        assert daemon.axes[0].drive.feedback.velocity_actual == 3000, "1500 rpm in units of 0.5 rpm"
        assert value(client, 60000).values == (1500.0,)


def test_objects_of_the_cyclic_exchange_are_not_written_while_it_runs() -> None:
    with gateway(axis(1)) as (daemon, client):
        target = Values(DataType.INTEGER32, (100,))
        assert error(write(client, 0x60FF, target)) == Number.NO_OPERATION_PRIORITY, "also without a PLC"
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        with exchanging(plc):
            for pnu, content in ((0x60FF, target), (0x6040, word(0)), (0x6060, Values(DataType.INTEGER8, (1,)))):
                assert error(write(client, pnu, content)) == Number.NO_OPERATION_PRIORITY, hex(pnu)
            assert error(write(client, 0x6041, word(0))) == Number.VALUE_CANNOT_BE_CHANGED
            assert not write(client, 0x607A, target).failed, "not in telegram 1"


@pytest.mark.parametrize(("index", "subindex"), [(0x1016, 1), (0x1017, 0), (0x6007, 0)])
def test_what_guards_the_drive_is_never_written(
    shared: tuple[Daemon, ParameterClient], index: int, subindex: int
) -> None:
    _, client = shared
    size = {0x1016: DataType.DOUBLE_WORD, 0x1017: DataType.WORD, 0x6007: DataType.WORD}[index]
    assert error(write(client, index, Values(size, (0,)), subindex, 1)) == Number.NO_OPERATION_PRIORITY


@pytest.mark.parametrize("code", sorted(ABORT_TEXTS), ids=hex)
def test_every_sdo_abort_is_the_specified_error_and_never_a_value(
    shared: tuple[Daemon, ParameterClient], monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    daemon, client = shared

    def refuse(entry: Entry, _: object = None) -> int:
        raise SdoAbortedError(code)

    monkeypatch.setattr(drive_of(daemon).node, "on_written", refuse)
    answer = write(client, 0x6085, Values(DataType.UNSIGNED32, (700,)))
    table = {
        0x06020000: 0x00,
        0x06090011: 0x03,
        0x06010002: 0x01,
        0x06010001: 0x65,
        0x06010000: 0x01,
        0x06070010: 0x05,
        0x06070012: 0x05,
        0x06070013: 0x05,
        0x06090030: 0x02,
        0x06090031: 0x02,
        0x06090032: 0x02,
        0x06090036: 0x14,
        0x06040043: 0x14,
        0x06040047: 0x14,
        0x06060000: 0x11,
        0x08000020: 0x11,
        0x08000021: 0x11,
        0x08000022: 0x11,
        0x08000000: 0x11,
        0x05040000: 0x11,
    }
    assert error(answer) == table.get(code, 0x65)
    assert error_of_abort(code) == table.get(code, 0x65)


def test_an_unknown_abort_is_the_manufacturer_s_error() -> None:
    assert error_of_abort(0x12345678) == 0x65


# -- faults ---------------------------------------------------------------------------------------------------------------


def test_the_fault_buffer_over_a_drive_fault_its_acknowledgement_and_clearing() -> None:
    with gateway(axis(1)) as (daemon, client):
        plc = Plc(daemon, [1])
        plc.enable()
        # Entered only after what starting may have brought.
        assert not write(client, 952, word(0)).failed
        before = number(client, 944)
        drive_of(daemon).inject(7)
        plc.until(lambda: plc.state() & 0x08, "fault")
        plc.until(lambda: daemon.axes[0].faults, "recorded")
        assert (number(client, 944) - before) & 0xFFFF == 1
        assert value(client, 947, 0, 2).values == (7, 0)
        assert number(client, 945, 0, 1) == DRIVE_FAULTS[7].error_code
        assert number(client, 946, 7, 1) == DRIVE_FAULTS[7].error_code
        assert number(client, 952) == 1
        plc.endpoint.set(0, {"STW1": OFF | 0x80})
        plc.until(lambda: daemon.axes[0].outputs.command.controlword & 0x80, "reset asked")
        plc.until(lambda: not daemon.axes[0].machine.acknowledgement.pending, "given up")
        assert value(client, 947, 0, 2).values == (7, 0), "the cause is still there"
        drive_of(daemon).clear()
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: not daemon.axes[0].outputs.command.controlword & 0x80, "reset taken back")
        plc.endpoint.set(0, {"STW1": OFF | 0x80})
        plc.until(lambda: not plc.state() & 0x08, "acknowledged")
        plc.until(lambda: number(client, 947, 0, 1) == 0, "shifted")
        assert value(client, 947, 8, 2).values == (7, 0)
        assert number(client, 952) == 1
        assert not write(client, 952, word(0)).failed
        assert value(client, 947, 0, 64).values == (0,) * 64
        assert number(client, 952) == 0


def test_a_fault_that_only_the_statusword_shows_is_read_from_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    with gateway(axis(1)) as (daemon, client):
        plc = Plc(daemon, [1])
        plc.enable()
        monkeypatch.setattr(daemon.axes[0].drive, "on_event", lambda event: None)  # its EMCY gets lost
        drive_of(daemon).inject(5)
        plc.until(lambda: daemon.axes[0].faults, "fault found")
        assert value(client, 947, 0, 2).values == (5, 0)
        assert number(client, 945, 0, 1) == DRIVE_FAULTS[5].error_code


def test_a_lost_drive_is_told_and_delays_no_answer_of_another_axis() -> None:
    with gateway(axis(1) + axis(2), transport="parameter_timeout_ms = 500") as (daemon, client):
        drive_of(daemon).stop()
        until(daemon, lambda: [fault.number for fault in daemon.axes[0].faults][-1:] == [101], "lost")
        assert value(client, 947, 0, 1).values == (101,)
        answers = client.request([Address(0x6041), Address(947, 0, 1)])
        assert error(answers[0]) == Number.NOT_EXECUTABLE_IN_STATE
        assert answers[1].values == (101,), "the others of the request are served"
        client.do_id = 2
        assert not value(client, 0x6041).failed
        client.do_id = 1


def test_a_drive_that_does_not_answer_in_time_is_error_11_and_a_second_request_meanwhile_a_state_conflict(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with gateway(axis(1) + axis(2), transport="parameter_timeout_ms = 300") as (daemon, client):
        release, entered = Event(daemon.loop), Event(daemon.loop)

        def slow(*_: object) -> bytes:
            entered.set()
            release.wait(20 * SECOND)
            return b"\0\0"

        monkeypatch.setattr(daemon.axes[0].drive, "read", slow)
        answers: list[Values] = []
        asking = daemon.loop.spawn(lambda: answers.extend(client.request([Address(0x6041)] * 3)), "asking")
        until(daemon, entered.is_set, "at work")
        with client_of(daemon, client.address, 1) as other, pytest.raises(GatewayError, match="state conflict"):
            other.write_record(0xB02F, bytes.fromhex("01 01 01 01 10 00 03 C5 00 00"))
        with client_of(daemon, client.address, 2, slot=2) as other:
            assert not value(other, 0x6041).failed, "another access point, another axis"
        until(daemon, asking.done.is_set, "answered")
        release.set()
        assert [error(answer) for answer in answers] == [Number.NOT_EXECUTABLE_IN_STATE] * 3


# -- load, save, reset ------------------------------------------------------------------------------------------------------


def test_save_load_and_reset_of_the_drive() -> None:
    with gateway(axis(1)) as (daemon, client):
        drive, node = daemon.axes[0].drive, drive_of(daemon).node
        assert not write(client, 0x6085, Values(DataType.UNSIGNED32, (777,))).failed
        assert not write(client, 971, word(1)).failed
        assert number(client, 971) == 0
        assert node.stored[0x6085, 0] == 777
        assert not write(client, 972, word(2)).failed
        assert number(client, 972) == 2
        assert not write(client, 972, word(1)).failed
        until(daemon, lambda: drive.generation == 2, "configured again")
        assert number(client, 0x6085) == 777
        assert [fault.number for fault in daemon.axes[0].faults] == [], "asked for, so no fault"
        assert not write(client, 922, word(9)).failed
        until(daemon, lambda: drive.generation == 3, "telegram 9")
        assert not write(client, 970, word(1)).failed
        until(daemon, lambda: drive.generation >= 4 and drive.status.value == "online", "factory values")
        assert number(client, 922) == 1
        assert number(client, 0x6085) == 1000


def test_nothing_that_restarts_the_drive_is_done_in_operation() -> None:
    with gateway(axis(1)) as (daemon, client):
        plc = Plc(daemon, [1])
        plc.enable()
        with exchanging(plc):
            for pnu, content in ((922, 9), (970, 1), (972, 1), (972, 2), (976, 1)):
                assert error(write(client, pnu, word(content))) == Number.NOT_EXECUTABLE_IN_STATE, pnu
        assert plc.state() == 0x07


def test_stored_parameters_survive_the_gateway(tmp_path: Path) -> None:
    store = tmp_path / "store.json"
    config = configuration(axis(1)).model_copy(update={"store": store})
    for expected in (1, 3):
        with serving(config) as (_, client):
            assert number(client, 922) == expected
            assert number(client, 925) == (65535 if expected == 1 else 7)
            assert not write(client, 922, word(3)).failed
            assert not write(client, 925, word(7)).failed
    assert ParameterStore(store, pytest.fail).parameters.drive_object(1).telegram == 3


# -- records ------------------------------------------------------------------------------------------------------------------


def test_identification_records_are_read_and_written_and_survive(shared: tuple[Daemon, ParameterClient]) -> None:
    daemon, client = shared
    assert client.read_record(identification.INDEX)[:6] == bytes.fromhex("00 20 00 38 01 00")
    assert client.read_record(identification.INDEX, implicit=True) == client.read_record(identification.INDEX)
    record = identification.encode_im(1, (b"press 4", b"hall B"))
    client.write_record(identification.INDEX + 1, record)
    assert client.read_record(identification.INDEX + 1) == record
    signature = identification.encode_im(4, (bytes(range(54)),))
    client.write_record(identification.INDEX + 4, signature)
    assert client.read_record(identification.INDEX + 4) == signature
    assert daemon.store.parameters.im1_function == "press 4"
    for index, data, reason in (
        (identification.INDEX, record, "access denied"),
        (identification.INDEX + 1, record[:-1], "invalid parameter"),
        (0x1234, record, "invalid index"),
        (0xB02F, bytes(4097), "write length"),
    ):
        with pytest.raises(GatewayError, match=reason):
            client.write_record(index, data)


def test_places_and_relationships_that_do_not_exist_are_refused(shared: tuple[Daemon, ParameterClient]) -> None:
    address = shared[1].address
    for options, reason in (
        ({"slot": 2}, "invalid slot"),
        ({"subslot": 2}, "invalid slot"),
        ({"api": 5}, "invalid area"),
        ({"ar_uuid": UUID(int=1)}, "AR UUID unknown"),
    ):
        with client_of(shared[0], address, 1, **options) as client, pytest.raises(GatewayError, match=reason):
            client.read_record(identification.INDEX)
    with pytest.raises(GatewayError, match="state conflict"):
        shared[1].read_record(0xB02F)


def test_local_access_means_the_axis_of_the_slot() -> None:
    with gateway(axis(5) + axis(9)) as (daemon, client):
        for slot, do_id, expected in ((1, 0, 5), (1, 5, 5), (2, 9, 9), (2, 0, 9)):
            with client_of(daemon, client.address, do_id, slot=slot, local=True) as local:
                assert value(local, 975, 7, 1).values == (expected,)
        with client_of(daemon, client.address, 9, slot=1, local=True) as local:
            assert error(value(local, 975, 7, 1)) == Number.DO_DOES_NOT_EXIST
        with client_of(daemon, client.address, 0, slot=0) as device:
            assert value(device, 978, 0, 2).values == (5, 9)
            assert value(device, 964, 5, 1).values == (2,)
            assert error(value(device, 922)) == Number.IMPERMISSIBLE_PNU, "which of the two axes?"


def test_a_response_that_does_not_fit_says_so_and_the_rest_is_there(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    addresses = [Address(949, 0, 64)] * 20
    answers = client.request(addresses)
    failed = [answer.failed for answer in answers]
    assert failed == [False] * 15 + [True] * 5
    assert {error(answer) for answer in answers[15:]} == {Number.RESPONSE_TOO_LONG}


def test_a_response_has_the_reference_and_do_of_its_request(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    for reference in (1, 255):
        raw = client.exchange(bytes((reference, 1, 1, 1)) + struct.pack(">BBHH", 0x10, 0, 965, 0))
        response = decode_response(raw)
        assert (response.reference, response.do_id) == (reference, 1)


def test_aborts_are_complete() -> None:
    assert set(Abort) == set(ABORT_TEXTS)


# -- P922 and the PLC that is connected -------------------------------------------------------------------------------------


def test_another_address_does_not_change_the_telegram_while_a_plc_is_connected() -> None:
    with gateway(axis(1) + axis(2)) as (daemon, client):
        plc = Plc(daemon, [1, 1])
        plc.until(lambda: daemon.link.connected, "connected")
        with exchanging(plc):
            assert error(write(client, 922, word(9))) == Number.NOT_EXECUTABLE_IN_STATE
        assert number(client, 922) == 1
        assert daemon.link.connected
        assert daemon.store.parameters.drive_object(1).telegram in {None, 1}
        until(daemon, lambda: not daemon.link.connected, "the PLC went away")
        assert not write(client, 922, word(9)).failed


@pytest.mark.parametrize(("chosen", "told"), [(100, "does not fit"), (9, "every IOPS of the PLC is BAD")])
def test_the_plc_that_changes_a_telegram_sees_in_all_drive_objects_that_its_frame_has_to_change(
    chosen: int, told: str
) -> None:
    """Also where the new frame is as long as the old one."""
    with gateway(axis(1) + axis(2)) as (daemon, client):
        plc = Plc(daemon, [1, 1], "engineer")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        with exchanging(plc):
            assert not write(client, 922, word(chosen)).failed
            until(daemon, lambda: told in str(snapshot(daemon)["plc"]["layout"]), "told")
            document = snapshot(daemon)
        assert f"for telegrams {chosen}, 1" in document["plc"]["layout"]
        assert document["axes"][0]["setpoints"] is None, "those of the other telegram are not shown"
        for do_id in (1, 2):
            with client_of(daemon, client.address, do_id, slot=do_id) as other:
                assert FaultNumber.FRAME_CHANGED in value(other, 947, 0, 8).values
        assert f"{told}" in "\n".join(status_lines(document, 200))
        until(daemon, lambda: not daemon.link.connected, "the old frames ended")
        changed = Plc(daemon, [chosen, 1], "engineer")
        changed.until(lambda: changed.endpoint.setpoints_used[0], "connected with the new frame")
        assert snapshot(daemon)["plc"]["layout"] == ""


def test_a_telegram_that_cannot_be_saved_is_not_changed_either(tmp_path: Path) -> None:
    config = configuration(axis(1))
    config = config.model_copy(update={"store": tmp_path / "missing" / "parameters.json"})
    with serving(config, 1) as (daemon, client):
        for pnu in (922, 925, 927):
            before = number(client, pnu)
            assert (
                error(write(client, pnu, word(9 if pnu == 922 else 1 - before % 2))) == Number.NOT_EXECUTABLE_IN_STATE
            )
            assert number(client, pnu) == before
        assert daemon.axes[0].telegram.number == 1
        assert error(write(client, 970, word(1))) == Number.NOT_EXECUTABLE_IN_STATE, (
            "nothing is restored in the drive either"
        )
        assert daemon.axes[0].drive.generation == 1
