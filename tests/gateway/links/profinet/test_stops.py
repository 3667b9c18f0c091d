"""Every way a PROFINET controller can be lost stops a turning drive within the bound, and nothing starts again by itself."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from ipaddress import IPv4Address
from pathlib import Path

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.states import State
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.project import Layout, Project
from pdgw.profidrive.frame import STATUS_NORMAL, STATUS_PRIMARY, STATUS_RUN
from pdgw.profinet import ethernet
from pdgw.profinet.alarms import apmx
from pdgw.profinet.alarms.apmx import PduType
from pdgw.profinet.blocks.alarm import Priority
from pdgw.profinet.blocks.connect_blocks import IocrBlockReq, IocrType
from pdgw.profinet.blocks.control import ControlCommand, PrmEndReq
from pdgw.profinet.connection.cmdev import AbortCode
from pdgw.profinet.connection.cpm import STATUS_IGNORE
from pdgw.profinet.discovery import dcp
from pdgw.profinet.rpc.records import Operation
from pdgw.profinet.station import IpSuite
from tests.support.gateways.daemon import axis, drive_of
from tests.support.gateways.profinet_daemon import ON, Plant, configuration, parameterise_again, plant
from tests.support.wire.profinet import DEVICE_MAC, PLC_MAC

CYCLE_NS = 4 * MS
WATCHDOG_NS = 3 * CYCLE_NS
BOUND_NS = WATCHDOG_NS + 2 * CYCLE_NS
"""From the controller's last frame to the command that stops the drive: watchdog, the cycle that sees it, the bus."""
SPEED = 0x1000


def kill(site: Plant) -> None:
    site.killed = True


def pull(site: Plant) -> None:
    site.port.link_up = False
    site.port.on_link()
    site.killed = True


def fall_silent(site: Plant) -> None:
    site.plc.silent = True


def stop(site: Plant) -> None:
    assert site.plc.provider is not None
    site.plc.provider.data_status &= ~STATUS_RUN


def become_backup(site: Plant) -> None:
    """Become backup: no data counts then."""
    assert site.plc.provider is not None
    site.plc.provider.data_status &= ~STATUS_PRIMARY


def ignore(site: Plant) -> None:
    assert site.plc.provider is not None
    site.plc.provider.data_status |= STATUS_IGNORE


def mark_bad(site: Plant) -> None:
    site.plc.set_output((1, 2), bytes(4), good=False)


def release(site: Plant) -> None:
    site.plc.release(site.loop.now())


def abort(site: Plant) -> None:
    relation = site.link.device.relation
    assert relation is not None
    pdu = apmx.encode(
        Priority.LOW,
        relation.reference,
        site.plc.project.alarm().reference,
        PduType.ERR,
        0xFFFE,
        0xFFFF,
        AbortCode.REQUESTED.status.value.to_bytes(4, "big"),
    )
    site.port.arrive(None, ethernet.frame(DEVICE_MAC, PLC_MAC, pdu, tag=0xA000))
    site.killed = True


def restart(site: Plant) -> None:
    site.plc.start(site.loop.now())


def readdress(site: Plant) -> None:
    """Change the address on the gateway's machine, because DCP rejects it."""
    site.port.address = IpSuite(IPv4Address("10.0.0.9"), IPv4Address("255.0.0.0"), IPv4Address(0))
    site.port.on_link()


WAYS = [
    kill,
    pull,
    fall_silent,
    stop,
    become_backup,
    ignore,
    mark_bad,
    release,
    abort,
    restart,
    parameterise_again,
    readdress,
]


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_the_drive_is_stopped_within_the_bound_and_stays_stopped(tmp_path: Path, way: Callable[[Plant], None]) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400) as site:
        model = drive_of(site.daemon).model
        site.connect()
        site.enable(1, SPEED)
        site.run(300 * MS)
        assert model.state is State.OPERATION_ENABLED
        assert abs(model.velocity_actual) > 100
        before = len(site.can)
        since = site.loop.now()
        way(site)
        site.until(lambda: model.state is not State.OPERATION_ENABLED, "a command to stop", BOUND_NS)
        assert site.loop.now() - since <= BOUND_NS
        site.until(lambda: model.state is State.SWITCH_ON_DISABLED and not model.velocity_actual, "standstill")
        assert len(site.can) > before
        # The controller is there again, with the ON it had: it needs an OFF first.
        site.killed = site.plc.silent = False
        site.port.link_up = True
        site.port.on_link()
        if site.plc.provider is not None:
            site.plc.provider.data_status = STATUS_NORMAL
        site.run(100 * MS)
        if not (site.link.connected and site.plc.phase is Phase.DATA):
            site.connect()
        site.set(1, ON, SPEED)
        site.run(1000 * MS)
        assert model.state is State.SWITCH_ON_DISABLED
        assert not model.velocity_actual
        site.enable(1, SPEED)
        site.run(200 * MS)
        assert abs(model.velocity_actual) > 100


def parameterise_at_once(site: Plant) -> None:
    parameterise_again(site)
    site.run(2 * MS)
    plc = site.plc
    block = PrmEndReq(ar_uuid=plc.ar_uuid, session_key=plc.session, command=ControlCommand.PRM_END)
    plc._send_call(Operation.CONTROL, block.encode(), lambda *_: None, site.loop.now())


@pytest.mark.parametrize("eighths", range(8))
def test_a_controller_that_is_back_before_the_next_step_of_the_axes_was_lost(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, eighths: int
) -> None:
    """With a slow cycle it connects and sends ON between two steps: the axes must see the loss all the same."""
    way = parameterise_at_once if eighths % 2 else restart
    cycle = 128
    config = configuration(axis(1), tmp_path / "store.json", transport=f"cycle_time_ms = {float(cycle)}")
    with plant(config, data_hold=3) as site:
        site.plc.project = replace(site.plc.project, reduction_ratio=cycle)
        site.connect()
        site.enable(1, SPEED)
        model = drive_of(site.daemon).model
        accepted = site.link.status()["frames"]
        while site.link.status()["frames"] == accepted:
            site.run(MS)
        site.run(cycle * MS * eighths // 8)
        way(site)
        for _ in range(4 * cycle):
            site.run(MS)
            if site.plc.provider is not None:
                site.set(1, ON, SPEED)
        assert site.link.connected
        assert site.plc.phase is Phase.DATA
        assert model.state is not State.OPERATION_ENABLED
        assert len([text for text in caplog.messages if "PLC lost" in text and "fault" not in text]) == 1


SILENCE = "no valid frame for 3 cycles"
LOSSES = {
    kill: SILENCE,
    fall_silent: SILENCE,
    pull: "the relationship has ended: the cable is off (CF 81 FD 1B)",
    release: "the relationship has ended: Release (CF 81 FD 0F)",
    abort: "the relationship has ended: the controller sent an alarm ERR (CF 81 FD 0D)",
    readdress: "the relationship has ended: name or address has changed (CF 81 FD 1F)",
}


@pytest.mark.parametrize(("way", "reason"), LOSSES.items(), ids=[way.__name__ for way in LOSSES])
def test_a_loss_of_the_plc_is_reported_once_with_its_cause(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, way: Callable[[Plant], None], reason: str
) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400) as site:
        site.connect()
        site.enable(1, SPEED)
        caplog.clear()
        way(site)
        site.run(BOUND_NS)
        errors = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
        lost = [text for text in errors if "PLC lost" in text]
        assert lost == [f"PLC lost: {reason}", f"axis 1: fault 103, code FF01h: PLC lost: {reason}"]
        assert site.link.watchdog_expiries == (reason is SILENCE)


class _SlowInputs(Project):
    """Input data has a cycle of 512 ms."""

    def iocr(self, kind: IocrType, layout: Layout) -> IocrBlockReq:
        block = super().iocr(kind, layout)
        return replace(block, reduction_ratio=512, data_hold=3) if kind is IocrType.INPUT else block


def test_silence_is_counted_in_cycles_of_the_output_data(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400) as site:
        model = drive_of(site.daemon).model
        site.plc.project = _SlowInputs("press-1", site.plc.project.modules, data_hold=400)
        site.connect()
        site.enable(1, SPEED)
        site.run(300 * MS)
        assert model.state is State.OPERATION_ENABLED
        site.killed = True
        site.until(lambda: model.state is not State.OPERATION_ENABLED, "a command to stop", BOUND_NS)


def test_the_data_hold_time_ends_the_relationship_long_after_the_drive_has_stopped(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400) as site:
        model = drive_of(site.daemon).model
        site.connect()
        site.enable(1, SPEED)
        site.plc.silent = True
        since = site.loop.now()
        site.until(lambda: model.state is not State.OPERATION_ENABLED, "a command to stop", BOUND_NS)
        site.until(lambda: not site.link.connected, "the end of the relationship")
        assert 1_600 * MS - CYCLE_NS <= site.loop.now() - since <= 1_600 * MS + CYCLE_NS
        site.until(lambda: site.plc.learned.error is not None, "word of it")
        assert site.plc.learned.error == AbortCode.DATA_HOLD.status.value


def test_name_and_address_cannot_be_changed_under_a_turning_drive(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json")) as site:
        model = drive_of(site.daemon).model
        site.connect()
        site.enable(1, SPEED)
        site.run(100 * MS)
        address = site.link.station.ip
        requests = [
            (dcp.Option.IP, bytes.fromhex("0001c0a80063ffffff0000000000")),
            (dcp.Option.NAME, b"\0\1other"),
            (dcp.Option.RESET, b"\0\4"),
        ]
        for option, value in requests:
            blocks = dcp.encode_block(option, value)
            payload = dcp.encode(dcp.FRAME_ID_GET_SET, dcp.Service.SET, dcp.ServiceType.REQUEST, 7, blocks)
            site.port.arrive(None, ethernet.frame(DEVICE_MAC, PLC_MAC, payload))
        site.run(300 * MS)
        assert site.link.device.dcp.refused == len(requests)
        assert (site.link.station.ip, site.link.station.name) == (address, "press-1")
        assert site.link.connected
        assert model.state is State.OPERATION_ENABLED


def test_a_loss_of_one_axis_data_stops_that_axis_alone(tmp_path: Path) -> None:
    with plant(configuration(axis(1) + axis(2), tmp_path / "store.json")) as site:
        site.connect()
        for slot in (1, 2):
            site.enable(slot, SPEED)
        site.run(100 * MS)
        mark_bad(site)
        models = [drive_of(site.daemon, node).model for node in (1, 2)]
        site.until(lambda: models[0].state is not State.OPERATION_ENABLED, "a command to stop", BOUND_NS)
        site.run(200 * MS)
        assert models[1].state is State.OPERATION_ENABLED
