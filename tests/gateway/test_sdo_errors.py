"""A failed SDO is reported with node, object and meaning of the abort code."""

from __future__ import annotations

import pytest

from pdgw.ds301.aborts import Abort
from pdgw.ds301.communication import NMT, SDO_REQUEST, SDO_RESPONSE, NmtCommand
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.objects import Entry
from pdgw.ds301.sdo_transfer import SdoAbortedError
from pdgw.dsp402.objects import CONTROLWORD
from pdgw.durations import MS, SECOND
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.reasons import FaultNumber
from pdgw.peers.node.node import Value
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running, until, world_of


def _failure(daemon: Daemon, index: int, subindex: int = 0, data: bytes = b"") -> str:
    def access(node: NodeClient) -> None:  # type: ignore[type-arg]
        if data:
            node.sdo.write(index, subindex, data)
        else:
            node.sdo.read(index, subindex)

    future = daemon.axes[0].drive.submit(access)
    until(daemon, future.done, "an end of the access")
    return str(future.exception())


@pytest.mark.parametrize(
    ("index", "subindex", "data", "text"),
    [
        (0x5FFF, 0, b"", "node 1 object 5FFFh/0: 0602 0000h: object does not exist"),
        (0x6094, 9, b"", "node 1 object 6094h/9: 0609 0011h: sub-index does not exist"),
        (0x6041, 0, b"\0\0", "node 1 object 6041h/0: 0601 0002h: attempt to write a read-only object"),
    ],
)
def test_abort_names_node_object_and_text(index: int, subindex: int, data: bytes, text: str) -> None:
    with running(configuration(axis(1))) as daemon:
        until(daemon, lambda: daemon.axes[0].drive.generation, "online")
        assert _failure(daemon, index, subindex, data) == text


def test_missing_answer_names_node_and_object() -> None:
    with running(configuration(axis(1))) as daemon:
        until(daemon, lambda: daemon.axes[0].drive.generation, "online")
        drive_of(daemon).do(lambda node: node.misbehave("slow-sdo", delay_ms=5000))
        assert _failure(daemon, 0x6080) == "node 1 object 6080h/0: No SDO response received"


def test_refused_configuration_names_node_object_and_text() -> None:
    with running(configuration(axis(1))) as daemon:
        drive_of(daemon).do(lambda node: node.entries.pop((0x6060, 0)))
        until(daemon, lambda: daemon.axes[0].drive.status.value == "refused", "refused")
        told = daemon.axes[0].drive.status_text
        assert told.startswith("node 1 mode of operation (6060h/0 := 3h): '0609 0011h: sub-index does not exist'")


def test_fault_without_emcy_is_reported_although_its_number_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(configuration(axis(1))) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        plc, drive = Plc(daemon, [1]), drive_of(daemon)
        plc.enable()
        monkeypatch.setattr(drive.node, "send_emcy", lambda *_: None)
        drive.do(lambda node: node.misbehave("sdo-timeout"))
        drive.do(lambda node: node.misbehave("drive-fault", number=10))
        plc.until(lambda: plc.value("ZSW1") & 1 << 3, "fault in ZSW1")
        plc.until(lambda: daemon.axes[0].faults, "fault in P947")
        assert "shows a fault without an EMCY" in daemon.axes[0].faults[0].text


def test_drive_that_answers_late_is_lost_once() -> None:
    """That its SDO time-out grows is a line of the log, no other loss."""
    with running(configuration(axis(1))) as daemon:
        made = daemon.axes[0]
        until(daemon, lambda: made.drive.generation, "online")
        drive_of(daemon).do(lambda node: node.misbehave("slow-sdo", delay_ms=700))
        world_of(daemon).bus("world").join("another tool").send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        until(daemon, lambda: made.drive.generation > 1, "online again", 300 * SECOND)
        assert [fault.number for fault in made.faults].count(FaultNumber.NODE_LOST) == 1


def test_quick_stop_that_is_rejected_by_sdo_names_its_object(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "gateway")

    def refuse(entry: Entry, _value: Value) -> None:
        if entry.address == CONTROLWORD:
            raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)

    with running(configuration(axis(1))) as daemon:
        Plc(daemon, [1]).enable()
        drive_of(daemon).do(lambda node: node.misbehave("turns-in-pre-operational"))
        drive_of(daemon).do(lambda node: setattr(node, "on_written", refuse))
        world_of(daemon).bus("world").join("another tool").send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        until(daemon, lambda: "rejects Quick Stop by SDO" in caplog.text, "a rejection")
        assert "rejects Quick Stop by SDO: node 1 object 6040h/0: 0800 0022h" in caplog.text


def test_answers_to_another_tool_do_not_lengthen_the_sdo_timeout(caplog: pytest.LogCaptureFixture) -> None:
    """The drive answers the tool, and does not answer the gateway for a while."""
    caplog.set_level("INFO", "gateway")
    with running(configuration(axis(1))) as daemon:
        made, node = daemon.axes[0], drive_of(daemon).node
        until(daemon, lambda: made.drive.generation, "online")
        other = world_of(daemon).bus("world").join("another tool")
        send = node.send

        def only_to_the_tool(can_id: int, data: bytes) -> None:
            if can_id != SDO_RESPONSE + 1 or data[1:3] == b"\x00\x20":
                send(can_id, data)

        node.send = only_to_the_tool
        other.send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        for _ in range(300):
            other.send(SDO_REQUEST + 1, b"\x40\x00\x20\x00\0\0\0\0")
            world_of(daemon).loop.run_for(10 * MS)
        node.send = send
        until(daemon, lambda: made.drive.generation > 1, "online again")
        assert "answers SDO late" not in caplog.text
