"""Values of ``dcf`` and ``[axis.objects]`` in a drive or encoder after its bring-up, beside python canopen as another tool."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive.objects import INFO
from tests.support.drives.dcf import makers_objects, write_dcf
from tests.support.gateways.canopen_master import master
from tests.support.gateways.daemon import (
    POSITIONER,
    Plc,
    axis,
    client,
    configuration,
    drive_of,
    encoder_of,
    exchanging,
    online,
    operating,
    record_server,
    running,
    until,
    world_of,
)
from tests.support.gateways.parameters import double_word, write

DCF = {"6085": 1200, "6065": 9000, "6073": 1500, "609A": 400}


def _config(dcf: Path | None, more: str = "", objects: str = "", store: Path | None = None) -> GatewayConfig:
    keys = f'dcf = "{dcf}"\n' if dcf else ""
    table = f"[axis.objects]\n{objects}\n" if objects else ""
    config = configuration(axis(1, more=f"simulate = true\n{keys}{more}\n{table}"))
    return config.model_copy(update={"store": store})


@contextmanager
def _run(config: GatewayConfig, habits: dict[str, dict[str, int]] | None = None, **values: int) -> Iterator[Daemon]:
    """The drive has habits, and values by name (``o6085_0``), before the gateway starts."""

    def before(daemon: Daemon) -> None:
        drive = drive_of(daemon)
        for name, parameters in (habits or {}).items():
            drive.node.start_fault(name, **parameters)
        for name, value in values.items():
            index, subindex = name[1:].split("_")
            _set(daemon, int(index, 16), int(subindex), value)

    with running(config, before) as daemon:
        yield daemon


def _set(daemon: Daemon, index: int, subindex: int, value: int) -> None:
    node = drive_of(daemon).node
    entry = node.entries[index, subindex]
    if entry.attribute:
        setattr(node.image, entry.attribute, value)
    else:
        node.values[index, subindex] = value


def _held(daemon: Daemon, *addresses: tuple[int, int]) -> list[object]:
    return [drive_of(daemon).node.read(*address) for address in addresses]


def _status_text(daemon: Daemon) -> str:
    return daemon.clients[0].status_text


def _refused(daemon: Daemon) -> str:
    until(daemon, lambda: daemon.clients[0].status is NodeStatus.REFUSED, "refused")
    return _status_text(daemon)


def test_values_of_a_dcf_are_in_the_drive_before_it_is_online(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    dcf = write_dcf(tmp_path / "drive.dcf", {**DCF, "6060": 3, "1400sub1": "$NODEID+0x200", "6083": 500})
    with _run(_config(dcf), o6065_0=9000) as daemon:
        online(daemon)
        assert _held(daemon, (0x6085, 0), (0x6065, 0), (0x6073, 0), (0x609A, 0)) == [1200, 9000, 1500, 400]
        assert daemon.axes[0].drive.own_values.value((0x6083, 0)) in (None, 500)
    assert "drive.dcf: 5 values compared, 4 written, 2 others are the gateway's own" in caplog.text


def test_a_second_bring_up_reads_and_writes_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with _run(_config(write_dcf(tmp_path / "drive.dcf", DCF))) as daemon:
        online(daemon)
        caplog.clear()
        daemon.objects[0].reset_node()
        drive_of(daemon).node.stored.update({(0x6085, 0): 1200, (0x6065, 0): 9000, (0x6073, 0): 1500, (0x609A, 0): 400})
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
    assert "drive.dcf: 4 values compared, 0 written" in caplog.text


def test_single_values_of_the_configuration_file_are_written() -> None:
    with _run(_config(None, objects='"6085h" = 1234\n"60C5h" = 900')) as daemon:
        online(daemon)
        assert _held(daemon, (0x6085, 0), (0x60C5, 0)) == [1234, 900]


def test_a_text_and_a_number_with_a_point_are_written(tmp_path: Path) -> None:
    dcf = write_dcf(tmp_path / "drive.dcf", {"2210": "press 3", "2211": "1.25"}, objects=makers_objects(0))
    config = _config(dcf)

    def before(daemon: Daemon) -> None:
        node = drive_of(daemon).node
        for spec in makers_objects(0):
            for entry in spec.entries:
                node.entries[entry.address] = entry
                node.values[entry.address] = entry.default or ""

    with running(config, before) as daemon:
        online(daemon)
        assert _held(daemon, (0x2210, 0), (0x2211, 0)) == ["press 3", 1.25]


@pytest.mark.parametrize(
    ("habit", "values", "says"),
    [
        (
            "write-refused",
            {"index": 0x6085},
            "6085h = 1200 of drive.dcf: 0609 0030h: value range of parameter exceeded",
        ),
        ("value-rounded", {"index": 0x6085, "step": 1000}, "6085h = 1200 of drive.dcf: 1000 is not allowed"),
        ("object-missing", {"index": 0x6085}, "6085h = 1200 of drive.dcf: 0602 0000h: object does not exist"),
    ],
)
def test_a_value_that_the_drive_does_not_take_is_named(
    tmp_path: Path, habit: str, values: dict[str, int], says: str
) -> None:
    with _run(_config(write_dcf(tmp_path / "drive.dcf", DCF)), {habit: values}) as daemon:
        text = _refused(daemon)
        assert says in text.replace("'", "")
        assert "drive.dcf" in text.partition("expected")[2], "what to do"
        assert daemon.clients[0].generation == 0
        drive_of(daemon).do(lambda node: node.end_fault())
        online(daemon)
        assert _held(daemon, (0x6085, 0)) == [1200]


def test_what_is_refused_in_the_order_of_the_file_is_tried_again_after_all_others(tmp_path: Path) -> None:
    """607Fh may not be above 6080h, as in drives that compare them."""

    def before(daemon: Daemon) -> None:
        node = drive_of(daemon).node
        written = node.on_written

        def check(entry, value):  # type: ignore[no-untyped-def]
            if entry.index == 0x6065 and value > node.values[0x6067, 0] * 10:
                raise SdoAbortedError(Abort.VALUE_TOO_HIGH)
            written(entry, value)

        node.on_written = check  # type: ignore[method-assign]

    with running(_config(write_dcf(tmp_path / "drive.dcf", {"6065": 9000, "6067": 1000})), before) as daemon:
        online(daemon)
        assert _held(daemon, (0x6065, 0), (0x6067, 0)) == [9000, 1000]


def test_a_unit_that_differs_is_not_written_but_named_with_the_remedy(tmp_path: Path) -> None:
    dcf = write_dcf(tmp_path / "drive.dcf", {**DCF, "6094sub1": 4})
    with _run(_config(dcf)) as daemon:
        text = _refused(daemon)
        assert "6094h.1 = 4 of drive.dcf: '1' is not allowed" in text
        assert "run pdgw device write --store, then switch the device off and on" in text
        assert _held(daemon, (0x6094, 1), (0x6085, 0)) == [1, 1000], "nothing is written"
        _set(daemon, 0x6094, 1, 4)
        online(daemon)


def test_a_family_names_the_makers_objects_that_act_after_a_restart(tmp_path: Path) -> None:
    family = tmp_path / "mine.toml"
    family.write_text('title = "Mine"\nsources = ["test"]\nact_after_restart = ["6065h"]\n')
    with _run(_config(write_dcf(tmp_path / "drive.dcf", DCF), more=f'family = "{family}"')) as daemon:
        assert "6065h = 9000 of drive.dcf" in _refused(daemon)


def test_a_drive_with_power_is_stopped_and_gets_its_values_without_power(tmp_path: Path) -> None:
    dcf = write_dcf(tmp_path / "drive.dcf", DCF)
    with operating(_config(dcf)) as (daemon, plc):
        plc.turn(0x1000)
        _set(daemon, 0x6065, 0, 7)
        node = drive_of(daemon).node
        written: list[State | None] = []
        before = node.on_written

        def note(entry, value):  # type: ignore[no-untyped-def]
            if entry.index == 0x6065:
                written.append(state_of(node.model.statusword))
            before(entry, value)

        node.on_written = note  # type: ignore[method-assign]
        daemon.clients[0].distrust("a test")
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again", 60 * SECOND)
        assert written == [State.SWITCH_ON_DISABLED]
        assert _held(daemon, (0x6065, 0)) == [9000]


def _turn_without_gateway(daemon: Daemon, *, stops_by_sdo: bool) -> None:
    """The gateway before has crashed: its drive turns, and may reject a stop by SDO."""
    drive, loop = drive_of(daemon), world_of(daemon).loop
    for index, value, size in ((0x6060, 3, 1), (0x60FF, 2000, 4), *((0x6040, word, 2) for word in (6, 7, 15))):
        drive.do(lambda node, i=index, v=value, n=size: node.set_data(i, 0, v.to_bytes(n, "little")))
        loop.run_for(SECOND // 10)
    assert state_of(drive.node.model.statusword) is State.OPERATION_ENABLED
    if not stops_by_sdo:
        drive.do(lambda node: node.start_fault("write-refused", index=0x6040))


@pytest.mark.parametrize("stops_by_sdo", [True, False])
def test_a_drive_found_with_power_is_stopped_before_it_gets_its_values(tmp_path: Path, stops_by_sdo: bool) -> None:
    config = _config(write_dcf(tmp_path / "drive.dcf", DCF))
    written: list[State | None] = []

    def before(daemon: Daemon) -> None:
        _turn_without_gateway(daemon, stops_by_sdo=stops_by_sdo)
        node = drive_of(daemon).node
        own = node.on_written

        def note(entry, value):  # type: ignore[no-untyped-def]
            if entry.index == 0x6085:
                written.append(state_of(node.model.statusword))
            own(entry, value)

        node.on_written = note  # type: ignore[method-assign]

    with running(config, before) as daemon:
        client = daemon.axes[0].drive
        until(daemon, lambda: client.generation == 1, "online", 60 * SECOND)
        waits = client.configuration.waiting
        first = "6065h = 9000 of drive.dcf" if stops_by_sdo else "the values of its files are compared without power"
        assert waits.startswith(first)
        assert client.drive_type is not None
        assert client.drive_type.uncorrected == waits, "no ON before it has its values"
        assert written == []
        until(daemon, lambda: client.generation == 2, "online with its values", 60 * SECOND)
        assert written == [State.SWITCH_ON_DISABLED]
        assert (client.configuration.waiting, client.drive_type.uncorrected) == ("", "")


def test_a_drive_that_loses_power_in_the_middle_is_brought_up_from_the_beginning(tmp_path: Path) -> None:
    dcf = write_dcf(tmp_path / "drive.dcf", DCF)
    config = _config(dcf)
    with _run(config) as daemon:
        world_of(daemon).bus("world").join("another device")
        drive = drive_of(daemon)
        until(daemon, lambda: drive.node.values[0x6065, 0] == 9000, "the first value")
        assert drive.node.values[0x6085, 0] == 1000
        drive.do(lambda node: node.power_off())
        until(daemon, lambda: daemon.clients[0].status is NodeStatus.OFFLINE, "lost")
        drive.do(lambda node: node.restart())
        online(daemon)
        assert _held(daemon, (0x6085, 0), (0x6065, 0), (0x6073, 0), (0x609A, 0)) == [1200, 9000, 1500, 400]


def test_a_value_that_rpdos_overwrite_becomes_the_drives_own_value(tmp_path: Path) -> None:
    dcf = write_dcf(tmp_path / "drive.dcf", {"6083": 250, "6084": 260})
    config = configuration(axis(1, telegram_number=9, more=f'simulate = true\ndcf = "{dcf}"'))
    with running(config) as daemon:
        online(daemon)
        own = daemon.axes[0].drive.own_values
        assert (own.value((0x6083, 0)), own.value((0x6084, 0))) == (250, 260)
        until(daemon, lambda: _held(daemon, (0x6083, 0)) != [250], "RPDOs have overwritten it")
        daemon.clients[0].distrust("a test")
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
        assert (own.value((0x6083, 0)), own.value((0x6084, 0))) == (250, 260)


def test_a_value_that_is_written_replaces_the_own_value_that_a_killed_gateway_kept(tmp_path: Path) -> None:
    store, kept = tmp_path / "store.json", tmp_path / "kept.json"
    for place, value in ((store, 250), (kept, 300)):
        dcf = write_dcf(tmp_path / "drive.dcf", {"6083": value})
        config = configuration(axis(1, telegram_number=9, more=f'simulate = true\ndcf = "{dcf}"'))
        with running(config.model_copy(update={"store": place})) as daemon:
            online(daemon)
            assert daemon.axes[0].drive.own_values.value((0x6083, 0)) == value
            if place == store:
                kept.write_bytes(store.read_bytes())


def test_a_dcf_of_another_device_is_refused(tmp_path: Path) -> None:
    other = replace(INFO, product_code=0x99)
    dcf = write_dcf(tmp_path / "other.dcf", DCF, info=other)
    with _run(_config(dcf)) as daemon:
        assert "product code 1018h/2" in _refused(daemon)
    eds = write_dcf(tmp_path / "drive.eds", {})
    with _run(_config(dcf, more=f'eds = "{eds}"')) as daemon:
        assert "00000099h, as in other.dcf" in _refused(daemon)


def test_an_encoder_gets_its_values() -> None:
    encoder = (
        '[[encoder]]\ndo_id = 20\nnode_id = 20\ntelegram = 83\nsimulate = true\n[encoder.objects]\n"6001h" = 1024\n'
    )
    with running(configuration(encoder)) as daemon:
        online(daemon)
        assert encoder_of(daemon).node.read(0x6001) == 1024


# -- 1020h ------------------------------------------------------------------------------------------------------------------


STAMP = 15_000


def _stamped(daemon: Daemon, stamp: int = STAMP) -> None:
    """A drive whose stored configuration has this stamp, and the values of the file."""
    node = drive_of(daemon).node
    node.start_fault("verify-configuration", value=stamp)
    for name, value in {"6085": 1200, "6065": 9000, "6073": 1500, "609A": 400}.items():
        node.values[int(name, 16), 0] = node.stored[int(name, 16), 0] = value


def test_values_are_not_compared_again_while_1020h_is_that_of_the_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    dcf, store = write_dcf(tmp_path / "drive.dcf", DCF, stamp=STAMP), tmp_path / "store.json"
    accesses = []
    for _ in range(2):
        with running(_config(dcf, store=store), _stamped) as daemon:
            online(daemon)
            accesses.append(daemon.clients[0].sdo.accesses)
    assert accesses[0] - accesses[1] == 4
    assert "drive.dcf: 4 values compared, 0 written" in caplog.text
    assert "drive.dcf: not compared, 1020h of the device is that of the file" in caplog.text


@pytest.mark.parametrize("changes", ["serial", "no serial", "file", "stamp", "tool"])
def test_values_are_compared_of_another_device_file_or_stamp(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, changes: str
) -> None:
    caplog.set_level(logging.INFO)
    dcf, store = write_dcf(tmp_path / "drive.dcf", DCF, stamp=STAMP), tmp_path / "store.json"

    def before(daemon: Daemon, *, again: bool = False) -> None:
        _stamped(daemon, STAMP + 1 if changes == "stamp" and again else STAMP)
        if changes == "no serial" or (changes == "serial" and again):
            drive_of(daemon).node.values[0x1018, 4] = 0 if changes == "no serial" else 77

    with running(_config(dcf, store=store), before) as daemon:
        online(daemon)
    if changes == "file":
        write_dcf(dcf, {**DCF, "6085": 1300}, stamp=STAMP)
    caplog.clear()
    with running(_config(dcf, store=store), partial(before, again=True)) as daemon:
        online(daemon)
        if changes == "tool":
            with master(world_of(daemon), "world") as tool:
                _set(daemon, 0x6065, 0, 9000)
                caplog.clear()
                tool.add_node(1).sdo.download(0x6065, 0, (9000).to_bytes(4, "little"))
            daemon.clients[0].distrust("a test")
            until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
    assert "4 values compared" in caplog.text


def test_1020h_is_0_before_a_value_changes_and_never_set(tmp_path: Path) -> None:
    dcf, store = write_dcf(tmp_path / "drive.dcf", DCF, stamp=STAMP), tmp_path / "store.json"

    def before(daemon: Daemon) -> None:
        _stamped(daemon)
        _set(daemon, 0x6085, 0, 999)

    with running(_config(dcf, store=store), before) as daemon:
        online(daemon)
        assert _held(daemon, (0x1020, 1), (0x1020, 2), (0x6085, 0)) == [0, 0, 1200]
        assert daemon.clients[0].configuration.known.verified == 0
        # Without power the drive has its stored values again, and their 1020h: they are compared.
        drive = drive_of(daemon)
        drive.node.stored[0x6085, 0] = 999
        drive.do(lambda node: node.restart())
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
        assert _held(daemon, (0x6085, 0)) == [1200]


# -- writes of others -------------------------------------------------------------------------------------------------------


def _notes(daemon: Daemon) -> list[str]:
    found: list[str] = snapshot(daemon)["notes"]
    return found


def test_a_value_that_a_parameter_client_changes_is_a_note_until_the_next_bring_up(tmp_path: Path) -> None:
    with _run(_config(write_dcf(tmp_path / "drive.dcf", DCF))) as daemon:
        online(daemon)
        with client(daemon, record_server(daemon).address, 1) as made:
            assert _notes(daemon) == []
            assert not write(made, 0x6065, double_word(5000)).failed
            assert _notes(daemon) == ["axis 1: 6065h differs from drive.dcf until the next bring-up"]
            assert not write(made, 0x6065, double_word(9000)).failed
            assert _notes(daemon) == []
            write(made, 0x6065, double_word(5000))
        daemon.clients[0].distrust("a test")
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
        assert _notes(daemon) == []
        assert _held(daemon, (0x6065, 0)) == [9000]


def test_a_value_that_another_tool_writes_is_a_note_and_no_stop(tmp_path: Path) -> None:
    with operating(_config(write_dcf(tmp_path / "drive.dcf", DCF))) as (daemon, plc):
        plc.turn(0x1000)
        with master(world_of(daemon), "world") as tool, exchanging(plc):
            tool.add_node(1).sdo.download(0x6065, 0, (5000).to_bytes(4, "little"))
        assert _notes(daemon) == [
            "axis 1: another tool has written 6065h, which may differ from drive.dcf until the next bring-up"
        ]
        plc.exchange(20)
        assert plc.state() == 0x07
        assert daemon.clients[0].generation == 1


# -- another device ---------------------------------------------------------------------------------------------------------


def _replace(daemon: Daemon, serial: int, node_id: int = 1) -> None:
    """Another device with the maker's parameters, after a moment without power."""
    node = (drive_of(daemon) if node_id == 1 else encoder_of(daemon)).node
    node.power_off()
    node.stored.clear()
    node.stored[0x1018, 4] = serial
    world_of(daemon).loop.run_for(2 * SECOND)
    node.restart()
    node.touch()


@pytest.mark.parametrize("again", [False, True])
def test_a_replaced_drive_is_named_once_with_the_number_of_its_values(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, again: bool
) -> None:
    caplog.set_level(logging.INFO)
    config = _config(write_dcf(tmp_path / "drive.dcf", DCF), store=tmp_path / "store.json")
    said = "replaced: serial 1 -> 5678, 4 values written"
    with _run(config) as daemon:
        online(daemon)
        if not again:
            world_of(daemon).bus("world").join("another device")
            _replace(daemon, 5678)
            until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
            assert _notes(daemon) == [f"axis 1: {said}"]
            assert [event.text for event in daemon.events.after(0) if "replaced" in event.text] == [said]
    for number in range(2 if again else 1):
        caplog.clear()
        with running(config, lambda daemon: drive_of(daemon).node.values.update({(0x1018, 4): 5678})) as daemon:
            online(daemon)
            assert (said in caplog.text) is (again and number == 0)
            assert ParameterStore(config.store, print).parameters.drive_object(1).device.serial_number == 5678


@pytest.mark.parametrize(("before", "after"), [(0, 5678), (1234, 0), (1234, 1234)])
def test_a_device_without_serial_number_is_never_replaced(tmp_path: Path, before: int, after: int) -> None:
    config = _config(None, store=tmp_path / "store.json")
    for serial in (before, after):
        with running(config, lambda daemon, n=serial: drive_of(daemon).node.values.update({(0x1018, 4): n})) as daemon:
            online(daemon)
            assert _notes(daemon) == []


def test_without_values_the_note_says_how_to_save_those_of_a_sound_device(tmp_path: Path) -> None:
    config = _config(None, store=tmp_path / "store.json")
    for serial in (1234, 5678):
        with running(config, lambda daemon, n=serial: drive_of(daemon).node.values.update({(0x1018, 4): n})) as daemon:
            online(daemon)
            notes = _notes(daemon)
    assert notes == [
        "axis 1: replaced: serial 1234 -> 5678; it has its own parameters; save those of a sound device for the next "
        "time (pdgw device save) and set dcf"
    ]


@pytest.mark.parametrize("number", [7, 9, 110, 111])
def test_a_position_that_was_referenced_with_the_old_drive_is_not_valid(number: int) -> None:
    more = "simulate = true\n" + ("" if number == 9 else POSITIONER)
    with running(configuration(axis(1, telegram_number=number, more=more))) as daemon:
        online(daemon)
        positioner = daemon.axes[0].machine.executor.positioner  # type: ignore[attr-defined]
        positioner.home_set = True
        world_of(daemon).bus("world").join("another device")
        _replace(daemon, 5678)
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
        plc = Plc(daemon, [number])
        plc.exchange(5)
        assert not plc.value("ZSW1") >> 11 & 1
        assert _notes(daemon)[0].startswith("axis 1: replaced: serial 1 -> 5678")


def test_a_replaced_encoder_is_named(tmp_path: Path) -> None:
    encoder = (
        '[[encoder]]\ndo_id = 20\nnode_id = 20\ntelegram = 83\nsimulate = true\n[encoder.objects]\n"6001h" = 1024\n'
    )
    with running(configuration(encoder)) as daemon:
        online(daemon)
        world_of(daemon).bus("world").join("another device")
        _replace(daemon, 5678, 20)
        until(daemon, lambda: daemon.clients[0].generation == 2, "online again")
        assert _notes(daemon) == ["encoder 20: replaced: serial 20 -> 5678, 1 value written"]
        assert encoder_of(daemon).node.read(0x6001) == 1024
