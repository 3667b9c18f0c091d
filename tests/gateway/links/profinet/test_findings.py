"""Start-ups that do not end, frames that do not count and projects that differ: named with what is missing or wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.links.profinet.findings import differences
from pdgw.gateway.service.status import snapshot
from pdgw.peers.controller.project import Project
from pdgw.profidrive.frame import STATUS_DATA_VALID, STATUS_PRIMARY, STATUS_RUN
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.connection.cmdev import State
from pdgw.profinet.connection.cpm import STATUS_IGNORE
from pdgw.profinet.model import Module, ObjectKind, Submodule, access_module, object_module
from pdgw.profinet.rpc.dcerpc import PacketType
from tests.support.gateways.daemon import axis
from tests.support.gateways.fault_display import drive_state
from tests.support.gateways.profinet_daemon import ON, Plant, configuration, parameterise_again, plant
from tests.support.wire.profinet import DEVICE_MAC, PLC_MAC

SPEED = 0x1000
CONNECTED = "the controller plc-1 (192.168.0.1) has connected, but "


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Plant]:
    with plant(configuration(axis(1), tmp_path / "store.json", transport="cycle_time_ms = 4")) as made:
        yield made


def first(site: Plant) -> str:
    """The first line of ``pdgw status`` below the nodes: text and remedy."""
    (cause,) = snapshot(site.daemon)["causes"]
    return f"{cause['reason']}; {cause['remedy']}"


# -- start-up ---------------------------------------------------------------------------------------------------------


def never_confirm(site: Plant) -> None:
    """The controller does not receive calls at its port."""
    receive = site.plc.on_datagram
    site.plc.on_datagram = lambda data, *more: None if data[1] == PacketType.REQUEST else receive(data, *more)  # type: ignore[method-assign]


def never_end_parameters(site: Plant) -> None:
    """The controller's PrmEnd does not come."""
    outgoing = site.plc.outgoing

    def without() -> list[tuple[tuple[str, int] | None, bytes]]:
        return [(to, data) for to, data in outgoing() if to is None or data[100:104] != b"\x01\x10\x00\x1c"]

    site.plc.outgoing = without  # type: ignore[method-assign, assignment]


def never_send_data(site: Plant) -> None:
    site.plc.silent = True


STUCK: Final[dict[Callable[[Plant], None], tuple[str, str]]] = {
    never_end_parameters: ("its PrmEnd has not come", "the activity time is over (CF 81 FD 06)"),
    never_confirm: ("has not confirmed ApplicationReady", "ApplicationReady is not confirmed"),
    never_send_data: ("its first cyclic frame has not come", "the activity time is over (CF 81 FD 06)"),
}


@pytest.mark.parametrize("before", [False, True], ids=["first", "after a Release"])
@pytest.mark.parametrize("way", STUCK, ids=lambda way: way.__name__)
def test_a_start_up_names_the_frame_that_does_not_come(site: Plant, way: Callable[[Plant], None], before: bool) -> None:
    missing, end = STUCK[way]
    if before:
        site.connect()
        site.enable(1, SPEED)
        site.plc.release(site.loop.now())
        site.run(SECOND)
    way(site)
    site.plc.project = replace(site.plc.project, activity_timeout=40)
    site.plc.start(site.loop.now())
    site.run(3 * SECOND)
    assert first(site).startswith(f"{CONNECTED}{missing} since 22:13:2")
    assert ("UDP port 34964" in first(site)) is (way is never_confirm)
    assert "no controller" not in first(site)
    assert "Release" not in first(site)
    site.run(6 * SECOND)
    assert site.link.device.relation is None
    assert f"the relationship has ended: {end}" in first(site)
    assert f"{CONNECTED}{missing}" in first(site)


def test_parameters_that_are_sent_again_and_do_not_end_are_named(site: Plant) -> None:
    site.connect()
    site.enable(1, SPEED)
    never_end_parameters(site)
    parameterise_again(site)
    site.run(SECOND)
    assert first(site).startswith(f"{CONNECTED}its PrmEnd has not come since ")
    del site.plc.outgoing  # type: ignore[method-assign]
    site.plc.start(site.loop.now())
    site.until(lambda: site.link.connected, "data")
    site.set(1, ON)
    site.run(SECOND)
    assert "ON ignored: PLC lost: the controller sends its parameters again (PrmBegin), since " in first(site)


@pytest.mark.parametrize("state", State, ids=lambda state: state.name)
def test_each_state_of_a_relationship_has_a_finding_before_its_data(site: Plant, state: State) -> None:
    never_end_parameters(site)
    site.plc.start(site.loop.now())
    site.run(SECOND)
    relation = site.link.device.relation
    assert relation is not None
    relation.state = state
    found = site.link.finding(0)
    assert found is not None
    assert found.reason is Reason.NO_RELATIONSHIP


@pytest.mark.parametrize(
    ("project", "why", "remedy"),
    [
        (
            {"reduction_ratio": 512, "data_hold": 40},
            "IocrBlockReq.data_hold: '20.48 s, which is 40 x the update time of 512 ms' is not allowed, expected at most 1.92 s",
            "shorten this device's update time in the controller's project, or lower the number of update cycles of its watchdog",
        ),
        (
            {"send_clock": 8, "reduction_ratio": 2},
            "IocrBlockReq.reduction_ratio: 'update time 0.5 ms' is not allowed, expected at least 1 ms",
            "lengthen this device's update time in the controller's project, or shorten cycle_time_ms",
        ),
        (
            {"data_hold": 0},
            "IocrBlockReq.watchdog: '0h' is not allowed",
            "set the number of update cycles of this device's",
        ),
        (
            {"activity_timeout": 0},
            "ArBlockReq.activity_timeout: '0h' is not allowed",
            "compare name of station, modules",
        ),
    ],
    ids=["data hold", "update time", "watchdog", "another field"],
)
def test_a_refused_connect_has_value_and_limit_in_one_unit_and_a_remedy(
    site: Plant, project: dict[str, int], why: str, remedy: str
) -> None:
    site.plc.project = replace(site.plc.project, **project)  # type: ignore[arg-type]
    site.plc.start(site.loop.now())
    site.run(SECOND)
    assert why in first(site)
    assert remedy in first(site)


# -- frames -----------------------------------------------------------------------------------------------------------


def status(*, off: int = 0, on: int = 0, transfer: int = 0) -> Callable[[bytearray], object]:
    def change(frame: bytearray) -> None:
        frame[-2] = frame[-2] & ~off | on
        frame[-1] = transfer

    return change


def same_counter(frame: bytearray) -> None:
    frame[-4:-2] = bytes(2)


FRAMES: Final[dict[str, tuple[Callable[[bytearray], object], str]]] = {
    "not valid": (status(off=STATUS_DATA_VALID), "DataStatus 31h, bit 2 (data valid) is 0, expected 35h; set the"),
    "STOP, not valid": (status(off=STATUS_DATA_VALID | STATUS_RUN), "DataStatus 21h, bit 2 (data valid) is 0"),
    "ignore": (status(on=STATUS_IGNORE), "DataStatus B5h, bit 7 (ignore) is 1, expected 35h"),
    "backup": (status(off=STATUS_PRIMARY), "DataStatus 34h, bit 0 (primary) is 0, expected 35h"),
    "transfer status": (status(transfer=2), "TransferStatus 02h, expected 00h"),
    "counter": (same_counter, "their cycle counter does not increase; "),
    "length": (lambda frame: frame.extend(bytes(2)), "48 bytes, expected 46"),
}


def change_frames(site: Plant, change: Callable[[bytearray], object] | None) -> None:
    """Change the cyclic frames of the controller."""
    site.plc.__dict__.pop("outgoing", None)
    outgoing = site.plc.outgoing

    def changed() -> list[tuple[tuple[str, int] | None, bytes | bytearray]]:
        items = []
        for to, data in outgoing():
            frame = bytearray(data)
            at = 16 if frame[12:14] == b"\x81\x00" else 12
            if to is None and frame[at : at + 2] == b"\x88\x92" and 0x80 <= frame[at + 2] <= 0xF7:
                change(frame)  # type: ignore[misc]
            items.append((to, frame))
        return items

    if change is not None:
        site.plc.outgoing = changed  # type: ignore[method-assign, assignment]


@pytest.mark.parametrize("kind", FRAMES)
def test_frames_that_come_and_do_not_count_are_named(site: Plant, kind: str) -> None:
    change, wrong = FRAMES[kind]
    come = "frames of the controller plc-1 (192.168.0.1) come and do not count: "
    change_frames(site, change)
    site.plc.start(site.loop.now())
    if kind != "counter":  # the first one counts
        site.run(3 * SECOND)
        assert first(site).startswith(come + wrong)
    change_frames(site, None)
    site.connect()
    site.enable(1, SPEED)
    change_frames(site, change)
    for wait in (100 * MS, 2 * SECOND):
        site.run(wait)
        assert come + wrong in first(site)
        assert "check the cable" not in first(site)
    (fault,) = [item for item in site.daemon.axes[0].faults if item.number == 103]
    assert f"no valid frame for 3 cycles: {come}{wrong}" in fault.text


def test_frames_before_prm_end_are_not_the_cause_of_a_stuck_start_up(site: Plant) -> None:
    change_frames(site, FRAMES["not valid"][0])
    never_end_parameters(site)
    site.plc.project = replace(site.plc.project, activity_timeout=40)
    site.plc.start(site.loop.now())
    for wait in (SECOND, 6 * SECOND):
        site.run(wait)
        assert "its PrmEnd has not come" in first(site)
    assert site.link.device.relation is None


def test_a_late_copy_before_the_silence_is_not_its_cause(site: Plant) -> None:
    site.connect()
    site.enable(1, SPEED)
    head = DEVICE_MAC + PLC_MAC + bytes.fromhex("8100c00088928000")
    copy = next(frame for _, frame in reversed(site.frames) if frame.startswith(head))
    site.port.arrive(None, copy)
    site.killed = True
    site.run(SECOND)
    assert site.link.status()["frames"]["stale cycle counter"] == 1  # type: ignore[index]
    assert site.link.device.relation is None
    assert "come and do not count" not in first(site)
    assert "check the cable" in first(site)


def test_a_controller_in_stop_is_not_a_loss(site: Plant) -> None:
    site.connect()
    site.enable(1, SPEED)
    change_frames(site, status(off=STATUS_RUN))
    site.run(SECOND)
    assert "the PLC is in STOP" in first(site)


# -- project ----------------------------------------------------------------------------------------------------------

AXIS_1 = object_module(ObjectKind.AXIS, telegram(1))
ENCODER = object_module(ObjectKind.ENCODER, telegram(81))
HEAD = access_module()
CONFIGURED: Final = {0: HEAD, 1: AXIS_1}
LONGER = replace(AXIS_1, submodules=AXIS_1.submodules | {2: Submodule(0x0001_0001, 8, 4)})
PROJECTS: Final[dict[str, tuple[Mapping[int, Module], dict[int, str]]]] = {
    "equal": (CONFIGURED, {}),
    "without interface and port": ({0: replace(HEAD, submodules={1: HEAD.submodules[1]}), 1: AXIS_1}, {}),
    "another telegram": (
        {0: HEAD, 1: object_module(ObjectKind.AXIS, telegram(9))},
        {1: "axis with telegram 9, configured is axis with telegram 1"},
    ),
    "an encoder before the axis": (
        {0: HEAD, 1: ENCODER, 2: AXIS_1},
        {
            1: "encoder with telegram 81, configured is axis with telegram 1",
            2: "axis with telegram 1, configured is nothing",
        },
    ),
    "another head module": (
        {0: replace(HEAD, ident=2), 1: AXIS_1},
        {0: "module 00000002h, configured is module 00000001h"},
    ),
    "no axis": ({0: HEAD}, {1: "nothing, configured is axis with telegram 1"}),
    "an access point alone": (
        {0: HEAD, 1: replace(AXIS_1, submodules={1: AXIS_1.submodules[1]})},
        {1: "axis, configured is axis with telegram 1"},
    ),
    "another length": (
        {0: HEAD, 1: LONGER},
        {
            1: "axis with telegram 1 in API 3A00h (subslots 1h: 0001FFFFh, 0 + 0 bytes; 2h: 00010001h, 8 + 4 bytes), "
            "configured is axis with telegram 1 in API 3A00h (subslots 1h: 0001FFFFh, 0 + 0 bytes; 2h: 00010001h, 4 + 4 bytes)"
        },
    ),
}


@pytest.mark.parametrize("name", PROJECTS)
def test_differences_have_what_the_project_has_and_what_is_configured(name: str) -> None:
    modules, wanted = PROJECTS[name]
    expected = [slot for block in Project("x", modules).expected() for slot in block.slots]
    found = differences(expected, CONFIGURED)
    assert found == {slot: f"slot {slot}: the controller's project has {text}" for slot, text in wanted.items()}


def test_an_axis_that_the_project_has_elsewhere_names_both_slots(site: Plant, caplog: pytest.LogCaptureFixture) -> None:
    site.plc.project = replace(site.plc.project, modules={0: HEAD, 1: ENCODER, 2: AXIS_1})
    site.connect()
    site.run(100 * MS)
    both = PROJECTS["an encoder before the axis"][1]
    texts = [f"slot {slot}: the controller's project has {text}" for slot, text in both.items()]
    assert first(site).startswith("; ".join(texts))
    assert set(texts) <= set(caplog.messages)


def test_an_extra_slot_of_the_project_is_logged_and_stops_no_axis(
    site: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    site.plc.project = replace(site.plc.project, modules={0: HEAD, 1: AXIS_1, 2: ENCODER})
    site.connect()
    site.enable(1, SPEED)
    assert drive_state(site.word()) == 0x07
    assert "slot 2: the controller's project has encoder with telegram 81, configured is nothing" in caplog.messages
