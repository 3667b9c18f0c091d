"""The chain of enables of a drive object: each link with its state, its evidence and its remedy.

Each link is checked by itself. The first broken link gives reason, remedy and state word. Physical links are first (bus, node,
supply, fault), then the drive, then the PLC's program. Status, page, metrics, MQTT, log and JSON show the result of this module
and derive nothing themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.health import Outage
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.states import ControlBit, State, StatusBit, state_of
from pdgw.gateway.axis.adapters.adapter import ControlWordAdapter
from pdgw.gateway.axis.adapters.speed_words import DEVICE_BITS, SpeedAdapter
from pdgw.gateway.axis.demand_report import PowerWish, SpeedDemand, SpeedWish
from pdgw.gateway.axis.power_states import Phase
from pdgw.gateway.axis.settings import SetpointEnable
from pdgw.gateway.axis.supervision.drive_events import FAULTY, POWERED
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.finding_text import clock, finding_text
from pdgw.gateway.base.reasons import DEVICE_WARNING, REFUSED_ORDERS, AxisState, Enable, FaultNumber, Finding, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.base.steps import (
    Acknowledge,
    Bits,
    Edge,
    Give,
    Hindrance,
    Remedy,
    Wait,
    with_on,
)
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.bit_effects import AT_LIMIT, bit_effects
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.enable_status import ChainLink, EnableStatus
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.objects.inquiry import SENDS_NOTHING, UNFOLLOWED
from pdgw.gateway.objects.lag import lag_of, reductions, setpoints, speed_setpoint_rpm
from pdgw.gateway.objects.origins import of_fault
from pdgw.profidrive.encoder import (
    ENCODER_ACKNOWLEDGE,
    SENSOR_ACKNOWLEDGE,
    SENSOR_ERROR_TEXTS,
    SensorError,
    SensorState,
)
from pdgw.profidrive.signal_text import value_text
from pdgw.profidrive.signals import SignalQuantity
from pdgw.profidrive.words import unswapped

_WRONG_NODE_ID: Final = (
    "compare the node-ID of the device with the configuration (pdgw bus scan); check power, CAN cable and bit rate"
)
_ONE_WAY: Final = "its frames arrive, and it answers no SDO request: the interface may send nothing"
_CONSUMER: Final = (
    "the heartbeat consumer of the drive (1016h) stays in error (8130h), although the gateway sends its heartbeat"
)
"""A fault of a drive that acknowledging does not end."""
_ARM: Final = "restart the node (P972, or power off and on), which arms the consumer again"
_ENCODER_WARNINGS: Final = (
    "it turned faster than its sensor can follow",
    "its light source is nearly worn out: plan its replacement",
    "its watchdog has restarted its processor",
    "its operating time has reached its limit: plan its replacement",
    "its battery is nearly empty: change the battery",
    "its reference point has not been reached",
)
"""The bits of 6505h, from 0 on."""
_SWITCHES: Final = "both limit switches are active: check their supply, plug and cable"
_BOTH_SWITCHES: Final = 3
"""60FDh.0 and .1."""
_ONLY_WITHOUT_POWER: Final = "only safe torque off (STO) or switching its supply off stops it"
_HOME_LOST: Final = "the home position was lost with the drive"
_KEEPS: Final = "the last setpoint stays"
_WITHOUT_MDI: Final = "the task had MDI (SATZANW.15 = 1), which this telegram does not have: it was not started"
AXIS_CHAIN: Final = tuple(enable for enable in Enable if enable is not Enable.SENSOR)
ENCODER_CHAIN: Final = (Enable.BUS, Enable.NODE, Enable.NO_FAULT, Enable.PLC, Enable.CONTROL, Enable.SENSOR)
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


_OWN_FAULTS: Final = {
    Reason.HOMING_METHOD: FaultNumber.HOMING_METHOD,
    Reason.HOMING_REFUSED: FaultNumber.HOMING_PARAMETERS,
    Reason.REFERENCE_INVALID: FaultNumber.REFERENCE,
    Reason.UNITS_CONTRADICTED: FaultNumber.VELOCITY,
    Reason.TASK_TARGET_RANGE: FaultNumber.POSITIONER,
    Reason.TASK_DRIVE_RANGE: FaultNumber.POSITIONER,
    Reason.SOFTWARE_LIMIT: FaultNumber.POSITIONER,
}
"""Reasons whose details are in a fault or warning of the gateway."""


class _Chain:
    """The links of one drive object while they are checked."""

    def __init__(self, item: DriveObject, enables: tuple[Enable, ...], **shown: int) -> None:
        """``shown``: words of the device."""
        self.item = item
        self._words = dict(zip(item.telegram.setpoints.names, item.last_setpoints or (), strict=False)) | shown
        self._links = {enable: ChainLink(enable, None) for enable in enables}

    def passes(self, enable: Enable) -> None:
        self._links[enable] = ChainLink(enable, True)

    def breaks(self, reason: Reason, found: Finding | None = None, **changes: Any) -> None:
        """The link of a reason is broken by what is found, else by the reason alone. ``changes``: fields of the finding."""
        found = (found or self.found(reason))._replace(**changes)
        self._links[reason.enable] = ChainLink(reason.enable, False, reason, found, self.item.client.loop)

    def found(self, reason: Reason, effect: str = "") -> Finding:
        """A reason with its fault or warning of the gateway, or with the bits that give it, which may have another effect."""
        found = bit_effects(reason, self._words, effect)
        record = self.newest(number) if (number := _OWN_FAULTS.get(reason)) is not None else None
        if record is None:
            return found
        return found._replace(evidence=record.text, remedy=(record.remedy,) if record.remedy else found.remedy)

    def newest(self, number: FaultNumber) -> FaultRecord | None:
        """The last fault or warning of this number."""
        return next((record for record in reversed(self.item.faults) if record.number == number), None)

    def check_node(self, offline: Reason) -> bool:
        """Bus and node; False if the device cannot be checked."""
        network, client = self.item.network, self.item.client
        if (found := network.disturbance) is not None and not (network.healthy and self.item.good):
            stays = found in (network.flood, Outage.STAYS_OFF, Outage.QUIET)
            again = () if stays else ("the gateway connects again by itself",)
            evidence = f"bus {network.name}: {found.text}"
            self.breaks(Reason.BUS_LOST, evidence=evidence, remedy=(found.remedy, *again))
            return False
        self.passes(Enable.BUS)
        if self.item.good:
            self.passes(Enable.NODE)
            return True
        evidence, remedy = client.refusal or client.cause
        there, origin, times = f"on bus {network.name}", self.item.origins.present, None
        reason = Reason.NODE_CONFIGURING
        todo: Remedy = (remedy,) if remedy else ()
        match client.status:
            case NodeStatus.REFUSED | NodeStatus.CONFIGURING if client.refusal:
                reason, evidence = Reason.NODE_REFUSED, f"is rejected: {evidence}"
            case NodeStatus.CONFIGURING:
                evidence, todo = f"is being configured{client.progress and f': {client.progress}'}", ()
                if origin is not None and origin.number:
                    times, evidence, todo = origin, f"{evidence}, after: {origin.evidence}", origin.remedy
            case NodeStatus.ONLINE | NodeStatus.LOST if client.unconfirmed:
                reason, evidence, todo = Reason.NODE_WRITTEN, f"is being checked: {client.unconfirmed}", ()
            case NodeStatus.ONLINE:
                reason, evidence, todo = offline, f"{there} sends no data in time", ()
            case _ if client.is_first_request:
                evidence, todo = "has not answered yet", ()
            case NodeStatus.OFFLINE | NodeStatus.LOST if others := network.unconfigured(
                client.received_ns if client.status is NodeStatus.LOST else 0
            ):
                also = f"also heard on this bus and not in the configuration: node {', '.join(map(str, others))}"
                reason, evidence, todo = offline, f"{there}: {evidence}; {also}", (_WRONG_NODE_ID,)
            case NodeStatus.OFFLINE if network.loop.now() - (client.received_ns or -SECOND) < SECOND:
                reason, evidence, todo = offline, f"{there}: {_ONE_WAY}", SENDS_NOTHING.remedy
            case _:
                if origin is not None and origin.number == FaultNumber.NODE_LOST and origin.times > 1:
                    times, evidence = origin, origin.evidence
                reason, evidence = offline, f"{there}: {evidence}"
        node = self.item.node_id
        self.breaks(reason, times, node=node, evidence=evidence, remedy=todo or reason.remedy)
        return False

    def check_severe(self, acknowledge: Acknowledge, unstopped: Finding | None) -> None:
        """A severe fault comes before everything else until it is acknowledged, after what it follows from.

        ``unstopped``: that no stop is left for a drive that turns.
        """
        origin, severe = self.item.origins.present, self.item.origins.severe
        if unstopped is not None:
            self.breaks(Reason.SEVERE_FAULT, unstopped, remedy=(*unstopped.remedy, acknowledge))
        elif severe is None:
            return
        else:
            remedy = (*severe.remedy, acknowledge)
            if origin is not None and origin.number not in (0, severe.number) and origin.period[0] <= severe.period[0]:
                severe = origin._replace(more=f"; then: {severe.evidence}")
            self.breaks(Reason.SEVERE_FAULT, severe, remedy=remedy)
        self._links = {Enable.NO_FAULT: self._links.pop(Enable.NO_FAULT)} | self._links

    def check_plc(self, *, connected: bool, in_operation: bool, never: Reason, lost: bool) -> bool:
        """Whether its setpoints count. ``in_operation``: the object follows a connected PLC."""
        finding = self.item.link_finding()
        if finding is not None and finding.reason in (Reason.OTHER_SENDER, Reason.PLC_LOST) and (connected or lost):
            finding = None  # another sender does not stop the PLC, and a loss is in the faults
        if connected and in_operation:
            finding = None  # repeated losses, which are over
        if self.item.gateway_stops:
            other = self.newest(FaultNumber.OTHER_MASTER)
            self.breaks(Reason.GATEWAY_STOPS, None if other is None else of_fault(other), since_ns=None)
        elif finding is not None:
            self.breaks(finding.reason, finding)
        elif connected:
            self.passes(Enable.PLC)
        elif lost and (record := self.newest(FaultNumber.PLC_LOST)):
            self.breaks(Reason.PLC_LOST, of_fault(record), remedy=Reason.PLC_LOST.remedy)
        else:
            self.breaks(Reason.PLC_LOST if lost else never)
        return connected and not self.item.gateway_stops

    def keep(self, reason: Reason | None) -> None:
        """A reason of the machine also breaks a link, unless a broken link explains it already."""
        if reason is not None and all(link.ok is not False for link in self._links.values()):
            self.breaks(reason)

    def enable_status(self, instead: AxisState | None = None) -> EnableStatus:
        """``instead``: of a shaft that turns or has power; a fault stays one."""
        chain = tuple(self._links.values())
        broken = next((link.reason for link in chain if link.reason is not None), None)
        if broken is None:
            return EnableStatus(AxisState.OBEYS, chain)
        return EnableStatus(broken.state if instead is None or broken.state is AxisState.FAULT else instead, chain)


def axis_enable_status(axis: Axis) -> EnableStatus:
    """Chain of an axis after its last step."""
    machine, feedback = axis.machine, axis.drive.feedback
    shown = {"Statusword": feedback.statusword, "60FDh": feedback.digital_inputs}
    chain = _Chain(axis, AXIS_CHAIN, **shown)
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


def _check_drive(chain: _Chain, axis: Axis, state: State | None) -> None:
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


def _sensor_fault(error: SensorError | None, source: DriveObject, acknowledge: Acknowledge) -> Finding:
    """A sensor error; None: the fault of an encoder. ``source``: whose position it has."""
    cause, origin = source.cause, source.origins.present
    if cause is not None and cause.record.of_device:
        origin = of_fault(cause.record)
    elif error not in (None, SensorError.SENSOR_GROUP):
        origin = None
    found = origin or Finding(Reason.SENSOR_ERROR, "", ("remove the cause",))
    todo: Remedy = (*found.remedy, acknowledge)
    if error is SensorError.COMMAND_NOT_SUPPORTED:
        todo = (Give("G1_STW", "send G1_STW without this command"), acknowledge)
    what = f"sensor error {error:04X}h, {SENSOR_ERROR_TEXTS[error]}" if error else ""
    return found._replace(evidence=": ".join(filter(None, (what, found.evidence))), remedy=todo)


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
            found = _sensor_fault(sensor.error, encoder or axis, Acknowledge(f"G{number}_STW.15"))
            yield f"G{number}: {finding_text(found, axis.network.loop)}. {remedy_text(found.remedy)}"


def _check_command(chain: _Chain, axis: Axis) -> None:
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


def _order_of(chain: _Chain, axis: Axis, reason: Reason) -> Finding:
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
    hindrance = _hindrance(
        no_control, axis.acknowledged_in_vain, word & ControlBit.FAULT_RESET, machine.adapter.unheard
    )
    return Acknowledge(f"{name}.7", f"{name}.10", hindrance)


def _acknowledge_encoder(encoder: EncoderObject) -> Acknowledge:
    """What is missing for the acknowledge of an encoder in fault: first of its sensor error, then of its fault."""
    machine, sensor = encoder.machine, encoder.machine.channel.sensor
    adapter, control = machine.adapter, machine.control
    no_control = adapter.control is not None and not control.has_control
    if not machine.in_error:
        level = (adapter.control or 0) & ENCODER_ACKNOWLEDGE
        bit, hindrance = "STW2_ENC.7", _hindrance(no_control, control.in_vain, level, control.unheard)
    else:
        level = (adapter.sensor_word or 0) & SENSOR_ACKNOWLEDGE
        bit, hindrance = "G1_STW.15", _hindrance(no_control, sensor.in_vain, level, unheard=False)
        if level and sensor.state is SensorState.ACKNOWLEDGING and not sensor.in_vain:
            hindrance = Hindrance.UNFINISHED
    return Acknowledge(bit, "STW2_ENC.10", hindrance)


def _hindrance(no_control: bool, in_vain: bool, level: int, unheard: bool) -> Hindrance:
    """Why an acknowledge has had no effect. ``in_vain``: an edge came while the cause was there. ``level``: its bit."""
    if no_control:
        return Hindrance.NO_CONTROL
    if in_vain:
        return Hindrance.IN_VAIN
    if level:
        return Hindrance.LEVEL
    return Hindrance.UNHEARD if unheard else Hindrance.NONE


def device_warning(item: DriveObject) -> str:
    """The newest active warning that the device itself reports, or of its speed; empty without one."""
    for record in item.active_reports():
        of_device = record.of_device or record.number == FaultNumber.VELOCITY_DEVIATES
        if record.is_warning and of_device:
            return f"warning {record.number}: {record.text}"
    if not item.outputs.warning & DEVICE_WARNING:
        return ""
    shown = item.input.warnings if isinstance(item, EncoderObject) else 0
    if texts := [f"6505h.{bit} = 1: {text}" for bit, text in enumerate(_ENCODER_WARNINGS) if shown >> bit & 1]:
        return f"warning of the device: {'; '.join(texts)}"
    return f"warning of the device ({item.warning_word}) without an EMCY: see its manual"


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


def encoder_enable_status(encoder: EncoderObject) -> EnableStatus:
    """Chain of an encoder after its last step."""
    chain, machine = _Chain(encoder, ENCODER_CHAIN), encoder.machine
    reason = machine.outputs.reason
    if chain.check_node(Reason.ENCODER_OFFLINE):
        error = machine.channel.sensor.error if machine.in_error else None
        if machine.in_error or machine.control.fault:
            kind = Reason.SENSOR_ERROR if machine.in_error else Reason.ENCODER_FAULT
            found = _sensor_fault(error, encoder, _acknowledge_encoder(encoder))
            chain.breaks(kind, found, evidence=found.evidence or kind.value)
        elif not machine.usable:
            chain.breaks(Reason.REFERENCE_INVALID)
        else:
            chain.passes(Enable.NO_FAULT)
            if reason is not None and reason.enable is Enable.SENSOR:
                chain.breaks(reason)
            else:
                chain.passes(Enable.SENSOR)
    connected = machine.adapter.control is not None
    has_control = machine.control.has_control
    if chain.check_plc(connected=connected, in_operation=has_control, never=Reason.ENCODER_NO_PLC, lost=False):
        if has_control:
            chain.passes(Enable.CONTROL)
        else:
            chain.breaks(Reason.ENCODER_NO_CONTROL)
    chain.keep(reason)
    return chain.enable_status()
