"""The status document with its counters, its socket that no client can block, and the gateway built by one function."""

from __future__ import annotations

import ast
import json
import re
import socket
from pathlib import Path
from typing import Any

import pytest

import pdgw
from pdgw.base.durations import MS
from pdgw.ds301.counters import Counters
from pdgw.dsp402.states import State
from pdgw.gateway.axis.values import FaultRecord, gateway_fault
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.identity import build_text
from pdgw.gateway.base.log_budget import LogBudget
from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.fault_buffer import FaultLog
from pdgw.gateway.parameters.acyclic import AcyclicServer
from pdgw.gateway.service.cycle_times import Histogram
from pdgw.gateway.service.operating_system import ServiceManager
from pdgw.gateway.service.status import axis_status, encoder_status, snapshot
from pdgw.gateway.service.status_port import StatusServer, answered
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import (
    OFF,
    Plc,
    axis,
    configuration,
    drive_of,
    operating,
    running,
    switch_off,
    until,
    world_of,
)
from tests.support.processes import free_tcp_port

ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 83\nsimulate = true\n"


def broken(daemon: Daemon) -> Reason | None:
    """The reason of the first broken link of the first axis."""
    link = daemon.axes[0].enable_status.broken
    return None if link is None else link.reason


def state(daemon: Daemon) -> AxisState:
    return daemon.axes[0].enable_status.state


def test_the_chain_follows_an_axis_from_silence_to_operation_and_back() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        assert state(daemon) is AxisState.STARTING
        # Two links are broken; the physical one speaks.
        assert broken(daemon) is Reason.NODE_CONFIGURING
        until(daemon, lambda: state(daemon) is AxisState.WAITS, "online")
        assert broken(daemon) is Reason.NO_PLC
        plc.endpoint.set(0, {"STW1": OFF & ~0x400})
        plc.until(lambda: state(daemon) is AxisState.WAITS and broken(daemon) is not Reason.NO_PLC, "a PLC")
        assert broken(daemon) is Reason.NO_CONTROL
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: state(daemon) is AxisState.OFF, "off, as it is asked")
        assert broken(daemon) is Reason.SWITCHED_OFF
        seen = set()
        plc.endpoint.set(0, {"STW1": OFF | 1})

        def in_operation() -> bool:
            seen.add((state(daemon), broken(daemon)))
            return state(daemon) is AxisState.OBEYS

        plc.until(in_operation, "operation")
        assert (AxisState.STARTING, Reason.NOT_OPERATING) in seen
        assert broken(daemon) is None
        assert all(link.ok for link in daemon.axes[0].enable_status.chain)
        plc.endpoint.set(0, {"STW1": OFF | 1, "NSOLL_A": 0x4000})
        plc.until(lambda: plc.value("NIST_A") > 0x3000, "turns")
        plc.silent = True
        plc.until(lambda: state(daemon) is AxisState.STOPPING, "power on, PLC lost")
        assert broken(daemon) is Reason.PLC_LOST
        plc.until(lambda: state(daemon) is AxisState.WAITS, "stopped")


def test_a_fault_has_id_time_and_activity_and_only_the_newest_is_in_the_document() -> None:
    with operating() as (daemon, plc):
        drive_of(daemon).inject(7)
        plc.until(lambda: state(daemon) is AxisState.FAULT, "fault")
        assert broken(daemon) is Reason.DRIVE_FAULT
        daemon.axes[0].raise_fault(FaultNumber.FRAME_CHANGED, "made up", world_of(daemon).loop.now())
        entry = axis_status(daemon.axes[0])
        (newest,) = entry["faults"]
        assert (newest["number"], newest["active"], newest["id"]) == (127, True, entry["fault_count"])
        answer = json.loads(b"".join(answered(daemon, b"faults 1\n")))
        assert [fault["id"] for fault in answer["faults"]] == list(range(entry["fault_count"], 0, -1))
        assert all(fault["time"].startswith("20") for fault in answer["faults"])
        drive_of(daemon).clear()
        plc.endpoint.set(0, {"STW1": OFF})
        plc.exchange()
        plc.endpoint.set(0, {"STW1": OFF | 0x80})
        plc.until(lambda: drive_of(daemon).model.state is State.SWITCH_ON_DISABLED, "acknowledged")
        plc.until(lambda: not axis_status(daemon.axes[0])["faults"][0]["active"], "no longer active")


def test_a_value_no_pdo_brings_is_null_and_not_0() -> None:
    with running(configuration(axis(1) + axis(3, telegram_number=9) + ENCODER)) as daemon:
        until(daemon, lambda: all(item.good for item in daemon.objects), "online")
        speed, positions = (axis_status(item) for item in daemon.axes)
        assert (speed["position"], speed["velocity"]) == (None, 0)
        assert isinstance(positions["position"], int)
        assert positions["position_unit"]
        assert isinstance(encoder_status(daemon.encoders[0])["position"], int)


def test_what_is_sent_in_parts_is_the_snapshot() -> None:
    with running(configuration(axis(1) + axis(3) + ENCODER)) as daemon:
        parts = list(answered(daemon, b"\n"))
        assert len(parts) > 3  # an exchange comes in between
        assert json.loads(b"".join(parts)) == snapshot(daemon)
        document = snapshot(daemon)
        assert (document["schema"], document["simulated"], document["name"]) == (2, True, "pdgw")
        assert [item["do_id"] for item in document["axes"]] == [1, 3]
        assert f"{document['version']}, {document['build']}, {document['python']}" == build_text()


@pytest.mark.parametrize(
    ("request_", "field"), [(b"faults 9\n", "do_id"), (b"faults\n", "request"), (b"\xff\x00 x\n", "request")]
)
def test_an_unknown_request_is_refused_with_what_is_allowed(request_: bytes, field: str) -> None:
    with running(configuration(axis(1))) as daemon:
        answer = json.loads(b"".join(answered(daemon, request_)))
        assert answer["field"] == field
        assert "allowed" in answer["error"]


def test_only_a_heartbeat_names_a_node_that_is_not_in_the_configuration() -> None:
    with running(configuration(axis(1))) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        bus = daemon.networks["can"]
        bus.on_frame(0x1C5, bytes(8), bus.loop.now())  # a PDO of node 1 can have this COB-ID
        assert snapshot(daemon)["buses"][0]["unconfigured"] == []
        bus.on_frame(0x700 + 77, b"\x05", bus.loop.now())
        assert snapshot(daemon)["buses"][0]["unconfigured"] == [77]


def test_a_lost_drive_is_not_shown_as_turning() -> None:
    with operating() as (daemon, plc):
        plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        plc.until(lambda: plc.value("NIST_A") > 0x1F00, "turns")
        assert axis_status(daemon.axes[0])["speed_rpm"] > 0
        switch_off(daemon, drive_of(daemon))
        plc.until(lambda: state(daemon) is AxisState.NOT_ON_THE_BUS, "lost")
        found = axis_status(daemon.axes[0])
        assert (found["velocity"], found["speed_rpm"], found["drive_state"]) == (None, None, "unknown")
        row = next(line for line in status_lines(snapshot(daemon), 400) if line.startswith("axis 1:"))
        assert re.search(r"last \d+ rpm.*, \S+ m?s ago", row), row


_HOMING = warning_bits(FaultNumber.HOMING)


def test_a_warning_is_active_until_its_end_and_only_in_its_newest_entry() -> None:
    log = FaultLog(0)
    for number in (FaultNumber.HOMING, FaultNumber.PLC_LOST, FaultNumber.HOMING):
        log.enter(gateway_fault(number, "told", 1))
    assert [(logged.id, logged.active) for logged in log.reported(present=_HOMING)] == [
        (3, True),
        (2, True),
        (1, False),
    ]
    assert [logged.id for logged in log.reported(present=_HOMING, newest=2)] == [3, 2]
    assert [record.number for record in log.unacknowledged()] == [FaultNumber.PLC_LOST]
    # The gateway's warnings end with the standing one of the machine, a fault with its acknowledge or P952 := 0.
    assert [logged.active for logged in log.reported(present=0)] == [False, True, False]
    log.clear(lambda _: False)
    assert not any(logged.active for logged in log.reported(present=0))
    assert not log.unacknowledged()


def test_ids_continue_when_old_faults_are_discarded() -> None:
    log = FaultLog(0)
    for number in range(100):
        log.enter(gateway_fault(FaultNumber.PLC_LOST, str(number), number))
    ids = [logged.id for logged in log.reported(present=0)]
    assert (ids[0], ids[-2], len(ids)) == (100, 37, 65)
    assert ids[-1] == 1, "the first one is not acknowledged"
    log.acknowledge()
    assert len(log.reported(present=0)) == 64


def test_repeated_losses_that_are_acknowledged_leave_the_fault_of_the_drive_in_the_buffer() -> None:
    log = FaultLog(0)
    log.enter(FaultRecord(7, 0x2310, 0, "over-current", 1))
    log.acknowledge()
    for number in range(20):
        log.enter(gateway_fault(FaultNumber.PLC_LOST, "", number))
        log.acknowledge()
    assert [entry.number for entry in log.entries() if entry.number] == [FaultNumber.PLC_LOST, 7]
    log.enter(FaultRecord(7, 0x2310, 0, "over-current", 1))
    log.acknowledge()
    log.enter(gateway_fault(FaultNumber.PLC_LOST, "", 1))
    log.acknowledge()
    assert [entry.number for entry in log.entries() if entry.number] == [
        FaultNumber.PLC_LOST,
        7,
        FaultNumber.PLC_LOST,
        7,
    ]


def test_durations_are_counted_by_class_an_upper_end_belongs_to_its_own() -> None:
    histogram = Histogram()
    for duration in (0, 100_000, 100_001, 1_000_000, 100_000_000, 100_000_001):
        histogram.observe(duration)
    status = histogram.status()
    assert status["bounds_s"] == [0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1]
    assert status["counts"] == [2, 1, 0, 1, 0, 0, 0, 0, 0, 1, 1]
    assert status["sum_s"] == pytest.approx(0.201200002)


def test_cycle_and_answer_times_of_a_daemon_are_in_the_document() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.exchange(50)
        document = snapshot(daemon)
        periods, responses = document["cycle_times"], document["response_times"]
        assert sum(periods["counts"]) == daemon.cycles - 1
        assert sum(responses["counts"]) == document["plc"]["frames"]["accepted"]
        assert periods["sum_s"] == pytest.approx(document["uptime_s"], abs=0.05)


def test_the_status_has_the_age_of_the_plcs_last_frame() -> None:
    with running(configuration(axis(1))) as daemon:
        assert snapshot(daemon)["plc"]["heard_age_ms"] is None
        plc = Plc(daemon, [1])
        plc.enable()
        assert snapshot(daemon)["plc"]["heard_age_ms"] <= 4
        plc.silent = True
        world_of(daemon).loop.run_for(2_000 * MS)
        age = snapshot(daemon)["plc"]["heard_age_ms"]
        assert 2_000 <= age <= 2_004
        assert "the last 2 s ago" in "\n".join(status_lines(snapshot(daemon)))


# -- counters, each with name, unit and meaning -------------------------------------------------------------------


_ROOT = Path(__file__).parents[3]
_EDGE = (
    "ds301/bus/network.py",
    "ds301/loop/loop.py",
    "gateway/daemon/daemon.py",
    "gateway/links",
    "gateway/links/profinet",
)


def test_a_counter_reads_what_its_part_counts_now() -> None:
    counters = Counters()
    seen = [1]
    counters.add("bus can0", "sent", "frames", "accepted by the interface", lambda: seen[0])
    seen[0] = 7
    assert counters.values() == [
        {"part": "bus can0", "name": "sent", "value": 7, "unit": "frames", "meaning": "accepted by the interface"}
    ]


def test_status_lists_every_counter_with_unit_and_meaning() -> None:
    daemon = build_gateway(configuration(axis(1, more="")))
    try:
        listed = snapshot(daemon)["counters"]
    finally:
        daemon.release()
    names = {(item["part"], item["name"]) for item in listed}
    assert {("bus can", "sent"), ("link", "accepted"), ("link", "stale"), ("records", "malformed")} <= names
    assert len(names) == len(listed)
    assert all(item["unit"] and item["meaning"] and item["value"] >= 0 for item in listed)


def _modules() -> list[Path]:
    found: list[Path] = []
    for place in _EDGE:
        path = _ROOT / place
        found += sorted(path.glob("*.py")) if path.is_dir() else [path]
    return found


@pytest.mark.parametrize("path", _modules(), ids=lambda path: path.name)
def test_nothing_public_is_counted_and_not_registered(path: Path) -> None:
    registered = "\n".join(module.read_text() for module in _modules())
    for node in ast.walk(ast.parse(path.read_text())):
        # A sum of times does not count anything.
        if (
            isinstance(node, ast.AugAssign)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.target, ast.Attribute)
        ):
            name = node.target.attr
            assert name.startswith("_") or f'"{name}"' in registered, f"{path.name}: {name} is counted, never shown"


# -- the whole gateway from one function --------------------------------------------------------------------------


CAN = '[can]\ninterface = "virtual"\nchannel = "assembly"\n'


def text(status_port: int, directory: Path, acyclic_port: int = 0) -> str:
    transport = f"[transport]\ncyclic_port = 0\nacyclic_port = {acyclic_port}\nstatus_port = {status_port}\n"
    return f'{CAN}{transport}[trace]\ndirectory = "{directory}"\n{axis(1, more="")}'


def test_status_port_gives_the_events_after_a_number() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        first = daemon.events.newest
        drive_of(daemon).inject(7)
        plc.until(lambda: broken(daemon) is Reason.DRIVE_FAULT and daemon.axes[0].faults, "the fault")
        world_of(daemon).unplug("world")
        plc.until(lambda: not daemon.networks["can"].healthy, "the bus")
        world_of(daemon).unplug("world", False)
        plc.until(lambda: daemon.networks["can"].healthy, "the bus again")

        def events(request: str) -> list[dict[str, Any]]:
            return json.loads(b"".join(answered(daemon, request.encode())))["events"]  # type: ignore[no-any-return]

        found = events(f"events {first}")
        assert [event["number"] for event in found] == list(range(first + 1, daemon.events.newest + 1))
        assert snapshot(daemon)["last_event"] == daemon.events.newest
        assert snapshot(daemon)["axes"][0]["active_faults"][0] == 7
        (fault,) = [event for event in found if event["fault"] == 7]
        assert (fault["kind"], fault["do_id"]) == ("fault", 1)
        assert fault["text"].startswith("fault 7: ")
        assert [event["text"] for event in found if event["kind"] == "bus"] == [
            "bus can: LOST: its interface is lost",
            "bus can: healthy",
        ]
        assert events(f"events {daemon.events.newest}") == []
        assert events("events 0") == events(f"events {daemon.events.newest + 1}"), "the clock was set back"


def test_a_library_user_gets_parameters_status_and_flight_recorder(tmp_path: Path) -> None:
    gateway = pdgw.build_gateway(pdgw.parse_config(text(free_tcp_port(), tmp_path)), name="line-3")
    try:
        kinds = [type(service) for service in gateway.services]
        assert kinds == [LogBudget, AcyclicServer, FlightRecorder, StatusServer, ServiceManager]
        assert {path.stem for path in tmp_path.iterdir()} == {"line-3"}
    finally:
        for service in gateway.services:
            service.stop()
        gateway.release()


def test_a_gateway_in_a_world_serves_parameters_and_opens_nothing_of_this_computer(tmp_path: Path) -> None:
    gateway = pdgw.build_gateway(pdgw.parse_config(text(free_tcp_port(), tmp_path)), pdgw.World())
    assert [type(service) for service in gateway.services] == [LogBudget, AcyclicServer]
    assert list(tmp_path.iterdir()) == []


def test_nothing_stays_open_when_the_status_port_is_in_use(tmp_path: Path) -> None:
    records = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    records.bind(("127.0.0.1", 0))
    port = records.getsockname()[1]
    records.close()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        config = pdgw.parse_config(text(taken.getsockname()[1], tmp_path, port))
        with pytest.raises(GatewayError, match="status port"):
            pdgw.build_gateway(config)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))
