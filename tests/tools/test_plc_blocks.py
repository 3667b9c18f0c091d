"""The generated function blocks, run against the gateway in virtual time: the shaft of the drive is the oracle."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pdgw.base.durations import SECOND
from pdgw.dsp402.states import State
from pdgw.gateway.base.reasons import Reason
from pdgw.peers.drive import SimulatedDrive
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode
from tests.support.gateways.daemon import drive_of, encoder_of, running
from tests.support.plc.structured_text import TextPlc, config_of, program

SPEEDS = [1, 20, 105]
"""A speed of 16 bits, also with currents, and one of 32 bits with every further word. test_plc_motion.py has all telegrams."""
ENCODERS = [number for number, item in TELEGRAMS.items() if item.mode is ApplicationMode.ENCODER]


@contextmanager
def axis_with(number: int) -> Iterator[tuple[TextPlc, SimulatedDrive]]:
    config = config_of(number)
    with running(config) as daemon:
        yield TextPlc(daemon, program(config)), drive_of(daemon)


def rpm(drive: SimulatedDrive) -> float:
    """The speed of the shaft."""
    return drive.node.model.velocity_actual * drive.node.model.unit


@pytest.mark.parametrize("number", SPEEDS)
def test_speed_block_turns_reverses_stops_and_acknowledges(number: int) -> None:
    with axis_with(number) as (plc, drive):
        plc.set(ReferenceSpeed=3000.0)
        plc.enable()
        plc.set(Speed=600.0)
        plc.until(lambda block: block["INSPEED"] and block["ACTSPEED"] > 590, "600 rpm")
        assert rpm(drive) == pytest.approx(600, abs=1)
        plc.set(Reverse=True)
        plc.until(lambda block: block["INSPEED"] and block["ACTSPEED"] < -590, "the other direction")
        assert rpm(drive) == pytest.approx(-600, abs=1)
        drive.node.model.inject(5)
        plc.until(lambda block: block["ERROR"], "fault")
        assert plc.block["REASON"] == Reason.DRIVE_FAULT.code
        plc.exchange(100)  # the drive takes no reset before it has reacted to its fault
        drive.node.model.clear()
        plc.set(AckError=True)
        plc.until(lambda block: not block["ERROR"], "acknowledged")
        plc.set(AckError=False)
        plc.exchange(100)
        assert (drive.node.model.state is State.OPERATION_ENABLED, rpm(drive)) == (False, 0), (
            "Enable stood all the time"
        )
        assert plc.block["REASON"] == Reason.NEEDS_OFF.code
        plc.set(Enable=False, Reverse=False)
        plc.enable()
        plc.until(lambda block: block["INSPEED"] and block["ACTSPEED"] > 590, "600 rpm again")
        plc.set(Enable=False)
        plc.until(lambda _: rpm(drive) == 0, "standstill")
        assert not plc.block["ENABLED"]


def test_a_block_without_its_reference_does_not_switch_on() -> None:
    with axis_with(1) as (plc, drive):
        plc.set(Enable=False)
        plc.exchange(500)
        plc.set(Enable=True)
        plc.exchange(500)
        assert drive.node.model.state is not State.OPERATION_ENABLED
        assert plc.block["REASON"] == Reason.REFERENCE_INVALID.code


def test_enable_set_at_the_start_does_not_switch_on() -> None:
    with axis_with(1) as (plc, drive):
        plc.set(ReferenceSpeed=3000.0, Enable=True)
        plc.exchange(1000)
        assert drive.node.model.state is not State.OPERATION_ENABLED
        assert plc.block["REASON"] == Reason.NEEDS_OFF.code


def test_speed_block_after_a_quick_stop_needs_enable_again() -> None:
    with axis_with(1) as (plc, drive):
        plc.set(ReferenceSpeed=3000.0)
        plc.enable()
        plc.set(Speed=600.0)
        plc.until(lambda block: block["INSPEED"] and block["ACTSPEED"] > 590, "600 rpm")
        plc.set(QuickStop=True)
        plc.until(lambda block: not block["ENABLED"], "quick stop")
        plc.set(QuickStop=False)
        plc.exchange(500)
        assert (rpm(drive), plc.block["REASON"]) == (0, Reason.NEEDS_OFF.code)
        plc.set(Enable=False)
        plc.enable()


def test_block_of_a_lost_gateway_needs_enable_again() -> None:
    with axis_with(1) as (plc, drive):
        plc.set(ReferenceSpeed=3000.0)
        plc.enable()
        plc.set(Speed=600.0)
        plc.exchange(250)
        plc.deaf = True
        plc.until(lambda block: not block["GOOD"], "the frames of the gateway are missing")
        plc.exchange(500)
        assert (rpm(drive), plc.block["REASON"]) == (0, Reason.DRIVE_OFFLINE.code)
        plc.deaf = False
        plc.exchange(500)
        assert (rpm(drive), plc.block["REASON"]) == (0, Reason.NEEDS_OFF.code)


def test_block_enables_again_after_lost_frames_without_an_acknowledge() -> None:
    with axis_with(1) as (plc, drive):
        plc.set(ReferenceSpeed=3000.0)
        plc.enable()
        plc.loop.run_for(SECOND)
        plc.exchange(100)
        assert drive.node.model.state is not State.OPERATION_ENABLED
        assert plc.daemon.axes[0].actuals[0] & 0x08, "fault 103 is not acknowledged"
        plc.set(Enable=False)
        plc.enable()
        assert not plc.block["ERROR"]
        plc.set(AckError=True)
        plc.until(lambda _: not plc.daemon.axes[0].actuals[0] & 0x08, "acknowledged in operation")
        assert plc.block["ENABLED"]


TARGETS = {9: 8_796_093, 110: 10_000, 111: 10_000, 112: 10.0}
"""One revolution (4096 counts) in the units of the telegram. 100 % of telegram 9 is half the range, 500000 counts."""
SPEED = {9: 200_000_000, 110: 6000, 111: 6000, 112: 6000}


def turns(drive: SimulatedDrive) -> float:
    """Where the shaft is, in revolutions."""
    return drive.node.model.position_actual / 4096


def execute(plc: TextPlc, **inputs: object) -> None:
    """An edge of Execute, until the block answers it."""
    plc.set(Execute=False)
    plc.exchange()
    plc.set(Execute=True, **inputs)
    plc.exchange()


def run(plc: TextPlc, **inputs: object) -> None:
    execute(plc, **inputs)
    plc.until(lambda block: not block["BUSY"], f"{inputs}")
    assert (plc.block["DONE"], plc.block["ABORTED"]) == (True, False), plc.block
    plc.until(lambda block: block["STANDSTILL"], "the position window of the drive is wider than that of the test")


def homed(plc: TextPlc, number: int) -> None:
    """Enabled, with a home position."""
    plc.set(PositionFactor=1.0, VelocityFactor=1.0)
    plc.enable()
    if number == 9:
        plc.set(HomingMethod=35)
    run(plc, ModePos=4, Velocity=float(SPEED[number]))
    assert plc.block["HOMED"]


@pytest.mark.parametrize("number", TARGETS)
def test_position_block_moves_replaces_halts_cancels_and_recovers(number: int) -> None:
    with axis_with(number) as (plc, drive):
        homed(plc, number)
        one, speed = TARGETS[number], float(SPEED[number])
        run(plc, ModePos=2, Position=3.0 * one, Velocity=speed)
        assert turns(drive) == pytest.approx(3, abs=0.01)
        assert plc.block["ACTPOSITION"] == pytest.approx(3 * one, rel=0.01)
        run(plc, ModePos=1, Position=-1.0 * one)
        assert turns(drive) == pytest.approx(2, abs=0.01)
        execute(plc, ModePos=2, Position=20.0 * one)
        plc.exchange(50)
        run(plc, ModePos=2, Position=4.0 * one)
        assert turns(drive) == pytest.approx(4, abs=0.01)
        execute(plc, ModePos=2, Position=8.0 * one)
        plc.exchange(50)
        plc.set(Halt=True)
        plc.exchange(100)
        rest = turns(drive)
        plc.exchange(100)
        assert (turns(drive), plc.block["BUSY"], plc.block["DONE"]) == (rest, True, False)
        assert plc.block["REASON"] == Reason.INTERMEDIATE_STOP.code
        plc.set(Halt=False)
        plc.until(lambda block: block["DONE"], "goes on")
        assert turns(drive) == pytest.approx(8, abs=0.01)
        execute(plc, ModePos=2, Position=0.0)
        plc.exchange(50)
        plc.set(Cancel=True)
        plc.exchange(100)
        plc.set(Cancel=False)
        plc.until(lambda block: not block["BUSY"], "cancelled")
        assert plc.block["ABORTED"]
        assert 1 < turns(drive) < 8
        drive.node.model.inject(5)
        plc.until(lambda block: block["ERROR"], "fault")
        plc.exchange(100)
        drive.node.model.clear()
        plc.set(AckError=True)
        plc.until(lambda block: not block["ERROR"], "acknowledged")
        plc.set(AckError=False, Enable=False)
        plc.enable()
        run(plc, ModePos=2, Position=2.0 * one)
        assert turns(drive) == pytest.approx(2, abs=0.01)


@pytest.mark.parametrize("number", TARGETS)
def test_position_block_rejects_unsupported_commands(number: int) -> None:
    with axis_with(number) as (plc, drive):
        homed(plc, number)
        for inputs, reason in (
            ({"ModePos": 2, "Velocity": 0.0}, Reason.TASK_SPEED_ZERO),
            ({"ModePos": 2, "Velocity": 10.0, "Position": 1e12}, Reason.TASK_TARGET_RANGE),
            ({"ModePos": 17}, Reason.MODE_VALUE),
        ):
            execute(plc, **inputs)
            assert (plc.block["ABORTED"], plc.block["BUSY"], plc.block["REASON"]) == (True, False, reason.code)
        assert turns(drive) == 0


@pytest.mark.parametrize("number", [111, 112])
def test_position_block_sets_up_with_a_velocity(number: int) -> None:
    with axis_with(number) as (plc, drive):
        homed(plc, number)
        execute(plc, ModePos=3, Velocity=-6000.0)
        plc.exchange(250)
        assert rpm(drive) == pytest.approx(-600, abs=5)
        assert plc.block["BUSY"]
        plc.set(Cancel=True)
        plc.exchange(250)
        plc.set(Cancel=False)
        plc.exchange(5)
        assert (rpm(drive), plc.block["BUSY"]) == (0, False)


@pytest.mark.parametrize("number", [110, 111, 112])
def test_position_block_jogs_and_sets_the_reference_point(number: int) -> None:
    with axis_with(number) as (plc, drive):
        homed(plc, number)
        plc.set(ModePos=7, Jog2=True)
        plc.exchange(100)
        assert rpm(drive) == pytest.approx(300, abs=5)
        plc.set(Jog2=False)
        plc.exchange(250)
        begin = turns(drive)
        plc.set(ModePos=8, Jog2=True)
        plc.exchange(500)
        plc.set(Jog2=False)
        plc.exchange(10)
        assert turns(drive) - begin == pytest.approx(0.5, abs=0.01)
        run(plc, ModePos=5)
        assert plc.block["ACTPOSITION"] == 0


@pytest.mark.parametrize("number", [7, 110, 111, 112])
def test_position_block_runs_a_traversing_block(number: int) -> None:
    config = config_of(number, "[[axis.block]]\nnumber = 3\nposition = 20000\nvelocity = 6000\n")
    with running(config) as daemon:
        plc, drive = TextPlc(daemon, program(config)), drive_of(daemon)
        if number == 7:
            plc.enable()
            run(plc, ModePos=4)
        else:
            homed(plc, number)
        run(plc, ModePos=6, BlockNumber=3)
        assert turns(drive) == pytest.approx(2, abs=0.01)
        execute(plc, BlockNumber=4)
        plc.until(lambda block: block["ABORTED"], "there is no such block")
        assert plc.block["REASON"] == Reason.TASK_BLOCK_UNKNOWN.code


def test_block_of_telegram_7_jogs_cancels_and_recovers() -> None:
    config = config_of(7, "[[axis.block]]\nnumber = 3\nposition = 900000\nvelocity = 6000\n")
    with running(config) as daemon:
        plc, drive = TextPlc(daemon, program(config)), drive_of(daemon)
        plc.enable()
        plc.set(ModePos=7, Jog2=True)
        plc.exchange(100)
        assert rpm(drive) == pytest.approx(300, abs=5)
        plc.set(Jog2=False)
        plc.exchange(250)
        assert rpm(drive) == 0
        run(plc, ModePos=4)
        execute(plc, ModePos=6, BlockNumber=3)
        plc.exchange(250)
        assert rpm(drive) == pytest.approx(600, abs=5)
        plc.set(Cancel=True)
        plc.exchange(250)
        plc.set(Cancel=False)
        plc.until(lambda block: not block["BUSY"], "cancelled")
        assert (plc.block["ABORTED"], rpm(drive)) == (True, 0)
        execute(plc)
        plc.exchange(250)
        drive.node.model.inject(5)
        plc.until(lambda block: block["ERROR"], "fault")
        plc.exchange(250)
        assert (plc.block["ABORTED"], rpm(drive), plc.block["REASON"]) == (True, 0, Reason.DRIVE_FAULT.code)
        drive.node.model.clear()
        plc.set(AckError=True)
        plc.until(lambda block: not block["ERROR"], "acknowledged")
        plc.set(AckError=False, Enable=False)
        plc.enable()
        plc.exchange(250)
        assert rpm(drive) == 0, "Execute was TRUE all the time"
        execute(plc)
        plc.exchange(250)
        assert rpm(drive) == pytest.approx(600, abs=5)
        plc.set(Enable=False)
        plc.until(lambda block: not block["ENABLED"], "off")
        plc.exchange(250)
        assert rpm(drive) == 0


@pytest.mark.parametrize("number", ENCODERS)
def test_encoder_block_shows_position_and_presets(number: int) -> None:
    config = config_of(number)
    with running(config) as daemon:
        plc, encoder = TextPlc(daemon, program(config)), encoder_of(daemon, 1)
        plc.until(lambda block: block["GOOD"], "good")
        plc.exchange(100)
        assert (plc.block["VALID"], plc.block["REASON"]) == (False, Reason.ENCODER_NO_CONTROL.code)
        plc.set(Enable=True)
        plc.until(lambda block: block["VALID"], "valid")
        begin = plc.block["POSITION"]
        plc.exchange(250)
        assert plc.block["POSITION"] != begin, "it turns"
        plc.set(Preset=True)
        plc.until(lambda block: block["PRESETDONE"], "preset")
        plc.set(Preset=False)
        plc.exchange(50)
        assert not plc.block["PRESETDONE"]
        plc.set(Park=True)
        plc.until(lambda block: block["PARKED"], "parked")
        assert (plc.block["VALID"], plc.block["REASON"]) == (False, Reason.SENSOR_PARKED.code)
        plc.set(Park=False)
        plc.until(lambda block: block["VALID"], "in operation again")
        encoder.node.model.inject("position-error")
        plc.until(lambda block: block["ERROR"], "fault")
        assert (plc.block["VALID"], plc.block["REASON"]) == (False, Reason.SENSOR_ERROR.code)
        encoder.node.model.clear()
        plc.exchange(100)
        assert plc.block["ERROR"], "a fault stays until it is acknowledged"
        plc.set(AckError=True)
        plc.until(lambda block: block["VALID"], "acknowledged")


def test_encoder_block_ends_its_acknowledge_when_the_sensor_confirms_it() -> None:
    with running(config_of(81)) as daemon:
        plc, encoder = TextPlc(daemon, program(daemon.config)), encoder_of(daemon, 1)
        plc.set(Enable=True)
        plc.until(lambda block: block["VALID"], "valid")
        encoder.node.model.inject("position-error")
        plc.until(lambda block: block["ERROR"], "fault")
        encoder.node.model.clear()
        plc.exchange(100)
        plc.set(AckError=True)
        plc.until(lambda block: block["VALID"], "the sensor keeps its error until G1_STW.15 is 0")


def test_block_of_telegram_100_enables_turns_and_recovers() -> None:
    with axis_with(100) as (plc, drive):
        plc.exchange(500)
        plc.block["WANTED"]["MODES_OF_OPERATION"] = 3
        plc.set(Enable=True)
        plc.until(lambda block: block["ENABLED"], "enabled")
        plc.block["WANTED"]["TARGET_VELOCITY"] = 400
        plc.block["WANTED"]["PROFILE_ACCELERATION"] = plc.block["WANTED"]["PROFILE_DECELERATION"] = 100
        plc.exchange(500)
        assert rpm(drive) == pytest.approx(200, abs=5)
        plc.set(QuickStop=True)
        plc.exchange(500)
        plc.set(QuickStop=False)
        plc.exchange(250)
        assert (rpm(drive), plc.block["REASON"]) == (0, Reason.NEEDS_OFF.code)
        plc.set(Enable=False)
        plc.exchange(250)
        plc.set(Enable=True)
        plc.exchange(500)
        assert rpm(drive) == pytest.approx(200, abs=5)
        drive.node.model.inject(5)
        plc.until(lambda block: block["ERROR"], "fault")
        plc.exchange(100)
        drive.node.model.clear()
        plc.set(AckError=True)
        plc.until(lambda block: not block["ERROR"], "reset")
        plc.exchange(250)
        assert (rpm(drive), plc.block["REASON"]) == (0, Reason.NEEDS_OFF.code)
        plc.set(AckError=False, Enable=False)
        plc.exchange(250)
        plc.set(Enable=True)
        plc.exchange(500)
        assert rpm(drive) == pytest.approx(200, abs=5)
        plc.set(Enable=False)
        plc.exchange(500)
        assert (rpm(drive), plc.block["ENABLED"]) == (0, False)
