"""The chain of enables of an axis: its drive, ON and the setpoint or order of the PLC; and what it shows beside the chain."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.dsp402.states import ControlBit, State, StatusBit, state_of
from pdgw.gateway.axis.adapters.adapter import ControlWordAdapter
from pdgw.gateway.axis.adapters.speed_words import DEVICE_BITS, SpeedAdapter
from pdgw.gateway.axis.demand_report import PowerWish, SpeedDemand, SpeedWish
from pdgw.gateway.axis.power_states import Phase
from pdgw.gateway.axis.settings import SetpointEnable
from pdgw.gateway.axis.supervision.drive_events import FAULTY, POWERED
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.finding_text import clock, finding_text
from pdgw.gateway.base.reasons import REFUSED_ORDERS, AxisState, Enable, Finding, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.base.steps import Acknowledge, Bits, Edge, Give, Hindrance, Wait, with_on
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.bit_effects import AT_LIMIT
from pdgw.gateway.objects.enable_chain import AXIS_CHAIN, Chain, hindrance_of, sensor_fault
from pdgw.gateway.objects.enable_status import EnableStatus
from pdgw.gateway.objects.inquiry import UNFOLLOWED
from pdgw.gateway.objects.lag import lag_of, reductions, setpoints, speed_setpoint_rpm
from pdgw.gateway.objects.origins import of_fault
from pdgw.profidrive.sensor_states import SensorState
from pdgw.profidrive.signal_text import value_text
from pdgw.profidrive.signals import SignalQuantity
from pdgw.profidrive.words import unswapped

_CONSUMER: Final = (
    "the heartbeat consumer of the drive (1016h) stays in error (8130h), although the gateway sends its heartbeat"
)
"""A fault of a drive that acknowledging does not end."""
_ARM: Final = "restart the node (P972, or power off and on), which arms the consumer again"
_SWITCHES: Final = "both limit switches are active: check their supply, plug and cable"
_BOTH_SWITCHES: Final = 3
"""60FDh.0 and .1."""
_ONLY_WITHOUT_POWER: Final = "only safe torque off (STO) or switching its supply off stops it"
_HOME_LOST: Final = "the home position was lost with the drive"
_KEEPS: Final = "the last setpoint stays"
_WITHOUT_MDI: Final = "the task had MDI (SATZANW.15 = 1), which this telegram does not have: it was not started"
_ASKS = (PowerWish.ON, PowerWish.ENABLE, PowerWish.RESUME, PowerWish.HOLD)
_STOPS: Final = {
    PowerWish.COAST: Reason.COAST_STOP,
    PowerWish.QUICK_STOP: Reason.QUICK_STOP,
    PowerWish.QUICK_STOP_DISABLED: Reason.QUICK_STOP,
    PowerWish.ON: Reason.ENABLE_MISSING,
}
"""Stop commands of the PLC. Its OFF1 is first a ramp stop, which the phase shows."""
_NAMED: Final = {
    Reason.LOST_EDGE: 1 << 6,
    Reason.EARLY_EDGE: 1 << 6,
    Reason.LOST_HOMING: 1 << 11,
    Reason.LOST_JOG: 3 << 8,
}
"""Bits of STW1 that a reason names."""
_SPEEDS: Final = (SignalQuantity.SPEED, SignalQuantity.MOTION_VELOCITY)
_FULL: Final = 100.0
_BLOCKS_ALONE: Final = 7
"""The telegram of a positioner without MDI."""
_PHASES: Final = {
    Phase.RAMP_STOP: Reason.RAMP_STOP,
    Phase.SHUTDOWN: Reason.RAMP_STOP,
    Phase.QUICK_STOP: Reason.QUICK_STOP,
}
"""Stops that have to end before an ON counts; in the other phases an OFF is missing."""


def axis_enable_status(axis: Axis) -> EnableStatus:
    """Chain of an axis after its last step."""
    machine, feedback = axis.machine, axis.drive.feedback
    shown = {"Statusword": feedback.statusword, "60FDh": feedback.digital_inputs}
    chain = Chain(axis, AXIS_CHAIN, **shown)
    demand, reason = machine.demand, machine.outputs.reason
    if chain.check_node(Reason.DRIVE_OFFLINE):
        _check_drive(chain, axis, state_of(feedback.statusword))
    life = machine.life
    connected = machine.inputs.setpoints is not None
    in_operation, was_there = axis.powered and axis.released, machine.interlock.plc_was_there
    if chain.check_plc(connected=connected, in_operation=in_operation, never=Reason.NO_PLC, lost=was_there):
        name, word = _control_word(axis)
        meant = unswapped(word) if name == "STW1" else None
        if life is not None and life.lost:
            chain.breaks(Reason.PLC_STALLED)
        if meant is not None:
            chain.breaks(Reason.BYTES_SWAPPED, evidence=f"STW1 = {word:04X}h: its two bytes are swapped ({meant:04X}h)")
        elif not demand.in_control:
            chain.breaks(Reason.CONTROL_HELD if reason is Reason.CONTROL_HELD else Reason.NO_CONTROL)
        else:
            chain.passes(Enable.CONTROL)
            _check_command(chain, axis)
    chain.keep(reason)
    unstopped = _unstopped(axis)
    if unstopped is not None or not machine.units_contradicted:
        chain.check_severe(_acknowledge(axis), unstopped)
    if in_operation:
        return chain.enable_status(AxisState.OBEYS if axis.turns else None)
    return chain.enable_status(AxisState.STOPPING if axis.turns or axis.good and axis.powered else None)


def _check_drive(chain: Chain, axis: Axis, state: State | None) -> None:
    """Supply, fault and operation of a drive that is online."""
    machine, demand, powered = axis.machine, axis.machine.demand, state in POWERED
    reason, statusword = machine.outputs.reason, axis.drive.feedback.statusword
    asks = demand.connected and demand.power in _ASKS
    commanded = asks and machine.interlock.reason in UNFOLLOWED
    again = asks and not axis.released
    if state in FAULTY:
        cause = axis.cause
        fault = (
            Finding.of(Reason.DRIVE_FAULT, place="remove the cause") if cause is None else axis.origins.of(cause.record)
        )
        if fault.code == HEARTBEAT_ERROR and axis.acknowledged_in_vain:
            fault = fault._replace(evidence=_CONSUMER, remedy=(_ARM,))
        chain.breaks(Reason.DRIVE_FAULT, fault, remedy=(*fault.remedy, _acknowledge(axis)))
    elif state is None:
        evidence = f"Statusword {statusword:04X}h is not a state of a CiA 402 drive"
        chain.breaks(Reason.DRIVE_UNKNOWN_STATE, evidence=evidence)
    elif machine.units_contradicted:
        chain.breaks(Reason.UNITS_CONTRADICTED)
    elif not machine.usable:
        chain.breaks(Reason.REFERENCE_INVALID)
    else:
        chain.passes(Enable.NO_FAULT)
    supplied = powered or statusword & StatusBit.VOLTAGE_ENABLED != 0
    if supplied:
        chain.passes(Enable.SUPPLY)
    elif (asks or not demand.connected) and machine.lacks_supply(state, unproven=commanded):
        chain.breaks(Reason.NO_SUPPLY, remedy=with_on(Reason.NO_SUPPLY.remedy) if again else Reason.NO_SUPPLY.remedy)
    if machine.interlock.is_local(statusword):
        own = axis.released and (machine.outputs.command.target_velocity or machine.executor.limit_side)
        panel = Reason.LOCAL_TURNS if axis.turns and not own else Reason.LOCAL_MODE
        chain.breaks(panel, remedy=with_on(panel.remedy) if again else panel.remedy)
    elif reason is Reason.INHIBITED and (found := axis.inhibited) is not None:
        chain.breaks(reason, found)
    elif reason in (Reason.MODE_NOT_CONFIRMED, Reason.MODE_KEPT, Reason.NOT_LEFT):
        chain.breaks(reason)
    elif state is State.OPERATION_ENABLED:
        chain.passes(Enable.OPERATION)
    elif commanded and (begin := machine.enters_since):
        limit = f"if it takes longer than {machine.settings.enter_ns / SECOND:g} s (enter_ms)"
        place = f"{limit}, check the brake, safe torque off (STO) and the enable input"
        evidence = "the drive opens its brake, or finds its commutation angle"
        chain.breaks(Reason.NOT_OPERATING, evidence=evidence, remedy=(Wait(""), place), since_ns=begin)
    elif commanded and state is not None and demand.power is not PowerWish.ON:
        local = "" if statusword & StatusBit.REMOTE else ", Statusword.9 = 0 (local mode?)"
        shown = f"ON is commanded, but the drive reports {state.value}{local}"
        chain.breaks(Reason.NOT_OPERATING, axis.unheard or Finding.of(Reason.NOT_OPERATING, shown))


def _sensor_notes(axis: Axis) -> Iterator[str]:
    """What G1 and G2 of an axis lack."""
    sensors = axis.machine.sensor, axis.machine.second_sensor
    for number, (words, encoder) in enumerate(zip(sensors, axis.encoders, strict=True), 1):
        if words is None:
            continue
        sensor = words.channel.sensor
        if encoder is not None and not encoder.good:
            yield f"G{number} has no position: {encoder.label}: {encoder.enable_status.text}"
        elif sensor.state in (SensorState.ERROR, SensorState.ACKNOWLEDGING):
            found = sensor_fault(sensor.error, encoder or axis, Acknowledge(f"G{number}_STW.15"))
            yield f"G{number}: {finding_text(found, axis.network.loop)}. {remedy_text(found.remedy)}"


def _check_command(chain: Chain, axis: Axis) -> None:
    """ON and setpoint of a PLC that has control."""
    phase, demand = axis.machine.interlock.phase, axis.machine.demand
    asked, reason = demand.power, axis.machine.outputs.reason
    missing = _STOPS.get(asked)
    if missing is None and asked not in _ASKS:
        missing = _PHASES.get(phase, Reason.SWITCHED_OFF)
    if missing is None and not axis.released:
        if (origin := axis.origins.present) is None:
            chain.breaks(Reason.NEEDS_OFF)
        else:
            evidence = f"ON ignored: {origin.evidence}"
            chain.breaks(Reason.NEEDS_OFF, origin, evidence=evidence, remedy=with_on(origin.remedy))
        return
    if missing in (Reason.COAST_STOP, Reason.QUICK_STOP) and _control_word(axis)[1] & 1 and not axis.powered:
        missing = Reason.HELD_OFF
    if missing is not None:
        cause = axis.cause if missing is Reason.SWITCHED_OFF else None
        if cause is None:
            chain.breaks(missing)
        else:
            fault = of_fault(cause.record)
            evidence, remedy = f"not acknowledged: {fault.evidence}", (*fault.remedy, _acknowledge(axis))
            chain.breaks(missing, fault, evidence=evidence, remedy=remedy)
        return
    chain.passes(Enable.ON_EDGE)
    if reason is Reason.SETPOINT_DISABLED and isinstance(demand, SpeedDemand) and demand.speed_wish is SpeedWish.FREEZE:
        chain.breaks(reason, evidence=_frozen_text(axis))
    elif reason is not None and reason.enable is Enable.SETPOINT:
        chain.breaks(reason, _order_of(chain, axis, reason))
    elif reason is None and axis.machine.executor.home_lost and axis.machine.executor.needs_home:
        more = ", and an absolute task runs without it"
        chain.breaks(Reason.HOME_LOST, evidence=_HOME_LOST, since_ns=axis.machine.executor.home_lost, more=more)
    elif (lag := lag_of(axis)) is not None and not any(reductions(axis)):
        chain.breaks(Reason.LAGS, lag)
    elif reason is None:
        chain.passes(Enable.SETPOINT)


def _order_of(chain: Chain, axis: Axis, reason: Reason) -> Finding:
    """A setpoint or an order: what it lacked, its bound or limit, its time; then bits without effect."""
    executor, bits, positioner = axis.machine.executor, _NAMED.get(reason, 0), axis.config.positioner
    keeps = axis.machine.settings.setpoint_enable is SetpointEnable.HOLD
    found = chain.found(reason, _KEEPS if keeps and reason is Reason.SETPOINT_DISABLED else "")
    others, more, todo = executor.ignored & ~bits, "", found.remedy
    if reason is Reason.FUNCTION_RUNS:
        more = f"; active now: {executor.lack(0).text}"
        todo = (*todo[:-1], Edge(_bits(others))) if others else todo
    elif bits and reason is not Reason.EARLY_EDGE:
        lack = executor.lack(bits)
        more = f": {lack.text}"
        edge = Edge(_bits(_control_word(axis)[1] & bits or bits), lack.zeros)
        todo = (Wait("for the end of the homing"), Bits((lack.holding,), 0), edge) if lack.holding else (edge,)
    elif reason is Reason.TASK_SPEED_ZERO and axis.telegram.number == _BLOCKS_ALONE:
        found = found._replace(evidence=_WITHOUT_MDI)
        todo = (Bits(("SATZANW.15",), 0), *todo[1:])
    elif reason is Reason.HOMING_METHOD and positioner is None:
        todo = (Give("HOMING_METHOD", "select a method that the drive supports in SATZANW"), *todo[1:])
    elif reason is Reason.TASK_BLOCK_UNKNOWN and not axis.config.block:
        todo = ("configure it in [[axis.block]]", *todo[1:])
    elif reason is Reason.AT_SOFTWARE_LIMIT and positioner is not None and (limits := positioner.software_limits):
        more = f": {limits[0]} to {limits[1]} LU"
    elif reason in AT_LIMIT and axis.drive.feedback.digital_inputs & _BOTH_SWITCHES == _BOTH_SWITCHES:
        todo = (_SWITCHES,)
    elif reason in AT_LIMIT and executor.limit_side and reason is not Reason.INTERNAL_LIMIT:
        stopped, free = ("positive", "negative") if executor.limit_side > 0 else ("negative", "positive")
        more = f", in {stopped} direction"
        order = f"the {free} direction is free: send a setpoint or a task in {free} direction"
        todo = (Give("other direction", order),)
    if others and reason is Reason.REJECTED:
        todo = (*todo, Edge(_bits(others)))
    if others:
        more = f"{more}; without effect: {_are_one(others)}"
    if reason in REFUSED_ORDERS and (record := chain.newest(FaultNumber.POSITIONER)):
        return found._replace(remedy=todo, more=more, since_ns=record.time_ns)
    return found._replace(remedy=todo, evidence=found.evidence + more)


def activity(axis: Axis) -> str:
    """What an axis does for a long time without a setpoint that shows it: homing; else empty."""
    executor = axis.machine.executor
    homes = executor.homes_since
    return f"homing since {clock(homes, axis.network.loop)}, no home position yet" if homes else ""


def _frozen_text(axis: Axis) -> str:
    """Evidence of a ramp that STW1.5 = 0 has stopped."""
    held = _speed(axis, "60FFh", axis.machine.outputs.command.target_velocity)
    setpoint = speed_setpoint_rpm(axis)
    ignored = "" if setpoint is None else f", setpoint {setpoint:.4g} rpm not followed"
    return f"ramp frozen (STW1.5 = 0): holds {held}{ignored}"


def _speed(axis: Axis, name: str, value: int) -> str:
    """The value of an object in rpm, or in its own units if they are unknown."""
    per_rpm = axis.scaling.velocity_per_rpm
    return f"{float(value / per_rpm):g} rpm" if per_rpm else f"{name} = {value}"


def _unstopped(axis: Axis) -> Finding | None:
    """A drive that turns and that no stop of the gateway stops; None while there is one left."""
    if not (since_ns := axis.machine.unstopped_since):
        return None
    speed = _speed(axis, "606Ch", axis.drive.feedback.velocity_actual)
    more = f", for {(axis.network.loop.now() - since_ns) // SECOND} s, with {speed}"
    text = "no stop of the gateway stops the drive: it turns"
    return Finding(Reason.SEVERE_FAULT, text, (_ONLY_WITHOUT_POWER,), since_ns=since_ns, more=more)


def _control_word(axis: Axis) -> tuple[str, int]:
    """Name and value of the first word of the PLC, STW1 or Controlword; 0 without a PLC."""
    return axis.telegram.setpoints.names[0], (axis.machine.inputs.setpoints or (0,))[0]


def _acknowledge(axis: Axis) -> Acknowledge:
    """What is missing for the acknowledge of a drive in fault."""
    machine, (name, word) = axis.machine, _control_word(axis)
    if machine.acknowledgement.pending:
        return Acknowledge(f"{name}.7", f"{name}.10", Hindrance.PENDING)
    no_control = machine.inputs.setpoints is not None and not machine.demand.in_control
    hindrance = hindrance_of(
        no_control, axis.acknowledged_in_vain, word & ControlBit.FAULT_RESET, machine.adapter.unheard
    )
    return Acknowledge(f"{name}.7", f"{name}.10", hindrance)


def notes(axis: Axis) -> list[str]:
    """What the drive shows or the PLC sends without an effect while no link is broken, and where the drive's positions end."""
    adapter, word = axis.machine.adapter, _control_word(axis)[1]
    found: list[str] = []
    is_speed = isinstance(adapter, SpeedAdapter)
    if isinstance(adapter, ControlWordAdapter) and (ones := _are_one(word & adapter.IGNORED)):
        speed = "; a negative setpoint turns backwards" if is_speed else ""
        found.append(f"without effect in telegram {axis.telegram.number}: {ones}{speed}")
    limited = axis.good and axis.drive.feedback.statusword & StatusBit.INTERNAL_LIMIT
    if limited and axis.machine.outputs.reason not in AT_LIMIT:
        found.append("the drive reports an internal limit (Statusword.11 = 1), which does not limit this motion")
    if is_speed and (bits := _bits(word & DEVICE_BITS)):
        found.append(f"sent to the drive as the same bits of the Controlword: {', '.join(bits)}")
    for item, raw in setpoints(axis):
        percent = item.percent(raw) if item.quantity in _SPEEDS else None
        if percent is not None and abs(percent) > _FULL:
            found.append(
                f"{item.name} is {value_text(item, raw)}: above 100 % the speed limits of the drive are in force"
            )
    loop, executor = axis.network.loop, axis.machine.executor
    if any(reductions(axis)) and (lag := lag_of(axis)) is not None:
        found.append(finding_text(lag, loop))
    if text := activity(axis):
        found.append(text)
    if executor.home_lost:
        found.append(f"{_HOME_LOST} at {clock(executor.home_lost, loop)}")
    found += _sensor_notes(axis)
    if executor.range_note:
        found.append(executor.range_note)
    return found


def _bits(word: int) -> tuple[str, ...]:
    """The set bits of STW1."""
    return tuple(f"STW1.{bit}" for bit in range(16) if word >> bit & 1)


def _are_one(word: int) -> str:
    """The same as text."""
    return ", ".join(f"{bit} = 1" for bit in _bits(word))
