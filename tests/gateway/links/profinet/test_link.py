"""The PROFINET link on virtual time: setpoints, losses, diagnosis, what DCP gives and what is kept of it."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import IPv4Address
from itertools import pairwise
from pathlib import Path
from typing import Any, cast
from uuid import UUID

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.ds301.node.node import NodeStatus
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.links.profinet.diagnosis import MESSAGE_CLASSES, message_class
from pdgw.gateway.links.profinet.ethernet import dcp_filter, real_time_filter
from pdgw.gateway.links.profinet.io_device import ProfinetLink
from pdgw.gateway.objects.fault_buffer import FaultLog, FaultRecord
from pdgw.peers.controller.controller import IoController, Phase
from pdgw.peers.controller.project import Project
from pdgw.profidrive.frame import IOPS_BAD, IOPS_GOOD
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet import ethernet
from pdgw.profinet.blocks.alarm import AlarmType, MessageClass
from pdgw.profinet.connection.cmdev import State
from pdgw.profinet.discovery import dcp, lldp
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT, object_uuid
from pdgw.profinet.station import Identity, IpSuite, Station
from pdgw.tools.output.status_text import _station
from tests.fuzz.test_profinet import LEAK
from tests.support.wire.ethernet import FakeEthernet
from tests.support.wire.profinet import DEVICE_IP, DEVICE_MAC, PLC_IP, PLC_MAC

AXIS = (1, 2)


@dataclass
class FakeNode:
    status: NodeStatus = NodeStatus.ONLINE


class FakeObject:
    """A drive object: what the link asks it."""

    def __init__(self, number: int) -> None:
        self.telegram = telegram(number)
        self.client = FakeNode()
        self.fault_log = FaultLog(0)


class Rig:
    def __init__(self, tmp_path: Path, **transport: Any) -> None:
        self.loop = VirtualLoop()
        self.port = FakeEthernet(self.loop)
        document = {
            "can": {"interface": "virtual"},
            "transport": {"type": "profinet", "interface": "eth1", "station_name": "gateway", **transport},
            "axis": [{"do_id": 1, "node_id": 1, "telegram": 1}, {"do_id": 2, "node_id": 2, "telegram": 9}],
        }
        self.config = GatewayConfig.model_validate(document)
        self.path = tmp_path / "store.json"
        self.objects = [FakeObject(1), FakeObject(9)]
        self.cycles = 0
        self.starts = 4
        self.start()
        self.plc = IoController(
            Station(Identity(PLC_MAC, 1, 1, "plc", "PLC"), "plc-1"),
            Project("gateway", self.link.device.model.modules, data_hold=200),
            DEVICE_IP,
        )

    def start(self) -> None:
        store = ParameterStore(self.path, lambda text: None)
        self.starts += 1  # its own calls have other UUIDs after each start
        self.link = ProfinetLink(self.port, self.config, store, self.loop, self.objects, UUID(int=self.starts << 32))
        self.link.start(self.on_link)

    def on_link(self) -> None:
        if self.link.receive(self.loop.now()):
            self.cycles += 1

    def run(self, ns: int, until: Callable[[], object] = lambda: False) -> None:
        """Both ends, until the time is over or the condition holds."""
        end = self.loop.now() + ns

        def turn() -> None:
            now = self.loop.now()
            self.plc.poll(now)
            for address, data in self.plc.outgoing():
                self.port.arrive(address, bytes(data))
            while self.port.sent:
                address, data = self.port.sent.popleft()
                if address is None:
                    self.plc.on_frame(data, now)
                else:
                    self.plc.on_datagram(data, (str(DEVICE_IP.address), ACYCLIC_PORT), now)
            if until() or now >= end:
                self.loop.stop()
            else:
                self.loop.call_at(now + MS // 4, turn)

        self.loop.call_later(0, turn)
        self.loop.run()

    def connect(self) -> None:
        self.plc.start(self.loop.now())
        self.run(5_000 * MS, lambda: self.link.connected and self.plc.phase is Phase.DATA)
        assert self.link.connected, (self.plc.phase, self.plc.learned)

    def set_by_dcp(self, option: dcp.Option, value: bytes, qualifier: int) -> dcp.SetError:
        """The device's answer."""
        block = dcp.encode_block(option, qualifier.to_bytes(2, "big") + value)
        payload = dcp.encode(dcp.FRAME_ID_GET_SET, dcp.Service.SET, dcp.ServiceType.REQUEST, 1, block)
        self.port.sent.clear()
        self.port.arrive(None, ethernet.frame(DEVICE_MAC, PLC_MAC, payload))
        answer = next(data for _, data in self.port.sent if data[14:17] == b"\xfe\xfd\x04")
        (content,) = [content for _, content in dcp.split(answer[26:33])]
        self.run(20 * MS)
        return dcp.SetError(content[2])


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def test_setpoints_arrive_as_values_and_actual_values_leave_with_their_status(rig: Rig) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    rig.run(20 * MS)
    assert rig.link.setpoints[0] == (0x047F, 0x2000)
    rig.link.send([(0x0E37, 0x1FFF), (1, 2, 3, 4)], [True, False], 0)
    rig.run(20 * MS)
    assert rig.plc.input(AXIS) == bytes.fromhex("0e371fff")
    assert rig.plc.input((2, 2)) is None, "IOPS of the second object is BAD"
    assert rig.cycles > 3


def test_the_first_input_frame_after_application_ready_has_valid_data(rig: Rig) -> None:
    rig.link.send([(0x0270, 5), (1, 2, 3, 4)], [True, False], 0)
    rig.plc.start(rig.loop.now())
    rig.run(5_000 * MS, lambda: (rel := rig.link.device.relation) and rel.state is not State.PARAMETERISING)
    relation = rig.link.device.relation
    assert relation is not None
    assert relation.provider is not None
    for place, data, status in ((AXIS, "02700005", IOPS_GOOD), ((2, 2), "00010002000300000004", IOPS_BAD)):
        where = relation.provider.place(place)
        assert where is not None
        assert bytes(relation.provider.frame[where[0] : where[1]]).hex() == data
        assert relation.provider.frame[where[1]] == status


def test_an_axis_loses_its_plc_long_before_the_data_hold_time(rig: Rig) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    rig.run(20 * MS)
    assert not rig.link.poll(rig.loop.now())
    rig.plc.provider = None
    since = rig.loop.now()
    rig.run(800 * MS, lambda: rig.link.poll(rig.loop.now()))
    assert rig.loop.now() - since <= 3 * 4 * MS + MS
    assert rig.link.setpoints == [None, None]
    assert rig.link.device.connected, "the relationship itself waits for its data hold time of 800 ms"
    assert rig.link.finding(0) is None, "the controller did not mark its data as bad"
    assert rig.link.watchdog_expiries == 1


@pytest.mark.parametrize("way", ["release", "cable", "silence"])
def test_every_end_of_the_relationship_takes_the_setpoints_away(rig: Rig, way: str) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    rig.run(20 * MS)
    if way == "release":
        rig.plc.release(rig.loop.now())
        rig.run(20 * MS)
    elif way == "cable":
        rig.port.link_up = False
        rig.port.on_link()
    else:
        rig.plc.provider = None
        rig.run(1000 * MS)
    assert not rig.link.connected
    assert rig.link.setpoints == [None, None]
    assert rig.link.poll(rig.loop.now())
    assert not rig.link.poll(rig.loop.now()), "told once"


def test_a_controller_in_stop_gives_no_setpoints(rig: Rig) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    rig.run(20 * MS)
    assert rig.plc.provider is not None
    rig.plc.provider.data_status &= ~0x10
    rig.run(20 * MS)
    assert rig.link.setpoints == [None, None]
    assert rig.link.connected


def test_data_that_the_controller_marks_as_bad_is_named(rig: Rig) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"), good=False)
    rig.run(20 * MS)
    found = rig.link.finding(0)
    assert found is not None
    assert found.reason is Reason.PLC_BAD


def cyclic(rig: Rig, values: bytes) -> bytes:
    """The controller's next frame with output data."""
    provider = rig.plc.provider
    assert provider is not None
    provider.set(AXIS, values, good=True)
    frame = provider.poll(provider.due)
    assert frame is not None
    return bytes(frame[:12] + frame[16:])  # the kernel takes the tag


def test_after_a_punctual_frame_nothing_is_read_and_a_backlog_is_read_at_once(rig: Rig) -> None:
    rig.connect()
    rig.run(20 * MS)
    cycle = 4 * MS
    now = rig.loop.now() + cycle
    rig.port.real_time.append(cyclic(rig, bytes.fromhex("047f0001")))
    rig.link.receive(now, 1)
    taken = []
    for late in (cycle, 3 * cycle, cycle // 8):  # at its time, after a pause, at the heels of the one before
        now += late
        rig.port.real_time.append(cyclic(rig, bytes.fromhex("047f0002")))
        assert rig.link.receive(now, 1)
        taken.append(rig.link.more)
    assert taken == [False, True, True]
    assert not rig.link.receive(now)
    assert rig.link.more, "the next frame is looked at anew"


def test_cyclic_frames_alone_do_not_hide_what_else_is_due(rig: Rig) -> None:
    """Frames are sent by the short way; LLDP, alarms and the data hold time are on time anyway."""
    rig.connect()
    seen: list[bytes] = []
    original = rig.port.send

    def send(frame: bytes | bytearray) -> None:
        seen.append(bytes(frame))
        original(frame)

    rig.port.send = send  # type: ignore[method-assign]
    rig.run(2 * lldp.INTERVAL_NS)
    assert sum(frame[12:14] == b"\x88\xcc" for frame in seen) == 2
    counters = [int.from_bytes(frame[-4:-2], "big") for frame in seen if frame[18:20] == b"\x80\x01"]
    assert len(counters) == pytest.approx(2 * lldp.INTERVAL_NS / (4 * MS), abs=2)
    assert {(later - earlier) & 0xFFFF for earlier, later in pairwise(counters)} == {4 * 32}
    rig.link.device.set_diagnosis((1, 1), MessageClass.MOTOR_OVERLOAD)
    rig.run(20 * MS)
    assert [alarm.slot for alarm in rig.plc.learned.alarms] == [1]
    rig.plc.silent = True
    rig.run(900 * MS)
    assert not rig.link.connected


def test_a_stop_takes_effect_before_the_run_that_follows_it(rig: Rig) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    rig.run(20 * MS)
    assert rig.plc.provider is not None
    frame = bytes(rig.plc.provider.frame)
    counter = int.from_bytes(frame[-4:-2], "big")
    for step, status in ((128, 0x25), (256, 0x35)):
        later = (counter + step & 0xFFFF).to_bytes(2, "big")
        rig.port.real_time.append(frame[:-4] + later + bytes((status, 0)))
    assert rig.link.receive(rig.loop.now())
    assert rig.link.setpoints == [None, None]
    assert rig.link.receive(rig.loop.now())
    assert rig.link.setpoints[0] == (0x047F, 0x2000)


@pytest.mark.parametrize(
    ("transport", "limit_ms"),
    [({}, 12), ({"watchdog_factor": 1}, 8), ({"cycle_time_ms": 10}, 30), ({"cycle_time_ms": 1}, 12)],
    ids=["watchdog", "two cycles", "longer cycle of the gateway", "longer cycle of the controller"],
)
def test_frames_that_waited_in_a_paused_gateway_are_not_a_sign_of_life(
    tmp_path: Path, transport: dict[str, int], limit_ms: int
) -> None:
    rig = Rig(tmp_path, **transport)
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    rig.run(20 * MS)
    now = rig.loop.now()
    for waited in (limit_ms * MS, limit_ms * MS + 1):
        rig.link.receive(now)
        assert not rig.link.poll(now)
        now += waited
        for word in ("047e2000", "047f2000"):
            rig.port.real_time.append(cyclic(rig, bytes.fromhex(word)))
        if waited == limit_ms * MS:
            assert rig.link.receive(now)
            assert rig.link.setpoints[0] == (0x047E, 0x2000)
            assert rig.link.receive(now)
    assert not rig.link.receive(now)
    assert "held up" in rig.link.poll(now)
    while rig.port.real_time:
        rig.link.receive(now)
    assert rig.link.setpoints == [None, None], "OFF and ON are as old as the frames of the PLC before"
    now += limit_ms * MS + 1
    for word in ("047e2000", "047f2000"):
        rig.port.real_time.append(cyclic(rig, bytes.fromhex(word)))
    assert not rig.link.receive(now)
    assert rig.link.setpoints == [None, None], "the same after a loss"
    rig.port.real_time.append(cyclic(rig, bytes.fromhex("047e2000")))
    assert rig.link.receive(now + 1)
    assert rig.link.setpoints[0] == (0x047E, 0x2000)


def test_a_drive_that_is_lost_and_comes_back_is_diagnosis_and_return_of_submodule(rig: Rig) -> None:
    rig.connect()
    rig.objects[0].client.status = NodeStatus.LOST
    rig.run(200 * MS)
    rig.objects[0].client.status = NodeStatus.ONLINE
    rig.run(200 * MS)
    kinds = [(item.alarm_type, item.slot, item.subslot) for item in rig.plc.learned.alarms]
    assert kinds == [
        (AlarmType.DIAGNOSIS, 1, 1),
        (AlarmType.DIAGNOSIS_DISAPPEARS, 1, 1),
        (AlarmType.RETURN_OF_SUBMODULE, 1, 2),
    ]
    assert rig.plc.learned.alarms[0].payload[-2:] == MessageClass.INTERNAL_COMMUNICATION.to_bytes(2, "big")


def test_a_fault_of_a_drive_is_reported_by_its_class_until_it_is_acknowledged(rig: Rig) -> None:
    rig.connect()
    rig.objects[1].fault_log.enter(FaultRecord(4, 0x3210, 0, "over-voltage", rig.loop.now()))
    rig.run(200 * MS)
    rig.objects[1].fault_log.acknowledge()
    rig.run(200 * MS)
    told = [(item.alarm_type, item.slot, item.payload[-2:].hex()) for item in rig.plc.learned.alarms]
    assert told == [(AlarmType.DIAGNOSIS, 2, "9003"), (AlarmType.DIAGNOSIS_DISAPPEARS, 2, "9003")]


def test_a_fault_of_a_drive_is_an_alarm_after_any_number_of_other_faults(rig: Rig) -> None:
    rig.connect()
    for number in (*range(101, 112), *[103] * 20):
        rig.objects[1].fault_log.enter(FaultRecord(number, 0xFF00 + number, 0, "", rig.loop.now()))
    rig.run(200 * MS)
    rig.objects[1].fault_log.enter(FaultRecord(4, 0x3210, 0, "over-voltage", rig.loop.now()))
    rig.run(200 * MS)
    assert [item.payload[-2:].hex() for item in rig.plc.learned.alarms][-1] == "9003"


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (0x2310, MessageClass.POWER_ELECTRONICS),
        (0x3210, MessageClass.DC_LINK),
        (0x3110, MessageClass.MAINS),
        (0x4210, MessageClass.TEMPERATURE),
        (0x4310, MessageClass.MOTOR_OVERLOAD),
        (0x5110, MessageClass.SUPPLY),
        (0x6320, MessageClass.PARAMETERS),
        (0x7305, MessageClass.ACTUAL_VALUE),
        (0x8130, MessageClass.INTERNAL_COMMUNICATION),
        (0x8611, MessageClass.APPLICATION),
        (0x0000, MessageClass.GENERAL),
        (0xFF01, MessageClass.CONTROLLER_COMMUNICATION),
    ],
)
def test_error_codes_belong_to_the_class_of_their_longest_prefix(code: int, expected: MessageClass) -> None:
    assert message_class(code) is expected
    assert all(1 <= len(prefix) <= 3 for prefix in MESSAGE_CLASSES)


# -- name and address -------------------------------------------------------------------------------------------------


def test_a_permanent_name_and_address_are_there_after_a_restart(rig: Rig) -> None:
    rig.set_by_dcp(dcp.Option.NAME, b"press-2", 1)
    rig.set_by_dcp(dcp.Option.IP, DEVICE_IP.encode(), 1)
    assert rig.port.address == DEVICE_IP
    rig.port.address = IpSuite()
    rig.start()
    assert (rig.link.station.name, rig.link.station.ip) == ("press-2", DEVICE_IP)
    assert rig.port.address == DEVICE_IP


def test_a_temporary_name_and_address_are_gone_after_a_restart(rig: Rig) -> None:
    rig.set_by_dcp(dcp.Option.NAME, b"press-2", 0)
    rig.set_by_dcp(dcp.Option.IP, DEVICE_IP.encode(), 0)
    assert rig.link.station.name == "press-2"
    rig.port.address = IpSuite()
    rig.start()
    assert (rig.link.station.name, rig.link.station.ip.is_set) == ("", False)


def test_reset_to_factory_clears_name_address_and_identification(rig: Rig) -> None:
    for place in (rig.link._store.parameters, rig.link._store.parameters.drive_object(1)):
        place.im3_descriptor = "mine"
    rig.set_by_dcp(dcp.Option.NAME, b"press-2", 1)
    rig.set_by_dcp(dcp.Option.RESET, b"", 4)
    rig.start()
    assert rig.link.station.name == ""
    stored = rig.link._store.parameters
    assert (stored.im3_descriptor, stored.drive_object(1).im3_descriptor) == ("", "")


def test_an_address_that_may_not_be_set_is_reported_and_not_kept(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    rig.port.may_set = False
    assert rig.set_by_dcp(dcp.Option.IP, DEVICE_IP.encode(), 1) is dcp.SetError.LOCAL
    assert "cannot be set" in caplog.text
    assert rig.link._store.parameters.station_ip is None
    assert not rig.link.station.ip.is_set, "DCP tells the address that is there"
    assert rig.set_by_dcp(dcp.Option.RESET, b"", 4) is dcp.SetError.OK


def test_a_fixed_address_is_given_to_the_interface_and_stays(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ip="10.1.2.3/24", router="10.1.2.1")
    fixed = IpSuite(IPv4Address("10.1.2.3"), IPv4Address("255.255.255.0"), IPv4Address("10.1.2.1"))
    assert rig.port.address == fixed
    assert rig.set_by_dcp(dcp.Option.IP, DEVICE_IP.encode(), 0) is dcp.SetError.LOCAL
    assert rig.set_by_dcp(dcp.Option.IP, fixed.encode(), 0) is dcp.SetError.OK
    assert rig.set_by_dcp(dcp.Option.RESET, b"", 4) is dcp.SetError.OK
    assert rig.port.address == rig.link.station.ip == fixed


def test_a_flash_signal_is_shown_for_three_seconds(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    rig.set_by_dcp(dcp.Option.SIGNAL, b"\1\0", 0)
    station = cast("dict[str, Any]", rig.link.status()["station"])
    assert station["flashing"]
    assert "flash signal" in caplog.text
    rig.run(3000 * MS)
    assert not cast("dict[str, Any]", rig.link.status()["station"])["flashing"]


# -- the rest of Link -------------------------------------------------------------------------------------------------


def test_telegrams_change_only_while_no_controller_is_connected(rig: Rig) -> None:
    rig.link.set_layout([telegram(2), telegram(9)])
    assert rig.link.device.model.modules[1].submodules[2].outputs == telegram(2).setpoints.size
    rig.link.set_layout([telegram(1), telegram(9)])
    rig.connect()
    with pytest.raises(GatewayError, match="while a controller is connected"):
        rig.link.set_layout([telegram(2), telegram(9)])
    assert rig.link.connected


def test_status_and_counters_show_the_controller(rig: Rig) -> None:
    rig.connect()
    rig.run(100 * MS)
    status = rig.link.status()
    assert status["connected"]
    assert status["peer"] == [PLC_IP, ACYCLIC_PORT]
    station = cast("dict[str, Any]", status["station"])
    assert (station["name"], station["controller"], station["cycle_ms"]) == ("gateway", "plc-1", 4)
    counters = {item.name: item.read() for item in rig.loop.counters if item.part == "link"}
    assert counters["accepted"] > 20
    assert counters["sent"] > 20
    assert counters["missed"] == 0
    text = _station(station)
    assert (
        text
        == f"station gateway, IP 192.168.0.2, {rig.port.mac.hex(':')}, controller plc-1: exchanges data, cycle 4 ms"
    )
    rig.port.link_up = False
    rig.port.on_link()
    station = cast("dict[str, Any]", rig.link.status()["station"])
    assert _station(station).endswith(", cable off, no relationship")


def test_a_refused_connect_is_in_the_log_with_its_reason_and_repetitions_do_not_fill_it(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    def ask(**wrong: int) -> list[str]:
        project = Project("gateway", rig.link.device.model.modules, **wrong)
        caller = Station(Identity(PLC_MAC, 1, 1, "plc", "PLC"), "plc-1")
        rig.plc = IoController(caller, project, DEVICE_IP, seed=rig.loop.now() + 1)
        rig.plc.start(rig.loop.now())
        rig.run(20 * MS)
        return [item.getMessage() for item in caplog.records if "Connect from" in item.getMessage()]

    field = "ArBlockReq.activity_timeout: '0h' is not allowed, expected 1..1000"
    for _ in range(100):
        told = ask(activity_timeout=0)
    assert told == [f"Connect from 192.168.0.1 rejected, error (DB 81 01 0A): {field}"]
    told = ask(data_hold=0)
    assert len(told) == 2, "another reason"
    assert "IocrBlockReq.watchdog" in told[1]
    assert len(ask(activity_timeout=0)) == 2, "not two in a second"
    rig.run(60_000 * MS)
    assert len(ask(data_hold=0)) == 3
    assert rig.link.device.cm.refusals == 103


def test_calls_without_an_answer_are_counted_and_the_first_one_is_logged(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    calls = RecordCaller(UUID(int=1), object_uuid(1, 1, 1))
    old, new = (calls.read(0, 0, 1, 0xAFF0, implicit=True).packets[0] for _ in range(2))
    for packet in (new, old, old, b"no packet"):
        rig.port.arrive((PLC_IP, ACYCLIC_PORT), packet)
        rig.run(MS)
    counters = {item.name: item.read() for item in rig.loop.counters if item.part == "calls"}
    assert counters == {"malformed": 1, "repeated": 0, "dropped": 2}
    (line,) = [item.getMessage() for item in caplog.records if "not answered" in item.getMessage()]
    assert line.startswith("call from 192.168.0.1:34964 not answered: sequence number 0 is below 1 of its last call (")


def test_the_end_of_the_daemon_informs_the_controller(rig: Rig) -> None:
    rig.connect()
    rig.link.close()
    assert rig.port.closed
    while rig.port.sent:
        _, data = rig.port.sent.popleft()
        rig.plc.on_frame(data, rig.loop.now())
    assert rig.plc.learned.error == 0xCF81FD0D


def test_a_flood_of_dcp_and_calls_delays_no_frame(rig: Rig) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    identify = dcp.encode(0xFEFE, dcp.Service.IDENTIFY, dcp.ServiceType.REQUEST, 9, bytes.fromhex("ffff0000"), 1)
    frame = ethernet.frame(ethernet.DCP_MULTICAST, PLC_MAC, identify)
    for _ in range(200):
        rig.port.other.extend([frame] * 10)
        rig.port.datagrams.extend([(bytes(100), ("192.168.0.9", 1))] * 10)
        rig.run(MS // 2)
    assert rig.link.connected
    assert rig.link.setpoints[0] == (0x047F, 0x2000)
    assert rig.link.watchdog_expiries == 0


@pytest.mark.parametrize("source", [PLC_MAC, bytes.fromhex("020000000099")], ids=["controller", "unknown"])
def test_a_storm_of_alarms_delays_no_frame_and_fills_nothing(rig: Rig, source: bytes) -> None:
    rig.connect()
    rig.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    seen: list[bytes] = []
    arrive = rig.port.arrive

    def listening(address: Any, data: bytes) -> None:
        seen.extend([data] if address is None else [])
        arrive(address, data)

    rig.port.arrive = listening  # type: ignore[method-assign]
    rig.link.device.set_diagnosis((1, 1), MessageClass.MAINS)
    rig.run(100 * MS)
    alarms = [data for data in seen if b"\xfe\x01" in (data[14:16], data[18:20])]
    assert len(alarms) == 2, "ACK, and DATA with the AlarmAck"
    storm = [frame[:6] + source + frame[12:] for frame in alarms]
    storm += [frame[:-1] for frame in storm] + [frame[:24] + b"\x12" + frame[25:] for frame in storm]
    quiet = rig.cycles
    rig.run(200 * MS)
    quiet = rig.cycles - quiet

    def half(ms: int) -> None:
        for _ in range(2 * ms):
            rig.port.real_time.extend(storm * 4)
            rig.port.on_real_time()
            rig.run(MS // 2)

    half(100)
    tracemalloc.start()
    seen.clear()
    gc.collect()
    before, cycles = tracemalloc.get_traced_memory()[0], rig.cycles
    rig.link.device.set_diagnosis((1, 2), MessageClass.MAINS)
    half(200)
    seen, answered = [], [data for data in seen if b"\xfe\x01" in (data[14:16], data[18:20])]
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert len(answered) >= 2, "the alarm of the device is acknowledged meanwhile"
    assert rig.link.connected
    assert rig.link.setpoints[0] == (0x047F, 0x2000)
    assert rig.link.watchdog_expiries == 0
    assert abs(rig.cycles - cycles - quiet) <= 1
    assert grown < LEAK


# -- the filters in the kernel, by a small interpreter ----------------------------------------------------------------


def passes(program: list[tuple[int, int, int, int]], frame: bytes) -> bool:
    accumulator, at = 0, 0
    while True:
        code, yes, no, operand = program[at]
        at += 1
        if code == 0x20:
            accumulator = int.from_bytes(frame[operand : operand + 4], "big")
        elif code == 0x28:
            accumulator = int.from_bytes(frame[operand : operand + 2], "big")
        elif code == 0x15:
            at += yes if accumulator == operand else no
        elif code == 0x35:
            at += yes if accumulator >= operand else no
        elif code == 0x25:
            at += yes if accumulator > operand else no
        else:
            return bool(operand)


@pytest.mark.parametrize(
    ("destination", "frame_id", "real_time", "other"),
    [
        (DEVICE_MAC, 0x8000, True, False),
        (DEVICE_MAC, 0xFC01, True, False),
        (DEVICE_MAC, 0xFE01, True, False),
        (PLC_MAC, 0x8000, False, False),
        (b"\xff" * 6, 0x8000, False, False),
        (DEVICE_MAC, 0xFEFD, False, True),
        (ethernet.DCP_MULTICAST, 0xFEFE, False, True),
        (DEVICE_MAC, 0xFF00, False, False),
    ],
)
def test_the_kernel_passes_only_what_each_socket_is_for(
    destination: bytes, frame_id: int, real_time: bool, other: bool
) -> None:
    frame = ethernet.frame(destination, PLC_MAC, frame_id.to_bytes(2, "big"))
    assert passes(real_time_filter(DEVICE_MAC), frame) is real_time
    assert passes(dcp_filter(), frame) is other


@pytest.mark.parametrize("word", [0x047E, 0x047D, 0x047B, 0x046F])
def test_each_change_of_a_control_word_is_a_step_of_its_own_however_many_frames_wait(rig: Rig, word: int) -> None:
    """An OFF of one frame must not be overtaken by the ON behind it."""
    rig.connect()
    provider = rig.plc.provider
    assert provider is not None
    for speed, sent in enumerate((0x047F, 0x047F, word, 0x047F, 0x047F)):
        rig.plc.set_output(AXIS, sent.to_bytes(2, "big") + speed.to_bytes(2, "big"))
        frame = provider.poll(provider.due)
        assert frame is not None
        rig.port.real_time.append(bytes(frame))
    seen = []
    while rig.link.receive(rig.loop.now()):
        seen.append(rig.link.setpoints[0])
    assert seen == [(0x047F, 0), (word, 2), (0x047F, 3), (0x047F, 4)]
