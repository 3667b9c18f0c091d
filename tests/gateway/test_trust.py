"""A node that is not trusted any more: the cyclic side learns it at once, whatever the node's task waits for."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Final

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import SdoCommunicationError
from pdgw.ds301.communication import NMT, NmtCommand
from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.drive.client import DriveClient
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.daemon.daemon import Daemon
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, operating, world_of

TIMEOUT_MS: Final = 5000
SLOW = f"simulate = true\nsdo_timeout_ms = {TIMEOUT_MS}\n"
CHECK_MS: Final = 20
"""Interval of the supervision beside the task."""
FAULT: Final = 1 << 3


def _restart(daemon: Daemon) -> None:
    drive_of(daemon).do(lambda node: node.start(node.now))


def _fault(name: str, **values: int) -> Callable[[Daemon], None]:
    return lambda daemon: drive_of(daemon).do(lambda node: node.start_fault(name, **values))


def _send(can_id: int, data: bytes) -> Callable[[Daemon], None]:
    return lambda daemon: world_of(daemon).bus("world").join("another tool").send(can_id, data)


def _cut(daemon: Daemon) -> None:
    world_of(daemon).unplug("world")


def _wrong_mode(daemon: Daemon) -> None:
    daemon.axes[0].drive.operation.lost = "6061h shows 1"


def _doubles(daemon: Daemon) -> None:
    client = daemon.axes[0].drive
    for _ in range(3):
        client.sdo.doubles.requested(b"\x40\x00\x10\0")
        for _ in range(2):
            client.sdo.doubles.answered(b"\x43\x00\x10\0" + bytes(4))


def _unanswered(daemon: Daemon, plc: Plc) -> Future[bytes]:
    """A job that reads an object and gets no answer."""
    drive_of(daemon).do(lambda node: node.start_fault("sdo-timeout"))
    answer = daemon.axes[0].drive.submit(lambda node: node.sdo.read(0x6065))
    plc.exchange(3)
    assert not answer.done()
    return answer


Cause = tuple[Callable[[Daemon], None], int, str]
CAUSES: dict[str, Cause] = {
    "boot-up": (_restart, 0, "node 1 restarted"),
    "NMT": (
        _send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1))),
        100,
        "Pre-operational: another master has sent NMT command 80h",
    ),
    "no heartbeat": (_fault("heartbeat-stops"), 300, "no heartbeat for 300 ms"),
    "no TPDO": (_fault("lost-pdos", every=1), 200, "no TPDO"),
    "bus": (_cut, 0, "bus can: its interface is lost"),
    "mode": (_wrong_mode, 0, "6061h shows 1"),
    "two devices": (_doubles, 0, "SDO requests are answered twice"),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_a_loss_during_an_unanswered_sdo_read_stops_the_axis_at_once(cause: str) -> None:
    lose, within_ms, text = CAUSES[cause]
    with operating(configuration(axis(1, more=SLOW))) as (daemon, plc):
        client, loop = daemon.axes[0].drive, world_of(daemon).loop
        answer = _unanswered(daemon, plc)
        begin = loop.now()
        lose(daemon)
        plc.until(lambda: plc.value("ZSW1") & FAULT, "fault in ZSW1")
        assert loop.now() - begin <= (within_ms + CHECK_MS) * MS + 3 * daemon.cycle_ns
        plc.until(lambda: client.status is NodeStatus.LOST, "lost")
        assert text in client.status_text
        plc.until(answer.done, "the end of the read")
        assert isinstance(answer.exception(), SdoCommunicationError)
        assert loop.now() - begin < TIMEOUT_MS * MS // 2, "not that of the timeout"


def test_a_drive_that_restarts_during_an_unanswered_read_is_configured_at_once() -> None:
    """Neither the read nor a question of the gateway may delay it until the time for an answer is over."""
    with operating(configuration(axis(1, telegram_number=9, more=SLOW))) as (daemon, plc):
        client, loop = daemon.axes[0].drive, world_of(daemon).loop
        answer = _unanswered(daemon, plc)
        begin = loop.now()
        drive_of(daemon).do(lambda node: node.end_fault())
        _restart(daemon)
        plc.until(lambda: client.generation == 2, "online again")
        assert loop.now() - begin < TIMEOUT_MS * MS // 2
        assert answer.done()
        assert {fault.number for fault in daemon.axes[0].faults} == {FaultNumber.NODE_RESTARTED, FaultNumber.NODE_LOST}


def _silent_while_held(daemon: Daemon, plc: Plc, *, restart: bool) -> None:
    """A job holds the node, as a write of 1010h does, and the drive sends nothing for half a second."""
    client, drive = daemon.axes[0].drive, drive_of(daemon)

    def store(node: DriveClient) -> None:
        node.hold("a client writes 1010h/1")
        node.loop.sleep(600 * MS)
        node.unhold(check=False)

    job = client.submit(store)
    for fault in ("heartbeat-stops", "lost-pdos"):
        drive.do(lambda node, fault=fault: node.start_fault(fault))
    plc.exchange(500 * MS // daemon.cycle_ns)
    assert client.status is NodeStatus.ONLINE
    assert not daemon.axes[0].good
    drive.do(lambda node: node.end_fault())
    if restart:
        _restart(daemon)
    plc.until(job.done, "the end of the job")
    plc.exchange(2)


def test_a_drive_that_is_silent_while_a_job_holds_it_is_not_lost() -> None:
    with operating() as (daemon, plc):
        _silent_while_held(daemon, plc, restart=False)
        assert daemon.axes[0].good
        assert (daemon.axes[0].drive.generation, list(daemon.axes[0].faults)) == (1, [])


def test_a_drive_that_restarts_while_a_job_holds_it_is_lost_with_its_end() -> None:
    with operating() as (daemon, plc):
        _silent_while_held(daemon, plc, restart=True)
        assert daemon.axes[0].drive.status is not NodeStatus.ONLINE
        assert FaultNumber.NODE_RESTARTED in {fault.number for fault in daemon.axes[0].faults}
