"""An independent master, festo-edcon, with its whole API against telegrams 1, 9, 102 and 111, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from pdgw.gateway.daemon.daemon import Daemon
from tests.support.gateways.daemon import axis, configuration, drive_of, running, until
from tests.support.gateways.edcon_master import edcon_master

POSITIONER = """simulate = true
intermediate_stop_reached = true
[axis.positioner]
lu_per_revolution = 10000
max_velocity = 30000
max_acceleration = 2000
max_deceleration = 2000
position_window = 20
jog_velocities = [-600, 600]
jog_distances = [2500, 5000]
homing_method = 35
[[axis.block]]
number = 3
position = 30000
velocity = 12000
"""
PLAIN = "simulate = true\nintermediate_stop_reached = true"


@contextmanager
def master(number: int) -> Iterator[tuple[Any, Daemon]]:
    more = POSITIONER if number == 111 else PLAIN
    with running(configuration(axis(1, telegram_number=number, more=more))) as daemon:
        until(daemon, lambda: all(node.generation for node in daemon.clients), "nodes online")
        with edcon_master(daemon, number) as handler:
            assert handler.acknowledge_faults()
            assert handler.enable_powerstage()
            yield handler, daemon
            assert handler.disable_powerstage()


def faulted(handler: Any, daemon: Daemon) -> None:
    """A fault of the drive ends what runs; acknowledged, the axis is enabled again."""
    drive_of(daemon).inject(7)
    assert handler.wait_until_or_fault(lambda: False) is False
    assert handler.fault_present()
    assert not handler.ready_for_motion()
    drive_of(daemon).do(lambda node: node.model.clear())
    assert handler.acknowledge_faults()
    assert handler.enable_powerstage()


@pytest.mark.parametrize("number", [1, 102])
def test_edcon_turns_stops_and_recovers_from_a_fault(number: int) -> None:
    full = 0x4000 if number == 1 else 0x4000_0000
    with master(number) as (handler, daemon):
        assert handler.velocity_task(full // 4, duration=1.0)
        assert handler.velocity_task(-full // 4)
        drive = drive_of(daemon).node.model
        handler.wait_until_or_fault(lambda: drive.velocity_actual == -1500, timeout=2.0)
        assert drive.velocity_actual == -1500
        handler.stop_motion_task()
        assert handler.wait_until_or_fault(lambda: drive.velocity_actual == 0, timeout=2.0)
        faulted(handler, daemon)
        assert handler.velocity_task(full // 8, duration=0.5)


@pytest.mark.parametrize("number", [9, 111])
def test_edcon_homes_moves_pauses_and_stops(number: int) -> None:
    with master(number) as (handler, daemon):
        speed = 12_000 if number == 111 else 0x1000_0000
        far = 100_000 if number == 111 else 0x1000_0000
        if number == 9:
            handler.telegram.mdi_acc.value = handler.telegram.mdi_dec.value = 0x4000
            for bit in (0, 1, 5):  # homing method 35
                setattr(handler.telegram.satzanw, f"satzanw_bit{bit}", True)
        assert handler.referencing_task()
        assert handler.referenced()
        assert handler.position_task(far, speed, absolute=True)
        assert handler.target_position_reached()
        assert handler.position_task(-far // 2, speed, absolute=False)
        assert handler.position_task(far, speed // 4, absolute=True, nonblocking=True)
        assert handler.wait_for_traversing_task_ack()
        handler.pause_motion_task()
        assert handler.stopped()
        handler.resume_motion_task()
        assert handler.wait_until_or_fault(lambda: not handler.stopped(), timeout=1.0)
        assert handler.wait_for_target_position()
        assert handler.position_task(0, speed // 4, absolute=True, nonblocking=True)
        handler.stop_motion_task()
        assert handler.stopped()
        faulted(handler, daemon)
        assert handler.position_task(0, speed, absolute=True)


def test_edcon_jogs_runs_records_and_reads_the_fault_of_telegram_111() -> None:
    with master(111) as (handler, daemon):
        assert handler.set_current_position_task()
        assert handler.current_position() == 0
        assert handler.jog_task(jog_positive=False, jog_negative=True, duration=0.5)
        assert handler.current_position() > 0
        assert handler.jog_task(jog_positive=True, jog_negative=False, incremental=True, duration=1.0)
        assert handler.record_task(3, nonblocking=False)
        assert handler.current_position() == pytest.approx(30_000, abs=20)
        assert handler.velocity_task(-6000, duration=0.5)
        assert handler.current_position() < 30_000
        handler.configure_software_limit_switch(active=True)
        handler.configure_hardware_limit_switch(active=True)
        handler.configure_continuous_update(active=True)
        assert handler.position_task(10_000, 6000, absolute=True, nonblocking=True)
        assert handler.position_task(20_000, 6000, absolute=True, nonblocking=True)
        assert handler.wait_until_or_fault(lambda: abs(handler.current_position() - 20_000) <= 20, timeout=5.0)
        handler.configure_continuous_update(active=False)
        handler.stop_motion_task()
        assert handler.current_fault_code() == 0
        drive_of(daemon).inject(7)
        assert not handler.wait_until_or_fault(lambda: False)
        assert "(7)" in handler.fault_string()
        drive_of(daemon).do(lambda node: node.model.clear())
        assert handler.acknowledge_faults()
        assert handler.enable_powerstage()
