"""The parameter channel of a running gateway: parameters of the profile, objects of simulated drives, P922."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.ds301.aborts import ABORT_TEXTS, SdoAbortedError
from pdgw.ds301.objects import Entry
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.store import DeviceParameters, ParameterStore
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters.objects import error_of_abort
from pdgw.gateway.service.status import snapshot
from pdgw.peers.world import World
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import LIST_PNUS, PARAMETERS, Scope
from pdgw.profidrive.parameters.codec import Attribute, ParameterAddress, Values
from pdgw.profidrive.parameters.description import Description
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import (
    OFF,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    exchanging,
    serving,
    until,
)
from tests.support.gateways.daemon import client as client_of
from tests.support.gateways.parameters import error, gateway, lists, number, value, word, write


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
        expected = [(pdo.number, pdo.size) for pdo in drive_layout(telegram(9)).rpdos]
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
        ("09 05 01 01 10 00 03 C5 00 00", "09 80 01 01 44 01 00 21"),  # unknown service
        ("09 01 01 01 10 00 03 C5", "09 81 01 01 44 01 00 18"),  # too short
        ("09 01 01 00", "09 81 01 01 44 01 00 18"),  # no parameter
        ("09 02 01 01 10 00 03 9A 00 00 99 01 00 09", "09 82 01 01 44 01 00 17"),  # unknown format
        ("09 01 05 01 10 00 03 C5 00 00", "09 81 05 01 44 01 00 19"),  # no such DO
        ("09 01 01 01 77 00 03 C5 00 00", "09 81 01 01 44 01 00 16"),  # unknown attribute
        ("09 01 01 01 10 00 00 00 00 00", "09 81 01 01 44 01 00 16"),  # PNU 0
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


def test_a_positioner_has_no_parameters_of_its_own() -> None:
    with gateway(axis(1, telegram_number=111, more=SIMULATED_POSITIONER)) as (_, client):
        assert error(value(client, 2571)) == Number.IMPERMISSIBLE_PNU
        assert error(write(client, 2571, Values(DataType.UNSIGNED32, (12_000,)))) == Number.IMPERMISSIBLE_PNU


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
    listed = [pnu for entries in lists(client) for pnu in entries]
    assert expected <= set(listed)
    assert listed == sorted(set(listed))
    assert {0x6041, 0x1018, 0x2003} <= set(listed)
    for pnu in sorted(expected):
        spec = PARAMETERS[pnu]
        (raw,) = client.request([ParameterAddress(pnu, 0, 0, Attribute.DESCRIPTION)])
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
        [ParameterAddress(922, element, 0, Attribute.DESCRIPTION) for element in (1, 2, 6, 7, 8)]
    )
    assert identifier.values == (0x0106,), "Unsigned16, not standardised, writable"
    assert count.values == (0,)
    assert bytes(name.values).rstrip() == b"Telegram"  # type: ignore[arg-type]
    assert (low.values, high.values) == (b"\0\0\0\1", b"\0\0\xff\xff")
    (read_only,) = client.request([ParameterAddress(945, 1, 0, Attribute.DESCRIPTION)])
    assert read_only.values == (0x4306,), "Unsigned16, not standardised, read-only, array"
    (texts,) = client.request([ParameterAddress(968, 5, 3, Attribute.TEXT)])
    assert texts.values == b"operation enable" + b"no".ljust(16) + b"fault".ljust(16)
    (texts,) = client.request([ParameterAddress(967, 0, 2, Attribute.TEXT)])
    assert texts.values == b"OFF1".ljust(16) + b"on".ljust(16)


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
    for entry in entries:
        (answer,) = client.request([ParameterAddress(entry.index, entry.subindex, 1)])
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
    assert value(client, 0x607B, 0x100, 1).values == (Number.FAULTY_SUBINDEX,)
    assert value(client, 0x607B, 0x100, 2).values == (Number.FAULTY_SUBINDEX, 0x100)
    limits = Values(DataType.INTEGER32, (0, 0))
    assert write(client, 0x607B, limits, 0x100, 2).values == (Number.FAULTY_SUBINDEX, 0x100)
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
        plc.turn(0x4000)
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


@pytest.mark.parametrize(("chosen", "text"), [(100, "46 bytes; expected"), (9, "every IOPS of the PLC is BAD")])
def test_the_plc_that_changes_a_telegram_sees_in_all_drive_objects_that_its_frame_has_to_change(
    chosen: int, text: str
) -> None:
    """Also where the new frame is as long as the old one."""
    with gateway(axis(1) + axis(2)) as (daemon, client):
        plc = Plc(daemon, [1, 1], "engineer")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        with exchanging(plc):
            assert not write(client, 922, word(chosen)).failed
            until(daemon, lambda: text in str(snapshot(daemon)["plc"]["refused"]), "the reason")
            document = snapshot(daemon)
        assert f"for telegrams {chosen}, 1" in document["plc"]["refused"]
        assert document["axes"][0]["setpoints"] is None, "those of the other telegram are not shown"
        for do_id in (1, 2):
            with client_of(daemon, client.address, do_id, slot=do_id) as other:
                assert FaultNumber.FRAME_CHANGED in value(other, 947, 0, 8).values
        assert text in "\n".join(status_lines(document, 200))
        until(daemon, lambda: not daemon.link.connected, "the old frames ended")
        changed = Plc(daemon, [chosen, 1], "engineer")
        changed.until(lambda: changed.endpoint.setpoints_used[0], "connected with the new frame")
        assert snapshot(daemon)["plc"]["refused"] == ""


SLOW_BUS = '[can]\ninterface = "virtual"\nchannel = "world"\nbitrate = 250000\n'
"""Carries the PDOs of one axis with telegram 100 and one with telegram 1."""


def test_p922_that_would_overload_the_bus_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    with serving(configuration(axis(1) + axis(2), can=SLOW_BUS), 1) as (daemon, client):
        assert not write(client, 922, word(100)).failed
        with client_of(daemon, client.address, 2) as second:
            assert error(write(second, 922, word(100))) == Number.NOT_EXECUTABLE_IN_STATE
            assert number(second, 922) == 1
            assert not write(second, 922, word(2)).failed
    assert "P922 := 100 refused: worst-case load of bus can: '129%" in caplog.text


def test_p976_first_loads_the_telegrams_that_make_room_on_the_bus() -> None:
    with serving(configuration(axis(1, telegram_number=100) + axis(2), can=SLOW_BUS), 1) as (daemon, client):
        assert not write(client, 922, word(1)).failed
        with client_of(daemon, client.address, 2) as second:
            assert not write(second, 922, word(100)).failed
        until(daemon, lambda: all(item.drive.status.value == "online" for item in daemon.axes), "online again")
        assert not write(client, 976, word(1)).failed
        assert [item.telegram.number for item in daemon.axes] == [100, 1]


@pytest.mark.parametrize(
    ("number", "problem"),
    [(100, "worst-case load of bus can: '129%"), (110, "[axis.positioner] is missing"), (1001, "telegram: 1001")],
)
def test_a_stored_telegram_that_refuses_the_start_is_named_with_the_remedy(
    tmp_path: Path, number: int, problem: str
) -> None:
    config = configuration(axis(1) + axis(2), can=SLOW_BUS).model_copy(update={"store": tmp_path / "store.json"})

    def select(parameters: DeviceParameters) -> None:
        for do_id in (1, 2):
            parameters.drive_object(do_id).telegram = number

    ParameterStore(tmp_path / "store.json", pytest.fail).update(select)
    with pytest.raises(GatewayError) as refused:
        build_gateway(config, World(0))
    text = str(refused.value)
    assert text.startswith(problem)
    for do_id in (1, 2):
        assert f"DO {do_id}: telegram {number} is stored (P922) and replaces telegram 1" in text
        assert f"pdgw param write P922 1 --do {do_id}" in text


def test_an_error_without_a_stored_telegram_names_none(tmp_path: Path) -> None:
    config = configuration(axis(1) + axis(2)).model_copy(update={"store": tmp_path / "store.json"})
    broken = config.axis[0].model_copy(update={"telegram": 110})
    with pytest.raises(GatewayError) as refused:
        build_gateway(config.model_copy(update={"axis": (broken, config.axis[1])}), World(0))
    assert str(refused.value) == "[axis.positioner] is missing: a telegram of the positioner needs it"


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
