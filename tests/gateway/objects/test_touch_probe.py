"""The drive's touch probe through the whole gateway, and tasks of telegram 9 with a drive of two RPDOs."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from pdgw.dsp402.drive.client import DriveStatus
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.model.modes import ProfilePosition
from pdgw.profidrive.sensor_states import SensorError
from pdgw.profidrive.signals import signal
from tests.support.gateways import site
from tests.support.gateways.daemon import SIMULATED_POSITIONER, axis, configuration, drive_of, operating

# -- G1 of the speed telegrams, passive homing of the positioner --------------------------------------------------


ON_THE_FLY, ACTIVATE, READ = 0x80, 0x10, 0x20
ZSW = signal("G1_ZSW")


@pytest.mark.parametrize("number", [3, 4, 102, 103])
def test_a_measurement_on_the_fly_has_the_position_at_the_edge(number: int) -> None:
    with operating(configuration(axis(1, telegram_number=number))) as (daemon, plc):
        drive = drive_of(daemon)
        plc.endpoint.set(0, {"NSOLL_B": 1 << 27, "G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & 0b01, "active")
        plc.until(lambda: drive.model.touch_probe_status & 1, "armed")
        plc.until(lambda: drive.model.position > 2000, "it turned")
        drive.set_probe(1, True)
        where = round(drive.model.position)
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("VALUE_1").mask, "value available")
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | READ | 0b01})
        plc.until(lambda: plc.value("G1_XIST2"), "read")
        assert plc.value("G1_XIST2") == where
        assert plc.value("G1_XIST1") > where, "it turned on"
        plc.endpoint.set(0, {"G1_STW": 0})
        plc.until(lambda: plc.value("G1_ZSW") == 0, "read and gone")


def test_the_falling_edge_of_probe_2_is_function_4() -> None:
    with operating(configuration(axis(1, telegram_number=102))) as (daemon, plc):
        drive = drive_of(daemon)
        drive.set_probe(2, True)
        plc.endpoint.set(0, {"NSOLL_B": 1 << 27, "G1_STW": ON_THE_FLY | ACTIVATE | 0b1000})
        plc.until(lambda: drive.model.touch_probe_function == 1 << 8 | 1 << 13, "armed")
        plc.until(lambda: drive.model.position > 500, "it turned")
        drive.set_probe(2, False)
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("VALUE_4").mask, "value available")


def test_a_reference_mark_search_finds_the_zero_pulse() -> None:
    with operating(configuration(axis(1, telegram_number=3))) as (_, plc):
        plc.endpoint.set(0, {"NSOLL_B": -(1 << 27), "G1_STW": ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("VALUE_1").mask, "mark found")
        plc.endpoint.set(0, {"G1_STW": READ | 0b01})
        plc.until(lambda: plc.value("G1_XIST2"), "read")
        assert -(1 << 32) + plc.value("G1_XIST2") == -4096


def test_a_drive_without_a_touch_probe_is_an_error_of_the_sensor() -> None:
    with operating(configuration(axis(1, telegram_number=3))) as (daemon, plc):
        node = drive_of(daemon).node
        for index in range(0x60B8, 0x60BE):
            node.entries.pop((index, 0))
            node.indices.discard(index)
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("ERROR").mask, "error")
        assert plc.value("G1_XIST2") == 0x0F01


def test_half_an_sdo_answer_about_the_touch_probe_is_an_error_of_the_sensor_and_no_end_of_the_gateway() -> None:
    with operating(configuration(axis(1, telegram_number=3))) as (daemon, plc):
        node = drive_of(daemon).node
        send = node.send
        node.send = lambda can_id, data: send(can_id, data[:4] if data[:4] == b"\x4b\xb9\x60\0" else data)
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("ERROR").mask, "error")
        assert plc.value("G1_XIST2") == SensorError.MEASUREMENT_ABORTED
        assert plc.state() == 0x07, "the axis goes on"


def test_passive_homing_takes_the_position_at_the_probe_while_a_task_runs() -> None:
    with operating(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as (daemon, plc):
        drive = drive_of(daemon)
        homing = {"POS_STW2": signal("POS_STW2").bit("PASSIVE_HOMING").mask, "OVERRIDE": 0x4000}
        plc.endpoint.set(0, homing | {"STW1": 0x0C3F, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000})
        plc.until(lambda: drive.model.touch_probe_function == 0x11, "armed")
        assert plc.value("POS_ZSW1") & signal("POS_ZSW1").bit("PASSIVE_HOMING").mask
        plc.endpoint.set(0, {"POS_STW1": 0x8100, "MDI_TARPOS": 40_000, "MDI_VELOCITY": 3000, "STW1": 0x0C7F})
        plc.until(lambda: drive.model.position > 2048, "under way")
        drive.set_probe(1, True)
        where = drive.model.position
        home = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
        plc.until(lambda: plc.value("ZSW1") & home, "homed")
        reached = signal("ZSW1").bit("TARGET_REACHED").mask
        plc.until(lambda: plc.value("ZSW1") & reached, "the task goes on to its end")
        expected = 40_000 - where * 10_000 / 4096
        assert abs(plc.value("XIST_A") - expected) <= 3, "the edge is the reference coordinate 0"
        assert drive.model.touch_probe_function == 0


def test_passive_homing_without_a_touch_probe_is_a_warning() -> None:
    with operating(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as (daemon, plc):
        node = drive_of(daemon).node
        node.entries.pop((0x60B8, 0))
        node.indices.discard(0x60B8)
        plc.endpoint.set(0, {"POS_STW2": signal("POS_STW2").bit("PASSIVE_HOMING").mask, "STW1": 0x0C3F})
        plc.until(lambda: plc.value("WARN_CODE") == FaultNumber.POSITIONER, "warning")


# -- accelerations by SDO: a task starts with its own data or not at all ------------------------------------------


NODE = 5
TASK_OFF, TASK_ON, TASK, NO_REJECT = 0x043E, 0x043F, 0x0040, 0x0010


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
        self.give(TASK_OFF)
        self.until(lambda: self.axis.actuals[0] & 0xF == 0x1, "ready for switching on")
        self.give(TASK_ON)
        self.until(lambda: self.axis.actuals[0] & 0xF == 0x7, "operation")

    @property
    def acknowledged(self) -> bool:
        return bool(self.axis.actuals[0] & 0x1000)


@pytest.fixture
def machine() -> Iterator[Machine]:
    with site.guarded_network() as network:
        drive = site.drive(NODE)
        drive.node.start_fault("two-pdos")
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
    machine.drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=10))
    for acceleration, expected in ((0x1000, 250), (0x0800, 125)):
        machine.give(TASK_ON)
        machine.until(lambda: not machine.acknowledged, "last task taken back")
        machine.give(TASK_ON | TASK, MDI_TARPOS=acceleration << 12, MDI_ACC=acceleration, MDI_DEC=acceleration)
        machine.until(lambda: machine.acknowledged, "task taken")
        assert machine.drive.model.profile_acceleration == expected
        motion = machine.drive.model.motion
        assert isinstance(motion, ProfilePosition)
        assert motion.setpoint is None or motion.setpoint.acceleration == 10 * expected
    assert not machine.axis.faults


def test_a_task_whose_data_is_not_accepted_is_reported_and_can_be_repeated(machine: Machine) -> None:
    machine.drive.do(lambda node: node.start_fault("sdo-timeout"))
    machine.give(TASK_ON | TASK, MDI_TARPOS=0x1000_0000, MDI_ACC=0x1000, MDI_DEC=0x1000)
    machine.until(lambda: machine.axis.reason is Reason.SET_POINT_REFUSED, "refused")
    assert [fault.number for fault in machine.axis.faults] == [119]
    machine.drive.do(lambda node: node.end_fault())
    machine.until(lambda: machine.drive.model.profile_acceleration == 250, "taken later")
    machine.give(TASK_ON | TASK)
    assert machine.drive.model.position == 0
    machine.give(TASK_ON & ~NO_REJECT)
    machine.give(TASK_ON)
    machine.until(lambda: machine.axis.reason is None, "the task is dropped")
    machine.give(TASK_ON | TASK)
    machine.until(lambda: machine.drive.model.position > 0, "the same task, given again")
