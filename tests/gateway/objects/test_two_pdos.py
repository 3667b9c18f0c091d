"""Telegram 9 with a drive of two RPDOs, whose accelerations go by SDO: a task starts with its own data or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from pdgw.dsp402.drive.client import DriveStatus
from pdgw.gateway.configuration.config import AxisConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.reasons import Reason
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.model.position_modes import ProfilePosition
from tests.support.gateways import site

NODE = 5
OFF, ON, TASK, NO_REJECT = 0x043E, 0x043F, 0x0040, 0x0010


class Machine:
    """An axis, its drive, and a PLC whose setpoints are ``values``."""

    def __init__(self, axis: Axis, drive: SimulatedDrive) -> None:
        self.axis = axis
        self.drive = drive
        names = axis.telegram.setpoints.names
        self.values = dict.fromkeys(names, 0) | {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_VELOCITY": 0x2000_0000}

    def until(self, condition: Callable[[], object], what: str) -> None:
        def cycle() -> object:
            self.axis.step(self.axis.telegram.setpoints.from_dict(self.values), site.now())
            self.axis.transmit(site.now())
            return condition()

        site.wait_for(cycle, what)

    def give(self, word: int, **values: int) -> None:
        """Setpoints, for one cycle."""
        self.values |= values | {"STW1": word}
        self.until(lambda: True, "one cycle")

    def enable(self) -> None:
        self.give(OFF)
        self.until(lambda: self.axis.actuals[0] & 0xF == 0x1, "ready for switching on")
        self.give(ON)
        self.until(lambda: self.axis.actuals[0] & 0xF == 0x7, "operation")

    @property
    def acknowledged(self) -> bool:
        return bool(self.axis.actuals[0] & 0x1000)


@pytest.fixture
def machine() -> Iterator[Machine]:
    with site.guarded_network() as network:
        drive = site.drive(NODE)
        drive.node.misbehave("two-pdos")
        drive.start()
        axis = Axis(AxisConfig(do_id=1, node_id=NODE, telegram=9, sdo_timeout_ms=100), network, 4)
        axis.drive.start()
        machine = Machine(axis, drive)
        machine.until(lambda: axis.drive.status is DriveStatus.ONLINE and axis.good, "online")
        machine.enable()
        yield machine
        axis.drive.stop()
        drive.stop()


def test_a_task_starts_with_its_own_accelerations(machine: Machine) -> None:
    machine.drive.do(lambda node: node.misbehave("slow-sdo", delay_ms=10))
    for acceleration, expected in ((0x1000, 250), (0x0800, 125)):
        machine.give(ON)
        machine.until(lambda: not machine.acknowledged, "last task taken back")
        machine.give(ON | TASK, MDI_TARPOS=acceleration << 12, MDI_ACC=acceleration, MDI_DEC=acceleration)
        machine.until(lambda: machine.acknowledged, "task taken")
        assert machine.drive.model.profile_acceleration == expected
        motion = machine.drive.model.motion
        assert isinstance(motion, ProfilePosition)
        assert motion.setpoint is None or motion.setpoint.acceleration == 10 * expected
    assert not machine.axis.faults


def test_a_task_whose_data_is_not_taken_does_not_start_is_told_and_can_be_given_again(machine: Machine) -> None:
    machine.drive.do(lambda node: node.misbehave("sdo-timeout"))
    machine.give(ON | TASK, MDI_TARPOS=0x1000_0000, MDI_ACC=0x1000, MDI_DEC=0x1000)
    machine.until(lambda: machine.axis.reason is Reason.SET_POINT_REFUSED, "refused")
    assert [fault.number for fault in machine.axis.faults] == [119]
    machine.drive.do(lambda node: node.behave())
    machine.until(lambda: machine.drive.model.profile_acceleration == 250, "taken later")
    machine.give(ON | TASK)
    assert machine.drive.model.position == 0
    machine.give(ON & ~NO_REJECT)
    machine.give(ON)
    machine.until(lambda: machine.axis.reason is None, "the task is dropped")
    machine.give(ON | TASK)
    machine.until(lambda: machine.drive.model.position > 0, "the same task, given again")
