"""Two masters on one bus: the second refuses, the first stops its drives and says why."""

from __future__ import annotations

import threading

import can
import pytest
from pdgw.ds301.connection_set import ERROR_CONTROL
from pdgw.dsp402.states import State
from pdgw.gateway.config import GATEWAY_NODE_ID
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.peers.drive import SimulatedDrive

from tests.support import buses
from tests.support.daemon import Plc, axis, configuration

HEARTBEAT = ERROR_CONTROL + GATEWAY_NODE_ID


def frame(can_id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def on(channel: str) -> str:
    return f'[can]\ninterface = "virtual"\nchannel = "{channel}"\n'


@pytest.mark.parametrize(
    ("can_id", "data", "what"),
    [(HEARTBEAT, b"\x05", "heartbeat of node 127"), (0x201, bytes(6), "RPDO1 of drive 1")],
)
def test_a_bus_with_another_master_is_left_alone(can_id: int, data: bytes, what: str) -> None:
    channel = buses.channel()
    sent: list[int] = []
    with buses.bus(channel) as other:
        daemon = Daemon(configuration(axis(1, more=""), can=on(channel)))
        daemon.networks["can"].listeners.append(lambda m: None if m.is_rx else sent.append(m.arbitration_id))
        daemon.loop.call_later(0, lambda: other.send(frame(can_id, data)))
        with pytest.raises(GatewayError, match=what):
            daemon.run()
    assert sent == [], "not one frame"
    assert [fault.number for fault in daemon.axes[0].faults] == [123]


def test_a_master_that_comes_later_ends_the_gateway_after_its_drives_are_stopped() -> None:
    channel = buses.channel()
    failures: list[str] = []
    with SimulatedDrive(buses.bus(channel), 1) as drive, buses.bus(channel) as other:
        daemon = Daemon(configuration(axis(1, more=""), can=on(channel)))

        def run() -> None:
            try:
                daemon.run()
            except GatewayError as error:
                failures.append(str(error))

        thread = threading.Thread(target=run)
        thread.start()
        plc = Plc(daemon, [1])
        plc.enable()
        other.send(frame(HEARTBEAT, b"\x05"))
        thread.join(20)
        assert drive.model.state in {State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON}
    assert len(failures) == 1
    assert "another master sends the heartbeat of node 127" in failures[0]
