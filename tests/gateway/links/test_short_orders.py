"""STW1.6 low for one or two frames soon after a task: the next task runs, or the PLC gets no "reached" for it."""

from __future__ import annotations

from ipaddress import IPv4Address

import pytest

from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.reasons import Reason, UnconfirmedOrder
from pdgw.gateway.service.status import snapshot
from pdgw.profidrive.signals import signal
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, running

GATEWAY, PLC = "192.168.0.5", "192.168.0.10"
ROUTED = {"listen": IPv4Address(GATEWAY), "peer": IPv4Address(PLC)}
NETWORKS = {"loopback": {}, "direct": ROUTED | {"direct": True}, "counting": ROUTED, "routed": ROUTED}
VALUES = {
    9: {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_VELOCITY": 1 << 30},
    110: {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_VELOCITY": 300_000, "OVERRIDE": 0x4000},
    111: {"POS_STW1": 0x8100, "MDI_VELOCITY": 300_000, "OVERRIDE": 0x4000},
}
TARGETS = {9: (0x0100_0000, -0x0080_0000), 110: (200_000, -50_000), 111: (200_000, -50_000)}
LOW, HIGH = 0x043F, 0x047F
TRAVEL = 600
"""Cycles in which every target is reached."""
REACHED, ACKNOWLEDGED = 0x0400, 0x1000
SECOND, SETPOINT_REACHED = {9: "ZSW1", 110: "POS_ZSW", 111: "POS_ZSW2"}, 0x0008
"""A second word with it; bit 3 of ZSW1 is the fault that is not there."""


class Tasks(Plc):
    """A PLC with tasks of one axis."""

    def begin(self, number: int) -> None:
        self.number = number
        self.endpoint.set(0, VALUES[number] | {"MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "STW1": OFF & ~0x40})
        self.until(lambda: self.state() == 0x01, "ready")
        self.endpoint.set(0, {"STW1": LOW})
        self.until(lambda: self.state() == 0x07, "operation")

    def run(self, cycles: int, **values: int) -> None:
        self.endpoint.set(0, values)
        for _ in range(cycles):
            self.exchange()

    def at(self, place: int) -> bool:
        return abs(self.value("XIST_A") - TARGETS[self.number][place]) < (5000 if self.number == 9 else 50)


@pytest.mark.parametrize("number", TARGETS)
@pytest.mark.parametrize("network", NETWORKS)
def test_a_short_low_of_stw1_6_starts_the_next_task_or_is_shown_as_dropped(network: str, number: int) -> None:
    config = simulated([number])
    transport = config.transport.model_copy(update=NETWORKS[network])
    first, second = TARGETS[number]
    with running(config.model_copy(update={"transport": transport})) as daemon:
        plc = Tasks(daemon, [number], PLC)
        if network == "counting":
            plc.endpoint.count(0, "STW2", signal("STW2").bit("SIGN_OF_LIFE"))
        plc.begin(number)
        # A sign of life that counts has to be seen for longer than the oldest frame.
        settling = 1500 if network == "counting" else 20
        for width, wait in ((1, 10), (2, 500)):
            plc.run(settling, STW1=LOW, MDI_TARPOS=first)
            plc.run(wait, STW1=HIGH)
            plc.run(width, STW1=LOW)
            for _ in range(TRAVEL):
                plc.run(1, STW1=HIGH, MDI_TARPOS=second)
                reached = plc.value("ZSW1") & REACHED or plc.value(SECOND[number]) & SETPOINT_REACHED
                assert plc.at(1) or not reached, "reached is shown for the second task only"
            assert plc.at(1) == (network != "routed")
        if network == "routed":
            assert not plc.value("ZSW1") & (REACHED | ACKNOWLEDGED)
            assert daemon.axes[0].reason is Reason.ORDER_DROPPED
            plc.run(3, STW1=LOW)
            plc.run(TRAVEL, STW1=HIGH)
            assert plc.at(1), "held for three frames it is obeyed"
            assert daemon.axes[0].reason is None
            assert plc.value("ZSW1") & (REACHED | ACKNOWLEDGED) == REACHED | ACKNOWLEDGED
        counters = snapshot(daemon)["counters"]
        assert isinstance(counters, list)
        (dropped,) = (item["value"] for item in counters if item["name"] == "orders_dropped")
        assert dropped == (2 if network == "routed" else 0)


@pytest.mark.parametrize(
    ("transport", "delays"),
    [
        ("", False),
        (f'listen = "{GATEWAY}"\npeer = "{PLC}"', True),
        (f'listen = "{GATEWAY}"\npeer = "{PLC}"\ndirect = true', False),
    ],
)
def test_only_beyond_loopback_frames_may_be_late_unless_direct(transport: str, delays: bool) -> None:
    assert configuration(axis(1), transport=transport).transport.delays is delays


def test_direct_is_refused_with_profinet() -> None:
    with pytest.raises(GatewayError, match='direct: allowed only with type = "udp"'):
        configuration(axis(1), transport='type = "profinet"\ninterface = "eth1"\ndirect = true')


def test_an_encoder_whose_control_word_was_dropped_says_so() -> None:
    axes = "[[encoder]]\ndo_id = 1\nnode_id = 1\ntelegram = 81\nsimulate = true\n"
    with running(configuration(axes, transport=f'listen = "{GATEWAY}"\npeer = "{PLC}"')) as daemon:
        plc = Plc(daemon, [81], PLC)
        plc.endpoint.set(0, {"STW2_ENC": 0x0400})
        plc.until(lambda: daemon.encoders[0].good and daemon.encoders[0].reason is None, "online")
        for word in (0x8000, 0):
            plc.endpoint.set(0, {"G1_STW": word})
            plc.exchange()
            plc.exchange()
        assert daemon.encoders[0].unconfirmed is UnconfirmedOrder.DROPPED
        assert daemon.encoders[0].reason is Reason.ORDER_DROPPED
