"""Faults of the parameter channel: drives that do not answer, the parameter store, P922, and program errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Event
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import DeviceParameters, ParameterStore, stored_parameters
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters import manager
from pdgw.gateway.parameters.records import Records
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive.objects import DRIVE_FAULTS
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import Attribute, ParameterAddress, Values
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profinet.rpc import dcerpc
from pdgw.tools.commands.commissioning.config import check
from pdgw.tools.commands.commissioning.map import map_
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, exchanging, running, serving, until
from tests.support.gateways.daemon import client as client_of
from tests.support.gateways.parameters import error, gateway, number, value, word, write
from tests.support.gateways.profinet_daemon import PlantChannel, plant
from tests.support.gateways.profinet_daemon import configuration as plant_configuration

# -- drives that do not answer; what is saved, loaded and reset ---------------------------------------------------


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
        assert number(client, 951, 7, 1) == 7
        for pnu in (947, 951):
            (text,) = client.request([ParameterAddress(pnu, 7, 1, Attribute.TEXT)])
            assert text.values == DRIVE_FAULTS[7].name[:16].encode().ljust(16)
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


def test_a_lost_drive_is_reported_and_delays_no_answer_of_another_axis() -> None:
    with gateway(axis(1) + axis(2)) as (daemon, client):
        drive_of(daemon).stop()
        until(daemon, lambda: [fault.number for fault in daemon.axes[0].faults][-1:] == [101], "lost")
        assert value(client, 947, 0, 1).values == (101,)
        answers = client.request([ParameterAddress(0x6041), ParameterAddress(947, 0, 1)])
        assert error(answers[0]) == Number.NOT_EXECUTABLE_IN_STATE
        assert answers[1].values == (101,), "the others of the request are served"
        client.do_id = 2
        assert not value(client, 0x6041).failed
        client.do_id = 1


@pytest.mark.planted
def test_a_drive_that_does_not_answer_in_time_is_error_11_and_a_second_request_meanwhile_a_state_conflict(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with gateway(axis(1) + axis(2)) as (daemon, client):
        release, entered = Event(daemon.loop), Event(daemon.loop)

        def slow(*_: object) -> bytes:
            entered.set()
            release.wait(20 * SECOND)
            return b"\0\0"

        monkeypatch.setattr(daemon.axes[0].drive.sdo, "read", slow)
        answers: list[Values] = []
        asking = daemon.loop.spawn(lambda: answers.extend(client.request([ParameterAddress(0x6041)] * 3)), "asking")
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
            assert not write(client, 972, word(0)).failed, "no reset"
        assert plc.state() == 0x07


def test_factory_values_of_all_are_refused_before_the_first_if_one_is_in_operation() -> None:
    with gateway(axis(1) + axis(2)) as (daemon, client):
        plc = Plc(daemon, [1, 1])
        assert not write(client, 925, word(7)).failed
        plc.enable(1)
        with exchanging(plc):
            assert error(write(client, 976, word(1))) == Number.NOT_EXECUTABLE_IN_STATE
        assert number(client, 925) == 7
        assert [item.drive.generation for item in daemon.axes] == [1, 1]
        assert plc.state(1) == 0x07


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


# -- a stored telegram (P922) replaces that of the file -----------------------------------------------------------


NOTE = "DO 1: telegram 3 is stored (P922) and replaces telegram 1 of the configuration"
REMEDY = 'run "pdgw param write P922 1 --do 1"'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A configuration with telegram 1; telegram 3 is stored."""
    path = tmp_path / "gateway.toml"
    path.write_text(
        'store = "store.json"\n[can]\ninterface = "virtual"\nchannel = "world"\n[transport]\ncyclic_port = 0\n'
        f"acyclic_port = 0\nstatus_port = 0\n[trace]\nenabled = false\n{axis(1)}"
    )
    select(tmp_path / "store.json", 3)
    return path


def select(store: Path, number: int) -> None:
    def change(parameters: DeviceParameters) -> None:
        parameters.drive_object(1).telegram = number

    ParameterStore(store, pytest.fail).update(change)


def test_gateway_reports_the_stored_telegram_at_the_start_and_in_status(
    file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running(load_config(file)) as daemon:
        Plc(daemon, [3]).enable()
        lines = " ".join(status_lines(snapshot(daemon), 400))
    assert NOTE in caplog.text
    assert NOTE in lines
    assert REMEDY in lines


def test_gateway_with_the_telegram_of_its_file_has_no_note(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    select(file.with_name("store.json"), 1)
    with running(load_config(file)) as daemon:
        assert snapshot(daemon)["notes"] == []
    assert "P922" not in caplog.text


def test_map_shows_the_frame_that_the_gateway_uses(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    map_(file)
    shown = capsys.readouterr()
    assert "G1_XIST1" in shown.out
    assert NOTE in shown.err


def test_config_check_names_the_stored_telegram(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(file)
    assert NOTE in capsys.readouterr().out


def test_reading_a_damaged_store_leaves_the_file_as_it_is(tmp_path: Path) -> None:
    damaged = tmp_path / "store.json"
    damaged.write_text("{}")
    assert stored_parameters(damaged).telegrams == {}
    assert [item.name for item in tmp_path.iterdir()] == ["store.json"]


# -- a program error in one request is logged, and the next request is served -------------------------------------


STATION = ("192.168.0.2", 34964)
FAULT = "1C000012"
"""nca_s_fault_unspec of DCE 1.1, appendix E."""


@contextmanager
def over_udp(folder: Path) -> Iterator[tuple[Daemon, ParameterClient]]:
    with gateway(axis(1)) as made:
        yield made


@contextmanager
def over_profinet(folder: Path) -> Iterator[tuple[Daemon, ParameterClient]]:
    with plant(plant_configuration(axis(1), folder / "store.json")) as site:
        site.connect()
        with ParameterClient(STATION, 1, channel=PlantChannel(site)) as client:
            client.connect()
            yield site.daemon, client


def mistaken(*_: object, **__: object) -> Any:
    raise KeyError("a mistake")


@contextmanager
def mistakes(daemon: Daemon, caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """What is asked meanwhile ends in mistakes; that they are counted is all they leave."""
    caplog.clear()
    yield
    assert daemon.loop.task_errors > 0
    tracebacks = [record for record in caplog.records if record.exc_info]
    assert len(tracebacks) == 1, "a caller who asks again and again does not fill the log"
    assert "KeyError: 'a mistake'" in caplog.text
    daemon.loop.task_errors = 0


EDGES = pytest.mark.parametrize("edge", [over_udp, over_profinet])
Edge = Callable[[Path], Any]


@EDGES
@pytest.mark.parametrize(
    ("place", "name", "answer"),
    [(Records, "write", FAULT), (manager, "answer", "read error")],
    ids=["in a call: a FAULT of the RPC", "in a parameter request: a read error"],
)
def test_a_mistake_in_a_request_is_an_error_answer_for_its_caller_alone(
    edge: Edge,
    place: object,
    name: str,
    answer: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    with edge(tmp_path) as (daemon, client):
        with mistakes(daemon, caplog), monkeypatch.context() as planted:
            planted.setattr(place, name, mistaken)
            for _ in range(3):
                with pytest.raises(GatewayError, match=answer):
                    number(client, 965)
            assert daemon.loop.task_errors == 3
        assert number(client, 965) == 0x0329


@EDGES
def test_a_datagram_that_even_cannot_be_answered_does_not_end_the_service(
    edge: Edge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with edge(tmp_path) as (daemon, client):
        decode = dcerpc.decode_packet
        left = [3]

        def decode_later(data: bytes) -> Any:
            left[0] -= 1
            return mistaken() if left[0] >= 0 else decode(data)

        with mistakes(daemon, caplog), monkeypatch.context() as planted:
            planted.setattr(dcerpc, "decode_packet", decode_later)
            assert number(client, 965) == 0x0329, "it asks again"
