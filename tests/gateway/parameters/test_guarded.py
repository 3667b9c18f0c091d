"""The parameter channel does not take the brake away: what guards and stops a powered axis is not written to."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import SdoAbortedError, SdoCommunicationError
from pdgw.ds301.loop.jobs import resolve
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.ds301.node.device_values import DeviceConfiguration
from pdgw.dsp402.units.mechanics import UNIT_OBJECTS
from pdgw.dsp402.units.velocity import VL_FACTORS
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.parameters.guarded import GUARDED, Check, guard_of
from pdgw.gateway.parameters.objects import ObjectAccess, RequestContext
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.error_numbers import ParameterRefused
from pdgw.profidrive.signals import signal
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
    world_of,
)

GUARDED_INDICES = (
    *(0x1005, 0x1006, 0x1007, 0x1010, 0x1011, 0x1014, 0x1015, 0x1016, 0x1017, 0x1029, 0x1200, 0x127F, 0x1280, 0x13FF),
    *(0x1400, 0x1600, 0x1800, 0x1A00, 0x1BFF, 0x1F80, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6007, 0x6084, 0x6085),
    *(
        0x6086,
        0x60C6,
        0x6080,
        0x6094,
        0x607E,
        0x607F,
        0x608F,
        0x6090,
        0x6091,
        0x6092,
        0x6093,
        0x6095,
        0x6096,
        0x6097,
        0x60A8,
        0x60A9,
    ),
)


@pytest.mark.parametrize(
    "index",
    [
        *(*GUARDED_INDICES, *sorted({*UNIT_OBJECTS, *VL_FACTORS}), 0x6000, 0x6003, 0x6010, 0x6046, 0x6049, 0x604A),
        *(0x6075, 0x6076, 0x607B, 0x607C),
    ],
)
def test_what_stops_guards_or_scales_an_axis_is_guarded(index: int) -> None:
    assert guard_of(index) is not None


@pytest.mark.parametrize(
    "index", [0x1000, 0x1008, 0x1018, 0x2000, 0x6048, 0x6072, 0x607D, 0x6081, 0x6083, 0x6087, 0x6098, 0x60C5, 0x60FF]
)
def test_everything_else_may_be_written_at_any_time(index: int) -> None:
    assert guard_of(index) is None


def test_the_ranges_are_in_order_and_say_why() -> None:
    assert all(item.first <= item.last and item.reason for item in GUARDED)
    starts = [item.first for item in GUARDED if item.first < 0x2000]
    assert starts == sorted(starts)


class Client:
    """A node that takes every write; ``before`` is what happens while a job waits for its turn."""

    def __init__(self, before: Callable[[], None]) -> None:
        self.log: list[object] = []
        self._before = before
        self.sdo = self
        self.configuration = DeviceConfiguration(lambda _: None)

    def submit(self, job: Callable[[Any], None]) -> Future[None]:
        future: Future[None] = Future()
        self._before()
        resolve(future, lambda: job(self))
        return future

    def write_for_client(self, index: int, subindex: int, data: bytes) -> None:
        self.write(index, subindex, data)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        self.log.append((index, subindex))

    def hold(self, _text: str) -> None:
        self.log.append("hold")

    def unhold(self, *, check: bool) -> None:
        self.log.append("check" if check else "unhold")


def stub(*, powered_later: bool = False) -> tuple[ObjectAccess, Client]:
    owner = SimpleNamespace(
        do_id=1,
        network=SimpleNamespace(loop=VirtualLoop()),
        powered=False,
        owns=lambda *_: False,
        is_reference=lambda *_: False,
        references_changed=lambda: client.log.append("references taken"),
        read_references=lambda _: client.log.append("references read"),
    )
    client = Client(lambda: setattr(owner, "powered", powered_later))
    owner.client = client
    return ObjectAccess(owner), client  # type: ignore[arg-type]


def test_an_axis_that_is_switched_on_while_the_write_waits_is_not_written_to() -> None:
    access, client = stub(powered_later=True)
    with pytest.raises(ParameterRefused) as refused:
        access.write(0x6085, 0, bytes(4), RequestContext())
    assert refused.value.number == Number.NOT_EXECUTABLE_IN_STATE
    assert client.log == []


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        (0x1400, ["hold", (0x1400, 2), "check"]),
        (0x6094, ["hold", (0x6094, 2), "references read", "unhold", "references taken"]),
        (0x605A, ["hold", (0x605A, 2), "references read", "unhold", "references taken"]),
        (0x6075, ["hold", (0x6075, 2), "unhold"]),
        (0x6081, [(0x6081, 2)]),
    ],
)
def test_while_a_guarded_object_is_written_the_axis_is_held_and_checked_afterwards(
    index: int, expected: list[object]
) -> None:
    access, client = stub()
    access.write(index, 2, bytes(1), RequestContext())
    assert client.log == expected


@pytest.mark.parametrize(("index", "guarded"), [(0x6094, True), (0x6081, False)])
@pytest.mark.parametrize("failed", ["write", "references"])
@pytest.mark.parametrize("error", [SdoCommunicationError("no answer"), SdoAbortedError(0x08000000)])
def test_node_is_brought_up_again_when_its_references_may_have_changed_unread(
    index: int, guarded: bool, failed: str, error: Exception
) -> None:
    access, client = stub()

    def fail(*_: object) -> None:
        raise error

    access.owner.is_reference = lambda *_: True  # type: ignore[method-assign]
    if failed == "write":
        client.write = fail  # type: ignore[method-assign]
    else:
        access.owner.read_references = fail  # type: ignore[method-assign]
    with pytest.raises(ParameterRefused):
        access.write(index, 2, bytes(1), RequestContext())
    refused = failed == "write" and isinstance(error, SdoAbortedError)
    done = [] if failed == "write" else [(index, 2)]
    ended = [] if refused and not guarded else ["unhold" if refused else "check"]
    assert client.log == [*(["hold"] if guarded else []), *done, *ended], "an abort of the write changes nothing"


def write(client: ParameterClient, index: int, subindex: int, data_type: DataType, value: int) -> Values:
    (answer,) = client.request([ParameterAddress(index, subindex, 1 if subindex else 0)], [Values(data_type, (value,))])
    return answer


def test_a_powered_axis_keeps_its_brake_and_what_was_written_when_it_was_off_is_put_right() -> None:
    with serving(configuration(axis(1)), 1) as (daemon, client):
        plc = Plc(daemon, [1])
        plc.enable()
        drive, node = daemon.axes[0].drive, drive_of(daemon).node
        with exchanging(plc):
            for index, subindex, data_type, value in (
                (0x1400, 1, DataType.UNSIGNED32, 0x8000_0201),
                (0x1400, 2, DataType.UNSIGNED8, 0),
                (0x6085, 0, DataType.UNSIGNED32, 1),
                (0x6094, 1, DataType.UNSIGNED32, 7),
                (0x6075, 0, DataType.UNSIGNED32, 1),
                (0x607B, 2, DataType.INTEGER32, 1000),
                (0x607C, 0, DataType.INTEGER32, 1000),
                (0x1010, 1, DataType.UNSIGNED32, 0x65766173),
            ):
                before = node.get_data(index, subindex)
                answer = write(client, index, subindex, data_type, value)
                assert answer.failed
                assert answer.values[0] == Number.NOT_EXECUTABLE_IN_STATE
                assert node.get_data(index, subindex) == before
        assert plc.state() == 0x07
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "off")
        with exchanging(plc):
            before = node.get_data(0x1400, 2)
            assert not write(client, 0x1400, 2, DataType.UNSIGNED8, 0).failed
            until(daemon, lambda: drive.generation == 2, "brought up again")
            assert node.get_data(0x1400, 2) == before
        plc.enable()


def test_written_home_offset_of_an_axis_that_is_off_ends_its_home_position() -> None:
    home_set = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
    with serving(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER)), 1) as (daemon, client):
        plc = Plc(daemon, [111])
        plc.enable()
        plc.endpoint.set(0, {"POS_STW2": signal("POS_STW2").bit("SET_REFERENCE_POINT").mask})
        plc.until(lambda: plc.value("ZSW1") & home_set != 0, "reference point set")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "off")
        with exchanging(plc):
            assert not write(client, 0x607C, 0, DataType.INTEGER32, 1000).failed
        plc.until(lambda: daemon.axes[0].drive.generation == 2, "configured again")
        plc.until(lambda: plc.state() == 0x01, "ready")
        assert not plc.value("ZSW1") & home_set


def test_checks_are_those_of_the_table() -> None:
    assert {item.check for item in GUARDED} == set(Check)


def test_a_drive_whose_guarded_objects_are_being_written_is_not_there_for_the_cycle() -> None:
    """Nothing can switch it on meanwhile."""
    with serving(configuration(axis(1)), 1) as (daemon, _):
        drive = daemon.axes[0].drive
        until(daemon, lambda: daemon.axes[0].good, "online")
        drive.submit(lambda node: node.hold("test"))
        until(daemon, lambda: not daemon.axes[0].good, "held")
        drive.submit(lambda node: node.unhold(check=False))
        until(daemon, lambda: daemon.axes[0].good, "free again")


@pytest.mark.parametrize(
    ("index", "subindex", "data_type", "value", "evidence"),
    [
        (0x6085, 0, DataType.UNSIGNED32, 5000, "a client writes 6085h/0; its units and limits are being read"),
        (0x1400, 2, DataType.UNSIGNED8, 255, "another tool wrote to its configuration"),
    ],
)
def test_reason_of_a_device_that_is_checked_after_a_write_names_the_write(
    index: int, subindex: int, data_type: DataType, value: int, evidence: str
) -> None:
    can = '[can]\ninterface = "virtual"\nchannel = "slow"\nbitrate = 100_000\n'
    with serving(configuration(axis(1), can=can), 1) as (daemon, client):
        item = daemon.axes[0]
        until(daemon, lambda: item.good, "online")
        item.happenings.clear()
        assert not write(client, index, subindex, data_type, value).failed
        until(daemon, lambda: item.happenings and item.good, "checked")
        shown = [happening.text for happening in item.happenings]
    assert f"Starting: node 1 is being checked: {evidence}" in shown
    assert not any("no data in time" in text for text in shown)


def test_reason_of_a_device_that_another_tool_writes_to_names_the_write() -> None:
    with serving(configuration(axis(1)), 1) as (daemon, _):
        item = daemon.axes[0]
        until(daemon, lambda: item.good, "online")
        item.drive.submit(lambda node: node.loop.sleep(100 * MS))
        world_of(daemon).loop.run_for(10 * MS)
        item.drive.distrust("another tool writes 6094h/1")
        until(daemon, lambda: not item.good, "not online")
        assert item.enable_status.text == "Starting: node 1 is being checked: another tool writes 6094h/1"
