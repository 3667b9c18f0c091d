"""Sentences that stand: each is true an hour later, and after a restart of the gateway."""

from __future__ import annotations

import pytest

from pdgw.base.durations import SECOND
from pdgw.gateway.daemon.daemon import Daemon
from tests.support.documents.night_situations import NIGHT_SITUATIONS
from tests.support.documents.situations import SLOW_PLC, at_situation, run_out
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running
from tests.support.gateways.restart import KILLED, restarted

_STARTED_NS = 5 * SECOND
"""By then the next gateway knows each device, or has missed it."""


@pytest.mark.parametrize("kept", ["", "CAN bus lost, since 04:11:02"])
def test_heartbeat_error_of_before_the_start_is_explained_unless_its_cause_was_kept(kept: str) -> None:
    def before(daemon: Daemon) -> None:
        drive_of(daemon).inject("CANopen")
        daemon.recall(KILLED, {"1": kept})

    with running(configuration(axis(1), transport=SLOW_PLC), before) as daemon:
        Plc(daemon, [1]).until(lambda: daemon.axes[0].faults, "the fault")
        cause = f"; before: {kept}" if kept else ": the gateway sent no heartbeat before its start"
        assert daemon.axes[0].enable_status.text == f"Fault: CANopen (older than the connection){cause}"


def test_device_whose_frames_arrive_has_power_and_cable_although_it_does_not_answer() -> None:
    """After a restart beside an adapter that sends nothing: the device still has the heartbeat time of the last gateway."""
    situation = NIGHT_SITUATIONS["the CAN adapter takes frames and sends none when ON comes"]
    with at_situation(situation) as (daemon, plc), restarted(plc, daemon) as following:
        run_out(plc, _STARTED_NS)
        text = following.axes[0].enable_status.text
        assert (
            "node 1 on bus can: its frames arrive, and it answers no SDO request: the interface may send nothing"
            in text
        )
        assert "Check power" not in following.axes[0].enable_status.sentence
