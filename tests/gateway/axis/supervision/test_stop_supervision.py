"""A drive that ignores a stop is detected within the derived time and stopped by stronger means; no false detection."""

from __future__ import annotations

import pytest

from pdgw.base.durations import SECOND
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import POSITIONS
from pdgw.dsp402.states import STATUS_OF, State, StatusBit, enables
from pdgw.gateway.axis.orders import Brake, Order
from pdgw.gateway.axis.settings import AxisSettings, LastStop, PlcLossReaction
from pdgw.gateway.axis.supervision.stop_supervision import StopWatch
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.axis.values import Configured, Inputs, Outputs
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from tests.gateway.axis.test_velocity import OFF, ON, Bench
from tests.support.axis.rig import Rig

COAST, QUICK_STOP = ON & ~0x2, ON & ~0x4
CYCLE = 4_000_000
REACTION = AxisSettings().reaction_ns
ENTER = AxisSettings().enter_ns
TURNING = 3000
FULL = 6000


def turning(**settings: object) -> Bench:
    bench = Bench(**settings)  # type: ignore[arg-type]
    bench.operate(0x2000)
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.feedback.velocity_actual == TURNING
    return bench


def without_reaction(bench: Bench, word: int | None, cycles: int) -> Brake:
    """The drive keeps its state, whatever it is sent."""
    feedback = bench.drive.feedback
    for _ in range(cycles):
        bench.now += CYCLE
        bench.stepper.step(None if word is None else (word, 0x2000), feedback, bench.drive_ok, bench.now)
    return bench.stepper.machine.outputs.brake


def made_watch(reaction: int, stop_time: int, enter: int, *, disables: bool = True) -> StopWatch:
    """Of a drive that shows no limit."""
    evidence = TorqueEvidence(Inputs(DriveFeedback()), Outputs(0, None))
    watch = StopWatch(reaction, stop_time, enter, evidence, disables=disables)
    watch.set_drive(FULL, 0.0, POSITIONS)
    return watch


def watched(watch: StopWatch, order: Order, state: State | None, now: int, velocity: int = 0) -> bool:
    """One cycle with a drive whose position does not come; whether it is late."""
    return watch.step(order, state, True, False, velocity, now, 0, 0, 30, now) is not None


def numbers(bench: Bench) -> list[int]:
    return bench.stepper.numbers


@pytest.mark.parametrize("word", [OFF, COAST, QUICK_STOP, ON & ~0x400, None])
def test_drive_that_ignores_a_stop_gets_nmt_stop_and_one_fault(word: int | None) -> None:
    bench = turning()
    assert without_reaction(bench, word, REACTION // CYCLE) is Brake.NONE
    assert without_reaction(bench, word, 20) is Brake.NMT_STOP
    assert numbers(bench).count(FaultNumber.STOP_IGNORED) == 1
    assert "1500 rpm" in bench.stepper.events[-1].text


def test_quick_stop_is_supervised_by_speed_while_the_statusword_changes() -> None:
    """An invalid Statusword from time to time restarts the reaction time of Operation Enabled, but not that of the speed."""
    watch = made_watch(REACTION, CYCLE, ENTER)
    watch.reference = TURNING
    at = range(0, 2 * REACTION, REACTION // 4)
    found = [
        watched(watch, Order.STOP, State.OPERATION_ENABLED if n != 5 else None, now, TURNING)
        for n, now in enumerate(at, 1)
    ]
    assert found.index(True) == 5
    assert watch.brake is Brake.NMT_STOP


def test_heartbeat_is_withheld_from_a_node_that_ignores_nmt_stop() -> None:
    bench = turning()
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP
    bench.drive_ok = False
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 1) is Brake.WITHHOLD_HEARTBEAT
    assert numbers(bench).count(FaultNumber.STOP_IGNORED) == 1


def test_heartbeat_continues_for_a_node_in_nmt_stopped() -> None:
    bench = turning()
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP
    bench.drive_ok = False
    bench.stepper.machine.inputs.node_stopped = True
    assert without_reaction(bench, QUICK_STOP, 10 * REACTION // CYCLE) is Brake.NMT_STOP


def test_heartbeat_continues_during_bring_up_after_nmt_stopped() -> None:
    """For the bring-up the gateway itself ends NMT Stopped; other nodes continue."""
    bench = turning()
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP
    inputs = bench.stepper.machine.inputs
    inputs.node_stopped = True
    without_reaction(bench, QUICK_STOP, 3)
    bench.drive_ok = inputs.node_stopped = False
    assert without_reaction(bench, QUICK_STOP, 10 * REACTION // CYCLE) is Brake.NMT_STOP


def test_drive_above_its_line_after_nmt_stop_and_bring_up_gets_disable_voltage() -> None:
    bench = turning()
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20)
    machine = bench.stepper.machine
    machine.inputs.node_stopped = True
    without_reaction(bench, QUICK_STOP, 3)
    assert machine.needs_last_stop(TURNING), "also the client that finds it in pre-operational"
    machine.inputs.node_stopped = False
    assert without_reaction(bench, QUICK_STOP, 2) is Brake.NONE
    assert bench.controlword == 0
    assert numbers(bench).count(FaultNumber.STOP_IGNORED) == 2
    assert "the gateway commands Disable Voltage" in bench.stepper.events[-1].text
    assert without_reaction(bench, OFF, REACTION // CYCLE + 3) is Brake.WITHHOLD_HEARTBEAT
    assert bench.controlword == 0, "until the drive is off"
    bench.drive.restart()
    assert without_reaction(bench, OFF, 3) is Brake.NONE
    assert not machine.needs_last_stop(TURNING)


def test_drive_below_its_line_after_nmt_stop_and_bring_up_continues_its_quick_stop() -> None:
    bench = turning()
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20)
    machine = bench.stepper.machine
    machine.inputs.node_stopped = True
    bench.drive.feedback.velocity_actual = TURNING * 9 // 10
    without_reaction(bench, QUICK_STOP, 3)
    assert not machine.needs_last_stop(TURNING * 9 // 10)
    machine.inputs.node_stopped = False
    assert without_reaction(bench, QUICK_STOP, 3) is Brake.NONE
    assert bench.controlword == 0x2


@pytest.mark.parametrize(("last", "brake"), [(LastStop.DISABLE_VOLTAGE, Brake.NONE), (LastStop.NONE, Brake.NMT_STOP)])
def test_speed_that_grows_under_quick_stop_gets_disable_voltage_before_nmt_stop(last: LastStop, brake: Brake) -> None:
    bench = turning(last_stop=last)
    feedback = bench.drive.feedback
    for cycle in range(REACTION // CYCLE + 2):
        feedback.velocity_actual = TURNING + cycle * 10
        assert bench.controlword != 0
        found = without_reaction(bench, QUICK_STOP, 1)
    assert found is brake
    without_reaction(bench, QUICK_STOP, 1)
    assert bench.controlword == (0 if last is LastStop.DISABLE_VOLTAGE else 0x2)
    assert numbers(bench) == [FaultNumber.STOP_IGNORED]
    if last is LastStop.DISABLE_VOLTAGE:
        assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 2) is Brake.NMT_STOP, "it ignores this, too"


def test_heartbeat_is_withheld_if_the_drive_turns_after_nmt_stop_and_bring_up() -> None:
    bench = turning(last_stop=LastStop.NONE)
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20)
    inputs = bench.stepper.machine.inputs
    inputs.node_stopped = True
    assert without_reaction(bench, QUICK_STOP, 3) is Brake.NMT_STOP
    inputs.node_stopped = False
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE) is Brake.NONE, (
        "a stop that is commanded again has its time"
    )
    assert without_reaction(bench, QUICK_STOP, 20) is Brake.WITHHOLD_HEARTBEAT
    assert numbers(bench).count(FaultNumber.STOP_IGNORED) == 2


def test_drive_that_brakes_while_the_heartbeat_is_withheld_counts_as_stopped() -> None:
    bench = turning(last_stop=LastStop.NONE)
    machine, feedback = bench.stepper.machine, bench.drive.feedback
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20)
    machine.inputs.node_stopped = True
    without_reaction(bench, QUICK_STOP, 3)
    machine.inputs.node_stopped = False
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE)
    assert not machine.unstopped_since, "a stop is left"
    assert without_reaction(bench, QUICK_STOP, 20) is Brake.WITHHOLD_HEARTBEAT
    assert not machine.unstopped_since, "it has its reaction time"
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 3)
    assert 0 < bench.now - machine.unstopped_since < 4 * REACTION, "since the first stop"
    feedback.velocity_actual = TURNING // 2
    without_reaction(bench, QUICK_STOP, 1)
    assert not machine.unstopped_since
    feedback.velocity_actual = TURNING
    bench.drive_ok = False
    without_reaction(bench, QUICK_STOP, 1)
    assert not machine.unstopped_since, "its speed is not known"


def test_next_stop_after_power_off_starts_with_nmt_again() -> None:
    bench = turning()
    without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20)
    inputs = bench.stepper.machine.inputs
    inputs.node_stopped = True
    without_reaction(bench, QUICK_STOP, 3)
    inputs.node_stopped = False
    bench.drive.restart()
    assert without_reaction(bench, OFF, 2) is Brake.NONE
    bench.operate(0x2000)
    bench.step(ON, 0x2000, cycles=10)
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP


def test_nmt_stop_is_released_by_power_off_and_not_by_configuration() -> None:
    bench = turning()
    without_reaction(bench, QUICK_STOP, 2 * REACTION // CYCLE + 40)
    bench.drive_ok = False
    assert without_reaction(bench, QUICK_STOP, 10) is Brake.WITHHOLD_HEARTBEAT
    bench.drive_ok = True
    bench.stepper.machine.inputs.news.append(Configured(bench.stepper.drive_type))
    assert without_reaction(bench, QUICK_STOP, 3) is Brake.WITHHOLD_HEARTBEAT
    bench.drive.restart()
    assert without_reaction(bench, OFF, 2) is Brake.NONE
    bench.operate()


@pytest.mark.parametrize("speed", [TURNING, -TURNING, 6000])
def test_quick_stop_without_a_ramp_is_detected(speed: int) -> None:
    """The state is left, the axis turns on."""
    bench = turning()
    feedback = bench.drive.feedback
    feedback.velocity_actual = speed
    bench.step(QUICK_STOP, 0x2000)
    feedback.statusword = STATUS_OF[State.QUICK_STOP_ACTIVE] | StatusBit.VOLTAGE_ENABLED
    feedback.velocity_actual = speed
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE) is Brake.NONE
    assert without_reaction(bench, QUICK_STOP, 20) is Brake.NMT_STOP


@pytest.mark.parametrize("seconds", [0.1, 1, 9, 11])
@pytest.mark.parametrize("word", [OFF, None])
def test_ramp_within_its_margin_is_accepted(word: int | None, seconds: float) -> None:
    bench = turning(on_plc_loss=PlcLossReaction.RAMP)
    bench.drive.ramp = max(1, int(6000 * CYCLE / 1e9 / seconds))
    for _ in range(int(seconds * 1e9 / CYCLE) + 20):
        bench.step(word, 0x2000)
        if bench.drive.state is not State.OPERATION_ENABLED:
            break
        assert bench.stepper.machine.outputs.brake is Brake.NONE
    assert bench.drive.feedback.velocity_actual == 0
    assert FaultNumber.STOP_IGNORED not in numbers(bench)


@pytest.mark.parametrize("word", [OFF, None])
def test_ramp_longer_than_its_margin_is_detected(word: int | None) -> None:
    bench = turning(on_plc_loss=PlcLossReaction.RAMP)
    bench.drive.ramp = 1  # 100 % in 24 s, 10 s are configured
    for _ in range(int(10e9 / CYCLE)):
        bench.step(word, 0x2000)
        if bench.stepper.machine.outputs.brake is not Brake.NONE:
            break
    assert bench.stepper.machine.outputs.brake is Brake.NMT_STOP
    assert bench.drive.feedback.velocity_actual > 0


def test_each_stop_has_its_own_time() -> None:
    bench = turning()
    bench.drive.ramp = 60
    for _ in range(2):
        bench.step(OFF, 0x2000, cycles=200)
        assert bench.stepper.machine.outputs.brake is Brake.NONE
        bench.step(ON, 0x2000, cycles=2000)
        assert bench.drive.feedback.velocity_actual == TURNING
    assert FaultNumber.STOP_IGNORED not in numbers(bench)


def test_acceleration_to_an_earlier_setpoint_is_accepted_during_a_stop() -> None:
    settings = AxisSettings()
    watch = made_watch(settings.reaction_ns, settings.stop_time_ns, settings.enter_ns)
    watch.reference, slope, began = 6000, 6000 / settings.stop_time_ns, 10**12
    for since in range(0, settings.stop_time_ns, CYCLE):
        braking = max(0, since - REACTION)
        speed = int(1000 + 2000 * min(1.0, since / REACTION) - slope * braking)
        if speed <= 0:
            break
        assert not watched(watch, Order.RAMP, State.OPERATION_ENABLED, began + since, speed)
    assert watched(watch, Order.RAMP, State.OPERATION_ENABLED, began + since, 3001)


@pytest.mark.parametrize("order", [Order.HALT, Order.RAMP])
def test_acceleration_during_a_long_reaction_time_is_accepted(order: Order) -> None:
    reaction, began = SECOND, 10**12
    watch = made_watch(reaction, 10 * SECOND, ENTER)
    for since in range(0, 3 * reaction, CYCLE):
        share = min(since, reaction) / reaction - max(0, since - reaction) / (5 * SECOND)
        assert not watched(watch, order, State.OPERATION_ENABLED, began + since, int(1000 + 2000 * share)), since
    assert watch.order is order


def test_fault_reaction_of_the_drive_has_no_time_limit() -> None:
    bench = turning()
    bench.drive.feedback.statusword = STATUS_OF[State.FAULT_REACTION_ACTIVE]
    assert without_reaction(bench, ON, 20 * REACTION // CYCLE) is Brake.NONE
    assert FaultNumber.STOP_IGNORED not in numbers(bench)


def test_reaction_time_restarts_after_a_short_exit_from_operation() -> None:
    watch = made_watch(REACTION, AxisSettings().stop_time_ns, ENTER)

    def disobeys(operating: bool, now: int) -> bool:
        return watched(watch, Order.OFF2, State.OPERATION_ENABLED if operating else None, now)

    assert not disobeys(True, 0)
    assert not disobeys(False, REACTION)
    assert not disobeys(True, 2 * REACTION)
    assert not disobeys(True, 3 * REACTION)
    assert disobeys(True, 3 * REACTION + 1)


def test_nmt_stop_is_released_by_power_off_without_an_off_of_the_plc() -> None:
    bench = turning()
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP
    bench.drive.feedback.statusword = STATUS_OF[State.SWITCH_ON_DISABLED]
    bench.drive.feedback.velocity_actual = 0
    assert without_reaction(bench, None, 3) is Brake.NONE


# -- a drive that is at standstill and keeps its state: its brake closes ------------------------------------------------


def standing(word: int, seconds: float, **settings: object) -> Bench:
    """A stop: the drive is at standstill and keeps its state."""
    bench = turning(**settings)
    bench.drive.feedback.velocity_actual = 0
    without_reaction(bench, word, int(seconds * SECOND // CYCLE))
    return bench


@pytest.mark.parametrize("word", [OFF, QUICK_STOP, ON & ~0x8], ids=["OFF1", "OFF3", "STW1.3 = 0"])
def test_drive_at_standstill_may_need_ten_seconds_to_leave_operation(word: int) -> None:
    bench = standing(word, 9.5, stop_time_ns=SECOND)
    assert numbers(bench) == []
    assert bench.stepper.machine.outputs.brake is Brake.NONE
    assert bench.stepper.reason is Reason.NOT_LEFT
    assert bench.stepper.machine.outputs.actuals[0] & 0x4, "the drive is in operation"
    without_reaction(bench, word, int(SECOND // CYCLE))
    assert numbers(bench) == [FaultNumber.NOT_ENTERED if word & 0x5 == 0x5 else FaultNumber.STOP_IGNORED]


@pytest.mark.parametrize("word", [OFF, QUICK_STOP, ON & ~0x8], ids=["OFF1", "OFF3", "STW1.3 = 0"])
def test_slow_brake_is_named_after_the_reaction_time_and_takes_no_on(word: int) -> None:
    bench = standing(word, 0.2)
    assert bench.stepper.reason is not Reason.NOT_LEFT
    without_reaction(bench, word, int(SECOND // CYCLE))
    assert bench.stepper.reason is Reason.NOT_LEFT
    without_reaction(bench, ON, 10)
    assert not enables(bench.controlword)
    bench.drive.restart()
    without_reaction(bench, word, 2)
    assert bench.stepper.reason is not Reason.NOT_LEFT
    assert not bench.stepper.machine.outputs.actuals[0] & 0x4


@pytest.mark.parametrize("word", [OFF, QUICK_STOP], ids=["OFF1", "OFF3"])
def test_drive_that_turns_again_while_its_brake_closes_is_stopped_at_once(word: int) -> None:
    bench = standing(word, 1)
    bench.drive.feedback.velocity_actual = 100
    assert without_reaction(bench, word, 1) is Brake.NMT_STOP


def test_drive_that_creeps_while_its_brake_closes_is_stopped() -> None:
    """Its speed is inside the window, its position leaves the way of the reaction time."""
    bench = standing(OFF, 1)
    inputs, feedback = bench.stepper.machine.inputs, bench.drive.feedback
    feedback.velocity_actual = window = 60
    for _ in range(2 * REACTION // CYCLE):
        inputs.position_ns = bench.now + CYCLE
        feedback.position_actual += window * 4096 // 60 * CYCLE // SECOND + 1
        if without_reaction(bench, OFF, 1) is not Brake.NONE:
            break
    assert bench.stepper.machine.outputs.brake is Brake.NMT_STOP


def test_off2_keeps_its_time_at_standstill() -> None:
    bench = standing(OFF, 1)
    assert without_reaction(bench, COAST, REACTION // CYCLE) is Brake.NONE
    assert without_reaction(bench, COAST, 5) is Brake.NMT_STOP


def test_off2_is_not_weakened_by_a_later_off1() -> None:
    bench = standing(COAST, 0.1)
    without_reaction(bench, OFF, REACTION // CYCLE + 5)
    assert bench.stepper.machine.outputs.brake is Brake.NMT_STOP


def standing_in_quick_stop(word: int) -> Bench:
    """After a command, the drive is at standstill in Quick Stop Active."""
    bench = turning()
    bench.step(word, 0x2000)
    feedback = bench.drive.feedback
    feedback.statusword = STATUS_OF[State.QUICK_STOP_ACTIVE] | StatusBit.VOLTAGE_ENABLED
    feedback.velocity_actual = 0
    return bench


def test_disable_voltage_after_a_finished_quick_stop_waits_for_the_brake() -> None:
    bench = standing_in_quick_stop(QUICK_STOP)
    assert without_reaction(bench, QUICK_STOP, int(9.5 * SECOND // CYCLE)) is Brake.NONE
    assert bench.controlword & 0xF == 0x0
    assert without_reaction(bench, QUICK_STOP, int(SECOND // CYCLE)) is Brake.NMT_STOP


def test_off2_keeps_the_reaction_time_when_the_plc_is_lost_after_it() -> None:
    bench = standing_in_quick_stop(COAST)
    assert without_reaction(bench, None, int(REACTION // CYCLE) + 3) is Brake.NMT_STOP


def test_drive_that_needed_an_nmt_stop_has_no_time_for_its_brake() -> None:
    bench = turning()
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP
    bench.drive_ok = False
    bench.stepper.machine.inputs.node_stopped = True
    without_reaction(bench, QUICK_STOP, 5)
    bench.drive_ok = True
    bench.stepper.machine.inputs.node_stopped = False
    bench.drive.feedback.velocity_actual = 0
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.WITHHOLD_HEARTBEAT


# -- Disable Operation --------------------------------------------------------------------------------------------------


def test_drive_that_does_not_hear_disable_operation_is_stopped_soon() -> None:
    bench = turning()
    allowed = REACTION + AxisSettings().stop_time_ns // 7
    without_reaction(bench, ON & ~0x8, allowed // CYCLE)
    assert numbers(bench) == []
    assert bench.stepper.machine.outputs.actuals[0] & 0x4, "the drive is in operation"
    without_reaction(bench, ON & ~0x8, 3)
    assert numbers(bench) == [FaultNumber.NOT_ENTERED]
    assert without_reaction(bench, ON & ~0x8, REACTION // CYCLE + 5) is Brake.NMT_STOP


def test_drive_that_begins_to_brake_after_disable_operation_and_then_keeps_its_speed_is_stopped() -> None:
    """It has fallen by more than the standstill window, but not by 5 % in the stop time."""
    stop_time, began, kept = AxisSettings().stop_time_ns, 10**12, int(0.96 * FULL)
    watch = made_watch(REACTION, stop_time, ENTER)
    found = -1
    for since in range(0, REACTION + 2 * stop_time, REACTION // 4):
        velocity = kept if since > REACTION // 2 else FULL
        if watched(watch, Order.DISABLE, State.OPERATION_ENABLED, began + since, velocity):
            found = since
            break
    assert 0.8 * stop_time <= found <= stop_time


@pytest.mark.parametrize("seconds", [1, 5, 18])
def test_ramp_with_jerk_limit_after_disable_operation_is_accepted(seconds: float) -> None:
    bench = turning()
    feedback, now = bench.drive.feedback, 0.0
    while feedback.velocity_actual:
        now += CYCLE / SECOND
        part = min(1.0, now / seconds)
        share = 1 - 2 * part**2 if part < 0.5 else 2 * (1 - part) ** 2
        feedback.velocity_actual = int(TURNING * share)
        without_reaction(bench, ON & ~0x8, 1)
    assert numbers(bench) == []


@pytest.mark.parametrize("slows", [False, True])
def test_drive_that_coasts_after_disable_operation_must_become_slower(slows: bool) -> None:
    """605Ch = 0: the power is off at once."""
    bench = turning()
    without_reaction(bench, ON & ~0x8, 2)
    bench.drive.feedback.statusword = STATUS_OF[State.SWITCHED_ON]
    for _ in range(60):
        without_reaction(bench, ON & ~0x8, int(SECOND // CYCLE))
        if slows:
            bench.drive.feedback.velocity_actual = int(0.99 * bench.drive.feedback.velocity_actual)
    assert numbers(bench) == ([] if slows else [FaultNumber.TURNS_OFF])


@pytest.mark.parametrize("number", [1, 9, 100])
def test_drive_that_follows_is_never_reported(number: int) -> None:
    rig = Rig(number)
    for stop in (0x6, 0x2, 0x0):
        rig.values[rig.stepper.telegram.setpoints.names[0]] = 0
        rig.step(5)
        if number == 100:
            for word in (0x06, 0x07, 0x0F):
                rig.values["Controlword"] = word
                rig.step(4)
            rig.values["Controlword"] = stop
        else:
            rig.enable()
            rig.values["STW1"] = 0x0438 | stop
        rig.step(600)
        assert rig.stepper.machine.outputs.brake is Brake.NONE
    assert FaultNumber.STOP_IGNORED not in rig.stepper.numbers


def test_drive_that_keeps_quick_stop_active_after_off2_gets_nmt_stop() -> None:
    """The stronger stop does not take the brake away."""
    bench = turning()
    bench.step(QUICK_STOP, 0x2000)
    bench.drive.feedback.statusword = STATUS_OF[State.QUICK_STOP_ACTIVE] | StatusBit.VOLTAGE_ENABLED
    without_reaction(bench, QUICK_STOP, 10)
    assert without_reaction(bench, COAST, REACTION // CYCLE + 20) is Brake.NMT_STOP
    assert numbers(bench).count(FaultNumber.STOP_IGNORED) == 1


def test_drive_that_never_shows_operation_gets_no_setpoint_and_then_quick_stop() -> None:
    bench = Bench()
    bench.step(OFF, cycles=3)
    bench.step(ON, 0x2000)
    assert bench.drive.state is State.SWITCHED_ON
    without_reaction(bench, ON, AxisSettings().enter_ns // CYCLE)
    command = bench.stepper.command
    assert (command.controlword & 0xF, command.target_velocity) == (0xF, 0)
    without_reaction(bench, ON, 5)
    assert command.controlword & 0xF == 0x2
    assert numbers(bench) == [FaultNumber.NOT_ENTERED]
    assert "of Enable Operation, Statusword 0233h" in bench.stepper.events[-1].text
    assert bench.stepper.reason is Reason.NEEDS_OFF


def test_disable_operation_that_never_ends_operation_becomes_a_quick_stop() -> None:
    """The shaft becomes slower, and the state does not end."""
    bench = turning(stop_time_ns=SECOND)
    for share in range(100, 50, -2):
        bench.drive.feedback.velocity_actual = TURNING * share // 100
        without_reaction(bench, ON & ~0x8, (REACTION + 2 * SECOND) // CYCLE // 25)
    assert bench.stepper.command.controlword & 0xF == 0x7, "it may brake on its ramp"
    without_reaction(bench, ON & ~0x8, 20)
    assert bench.stepper.command.controlword & 0xF == 0x2
    assert numbers(bench) == [FaultNumber.NOT_ENTERED]
    assert without_reaction(bench, ON & ~0x8, REACTION // CYCLE + 5) is Brake.NMT_STOP


@pytest.mark.parametrize("state", [State.READY_TO_SWITCH_ON, State.FAULT])
@pytest.mark.parametrize("slows", [False, True])
def test_shaft_that_does_not_slow_down_without_power_is_a_warning(state: State, slows: bool) -> None:
    bench = turning()
    without_reaction(bench, QUICK_STOP, 2)
    feedback = bench.drive.feedback
    feedback.statusword = STATUS_OF[state]
    for _ in range(60):  # a fan coasts for minutes
        without_reaction(bench, QUICK_STOP, int(SECOND // CYCLE))
        if slows:
            feedback.velocity_actual = int(0.99 * feedback.velocity_actual)
    assert numbers(bench).count(FaultNumber.TURNS_OFF) == (not slows)
    assert bench.stepper.machine.outputs.brake is Brake.NONE


def test_each_state_that_must_end_has_its_own_time() -> None:
    """A drive that has left operation is not stopped by NMT for the time that it needed for that."""
    watch = made_watch(REACTION, AxisSettings().stop_time_ns, ENTER)
    operating, stopping = State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE
    assert not watched(watch, Order.OFF2, operating, 0)
    assert not watched(watch, Order.OFF2, operating, REACTION)
    assert not watched(watch, Order.OFF2, stopping, REACTION + 1)
    assert not watched(watch, Order.OFF2, stopping, 2 * REACTION)
    assert watched(watch, Order.OFF2, stopping, 2 * REACTION + 2)


def test_a_shaft_that_is_turned_while_an_on_waits_does_not_have_to_slow_down() -> None:
    watch = made_watch(REACTION, AxisSettings().stop_time_ns, ENTER)
    assert not watched(watch, Order.ENTER, State.SWITCHED_ON, SECOND, TURNING)
    assert not watch.coast(TURNING, 30, 100 * SECOND)
    assert watch.began < 0, "no stop is watched"


def test_each_failure_to_stop_has_its_own_begin() -> None:
    watch = made_watch(REACTION, AxisSettings().stop_time_ns, ENTER)
    for began in (10**12, 2 * 10**12):
        watched(watch, Order.STOP, State.OPERATION_ENABLED, began, TURNING)
        assert watched(watch, Order.STOP, State.OPERATION_ENABLED, began + REACTION + 1, TURNING)
        assert watch.ignored_at == began
        watch.over()
        assert watch.ignored_at == 0


# -- a speed that is read by SDO ----------------------------------------------------------------------------------------


def test_a_brake_has_its_time_while_the_speed_is_unknown() -> None:
    watch = made_watch(REACTION, AxisSettings().stop_time_ns, ENTER)
    for since, late in ((0, False), (REACTION + 1, False), (ENTER, False), (ENTER + 1, True)):
        now = SECOND + since
        found = watch.step(
            Order.OFF, State.OPERATION_ENABLED, True, False, TURNING, 0, 0, 0, 30, now, standstill_unknown=True
        )
        assert (found is not None) is late, since


def test_a_drive_whose_speed_never_came_under_its_stop_has_a_ramp_from_100_percent() -> None:
    watch, began = made_watch(REACTION, AxisSettings().stop_time_ns, ENTER), 10**12
    for now in (began, began + REACTION + 1):
        watch.step(Order.STOP, State.OPERATION_ENABLED, True, False, TURNING, began - 1, 0, 0, 30, now)
    assert watch.brake is Brake.NMT_STOP
    assert not watch.needs_last_stop(TURNING, 30, now)
    assert watch.needs_last_stop(TURNING, 30, began + REACTION + 2 * AxisSettings().stop_time_ns)


@pytest.mark.parametrize(
    ("word", "controlword"),
    [(OFF, 0x02), (OFF & ~0x8, 0x02), (ON, 0x02), (ON & ~0x400, 0x02), (None, 0x02), (QUICK_STOP, 0x02), (COAST, 0x00)],
)
@pytest.mark.parametrize("loss", [PlcLossReaction.RAMP, PlcLossReaction.COAST])
def test_a_ramp_with_an_unknown_speed_ends_with_quick_stop_but_off2_wins(
    word: int | None, controlword: int, loss: PlcLossReaction
) -> None:
    bench = turning(on_plc_loss=loss, stop_time_ns=SECOND)
    inputs = bench.stepper.machine.inputs
    inputs.speed_asked_ns = inputs.speed_until_ns = 1
    assert without_reaction(bench, OFF, (2 * SECOND + REACTION) // CYCLE + 2) is Brake.NONE
    assert bench.stepper.command.controlword & 0xF == 0xF
    without_reaction(bench, word, 1)
    expected = 0x00 if word is None and loss is PlcLossReaction.COAST else controlword
    assert bench.stepper.command.controlword & 0xF == expected
