"""The axis machine: one ``step`` is one cycle of one axis, from ``Inputs`` to ``Outputs``.

Daemon, replay and tests drive this one machine. Source: docs/translation.md.
"""

from __future__ import annotations

from typing import Final

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.dsp402.states import STATE_OF_STATUS, UNPOWERED, State, StatusBit, enables
from pdgw.gateway.axis.adapters.adapter import POWER_BITS, STOPS_WITHOUT_PLC
from pdgw.gateway.axis.demand_report import (
    SHOWN_FAULT,
    SHOWN_STATE,
    SHOWN_UNCOMMANDED,
    STATE_MASK,
    Demand,
    Flag,
    PowerWish,
    Report,
)
from pdgw.gateway.axis.executor_table import EXECUTORS
from pdgw.gateway.axis.executors.executor import AxisRecords
from pdgw.gateway.axis.executors.sensor import EncoderReferences, SensorWords, make_sensors
from pdgw.gateway.axis.executors.torque import DriveWords
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.power_states import CONTROLWORDS, Action, Drive, Phase
from pdgw.gateway.axis.settings import AxisSettings, Missing, missing, needed_quantities
from pdgw.gateway.axis.supervision.drive_events import Acknowledgement, DriveWatch, NodeWatch
from pdgw.gateway.axis.supervision.enable_guard import EnableGuard
from pdgw.gateway.axis.supervision.order_watch import OrderWatch
from pdgw.gateway.axis.supervision.polled_speed import PolledSpeed
from pdgw.gateway.axis.supervision.sign_of_life import SignOfLifeWords
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.axis.supervision.velocity_check import VelocityCheck
from pdgw.gateway.axis.telegrams import Kind, drive_telegram, make_adapter
from pdgw.gateway.axis.values import (
    Configured,
    FaultRead,
    Inputs,
    Outputs,
    PresetAnswer,
    ProbeAnswer,
    RestartAsked,
    SdoAnswer,
    gateway_fault,
)
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import DEVICE_WARNING, EMCY_WARNING, SET_NAMED, FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.sensor_states import SensorError
from pdgw.profidrive.telegrams import Telegram

_FOLLOWS: Final = ~(Flag.WITHIN_TOLERANCE | Flag.REACHED)
"""Without what a drive shows that follows its setpoint."""
_SET_POINT: Final = warning_bits(FaultNumber.SET_POINT)
_WITHOUT_CONTROL: Final = warning_bits(FaultNumber.CONTROL_LOST)
_ENABLE_OPERATION: Final = Action.ENABLE_OPERATION
_PASS: Final = Action.PASS
_HOLD: Final = PowerWish.HOLD
_NO_ORDER: Final = Order.NONE


class AxisMachine:
    """A drive axis with one telegram; GatewayError if no drive axis supports the telegram.

    The driver fills ``inputs`` before each ``step``. ``outputs`` has the result until the next step.
    """

    def __init__(self, chosen: Telegram, settings: AxisSettings, feedback: DriveFeedback) -> None:
        kind = drive_telegram(chosen).kind
        self.telegram = chosen
        self.settings = settings
        self.adapter = make_adapter(chosen, settings)
        self.inputs = Inputs(feedback)
        self.outputs = Outputs(len(self.telegram.actuals.signals), Reason.NO_PLC)
        self.demand: Demand = self.adapter.demand
        self.interlock = Interlock(settings)
        self._guard = EnableGuard()
        records = AxisRecords(settings, self.interlock, self.demand, self.inputs, self.outputs)
        self.executor = EXECUTORS[kind](records)
        self.sensor, self.second_sensor = make_sensors(settings, self.adapter.sensors, feedback, self.outputs.actuals)
        places = self.adapter.message, self.adapter.load, self.adapter.codes
        self._words = DriveWords(*places) if max(places) >= 0 else None
        self._node = NodeWatch(self.outputs, proven=False)
        self._drive = DriveWatch(self.outputs)
        self.acknowledgement = Acknowledgement()
        has_life = "STW2" in self.telegram.setpoints.names
        self.life = SignOfLifeWords(self.telegram, settings.sign_of_life_failures) if has_life else None
        self._evidence = evidence = TorqueEvidence(self.inputs, self.outputs)
        self._orders = OrderWatch(settings, self.interlock, self.inputs, self.outputs, evidence)
        self._stop = self._orders.stop
        self._check = VelocityCheck(settings.stop_time_ns, evidence)
        self._polled = PolledSpeed(self.inputs, self.outputs, settings.reaction_ns, settings.stop_time_ns)
        self._late = False
        """The drive does not follow an order in time."""
        self.lags_since = 0
        """Since when the axis does not follow its speed setpoint; 0 while it does."""
        self.units_contradicted = False
        """Its speed contradicts its units, which count as unknown until an acknowledgement."""
        self._follows_speed = kind in (Kind.SPEED, Kind.LOAD, Kind.TORQUE)
        self._needed = needed_quantities(self.telegram)
        self._converts = kind is Kind.POSITIONER or kind is Kind.DSC
        self.shows_codes = "FAULT_CODE" in self.telegram.actuals.names
        """The telegram has numbers of faults and warnings: ``Inputs`` has to have them."""
        self.usable = False
        """The drive is known: what 100 % is, and that it has the modes of the telegram."""
        self.in_fault = True
        """The drive is in fault, lost, or not known well enough. Beside this, ZSW1.3 shows faults that are not acknowledged."""
        self._control_lost = False
        """The PLC removed its control in operation and has not returned it."""

    def set_references(self, place: int, references: EncoderReferences | None) -> None:
        """Set the sensor format of an external G1 (``place`` 0) or G2 (1). With an impossible range its position is not valid;
        the next step reports fault 104."""
        sensor = self.second_sensor if place else self.sensor
        if sensor is not None:
            try:
                sensor.channel.set_references(references)
            except ProfidriveError as error:
                self.outputs.found.append((FaultNumber.REFERENCE, f"G{place + 1}: {error}"))

    @property
    def restart_asked(self) -> bool:
        """The gateway itself restarts the node."""
        return self._node.restart_asked

    def tolerate(self, failures: int) -> None:
        """Set P925, the number of consecutive failures of the sign of life, and restart the count."""
        if self.life is not None:
            self.life.tolerate(failures)

    def adopt(self, other: AxisMachine) -> None:
        """Continue after the machine of another telegram of the same drive; the interlock of the new one is locked."""
        self._node = other._node
        self._node.report_to(self.outputs)
        self.units_contradicted = other.units_contradicted

    @property
    def enters_since(self) -> int:
        """Since when the drive is Switched On and has to enter operation; 0 while it has not to."""
        return self._stop.began if self.interlock.cell.order is Order.ENTER else 0

    def needs_last_stop(self, velocity: int) -> bool:
        """Whether a drive that turns at this speed after an NMT stop must get Disable Voltage."""
        return self.usable and self._stop.needs_last_stop(velocity, self._orders.window, self.inputs.now)

    @property
    def unstopped_since(self) -> int:
        """Since when the drive has turned against its stops, when none is left; 0 otherwise."""
        inputs, stop = self.inputs, self._stop
        unstopped = stop.is_unstopped(inputs.feedback.velocity_actual, self._orders.window, inputs.now)
        return stop.ignored_at if unstopped and inputs.drive_ok else 0

    @property
    def fault_began(self) -> int:
        """When the drive showed its last fault, monotonic ns."""
        return self._drive.fault_began

    def lacks_supply(self, state: State | None, *, unproven: bool) -> bool:
        """As ``DriveWatch.lacks_supply``."""
        return self._drive.lacks_supply(state, unproven=unproven)

    # -- the step -----------------------------------------------------------------------------------------------------

    def step(self) -> Outputs:
        """One cycle; the object returned is the same each time."""
        outputs = self.outputs
        outputs.events = None
        if self.inputs.news:
            self._process_news()
        commanded = outputs.command.controlword
        known = self.usable and not self.units_contradicted
        wish = self._step_power(known, commanded)
        reason, flags, report = self._step_motion(known, wish)
        if self.sensor is not None:
            self._step_sensors(self.sensor)
        self._write_report(known, flags, report)
        self._supervise(known, commanded)
        self._write_notes(reason)
        return outputs

    def _step_power(self, known: bool, commanded: int) -> PowerWish | None:
        """The request of the PLC, which the interlock makes a command. ``known``: the drive's units are."""
        inputs, demand = self.inputs, self.demand
        setpoints, life = None if inputs.gateway_stops else inputs.setpoints, self.life
        if life is not None:
            if life.step(setpoints, self.outputs.actuals):
                detail = f"more than {life.counters.tolerated} frames (P925) in succession without the next counter"
                self.outputs.fault(gateway_fault(FaultNumber.SIGN_OF_LIFE, detail, inputs.now))
            if life.lost:
                setpoints = None
        self.adapter.read(setpoints)
        wish = demand.power if demand.connected else self._stop_without_plc()
        if not demand.in_control:
            self._without_control()
        elif self._control_lost:
            self._control_lost = False
        feedback = inputs.feedback
        statusword, standstill = feedback.statusword, False
        if known:
            if inputs.speed_asked_ns:
                wish = self._read_polled_speed(wish)
                standstill = inputs.standstill and self.interlock.cell.order is not _NO_ORDER
            else:
                window = self._orders.window
                inputs.standstill = standstill = -window <= feedback.velocity_actual <= window
            condition = None if inputs.drive_ok else Drive.LOST
        else:
            off = STATE_OF_STATUS[statusword & STATE_MASK] in UNPOWERED
            powered = not off or enables(commanded)  # which the Statusword may not show yet
            condition = Drive.POWERED_UNREAD if powered else Drive.NO_REFERENCES
        self.interlock.step(wish, demand.acknowledge, condition, statusword, standstill, inputs.now)
        return wish

    def _read_polled_speed(self, wish: PowerWish | None) -> PowerWish | None:
        """Standstill by answers to requests after the last order. A ramp that lasts too long with an unknown speed: OFF3."""
        polled, interlock, command = self._polled, self.interlock, self.outputs.command
        polled.step(interlock.cell.order, command.controlword, command.target_velocity, self._orders.window)
        if self._follows_speed and polled.is_old:
            self._late = True
        return polled.request(wish, self._stop.reference, ramps=interlock.phase is Phase.RAMP_STOP)

    def _step_motion(self, known: bool, wish: PowerWish | None) -> tuple[Reason | None, int, Report]:
        """The command to the drive and what it shows: why the axis does not do what the PLC requests, all flags, the values."""
        inputs, outputs, interlock, executor = self.inputs, self.outputs, self.interlock, self.executor
        statusword, cell = inputs.feedback.statusword, interlock.cell
        report = executor.step() if known else executor.refuse()
        reason = Reason.UNITS_CONTRADICTED if self.units_contradicted else report.reason
        flags = statusword & cell.visible
        if known and inputs.drive_ok:
            shown = SHOWN_STATE if cell.shown or self._stop.waits else SHOWN_UNCOMMANDED
            flags |= report.flags | shown[statusword & STATE_MASK]
        else:
            flags |= SHOWN_FAULT
            if not inputs.drive_ok:
                executor.lost()
                reason = reason if known else Reason.DRIVE_OFFLINE
        if not self.demand.in_control:
            reason = Reason.CONTROL_HELD if self.demand.power is _HOLD and interlock.operates else Reason.NO_CONTROL
        if not self._guard.step(wish, outputs.command.controlword):
            self._stop_unasked(inputs.now)
            reason, flags = (
                Reason.NEEDS_OFF,
                statusword & Flag.OF_THE_DRIVE | SHOWN_UNCOMMANDED[statusword & STATE_MASK],
            )
        self.in_fault = flags & SHOWN_FAULT != 0
        if inputs.unacknowledged:
            flags |= SHOWN_FAULT
        if self._late:
            flags &= _FOLLOWS
        if self._node.unproven:
            self._node.step(inputs.now)
        outputs.warning = warning = self._warnings()
        return reason, flags | Flag.WARNING if warning else flags, report

    def _warnings(self) -> int:
        """P953."""
        warning = self.outputs.warned | self._evidence.warning
        if self._node.warnings:
            warning |= EMCY_WARNING
        if self.inputs.drive_ok and self.inputs.feedback.statusword & StatusBit.WARNING:
            warning |= DEVICE_WARNING
        if self.inputs.set_point_refused:
            warning |= _SET_POINT
        return warning | _WITHOUT_CONTROL if self._control_lost else warning

    def _write_report(self, known: bool, flags: int, report: Report) -> None:
        """The actual values of the telegram."""
        inputs, outputs = self.inputs, self.outputs
        self.adapter.write(flags, report, outputs.actuals)
        if self._words is not None:
            self._words.step(flags, inputs, outputs, known=known)
        outputs.good = inputs.drive_ok
        outputs.released = self.interlock.released

    def _supervise(self, known: bool, commanded: int) -> None:
        """Speed and state of the drive, its stops in time, the end of a fault. ``commanded``: the Controlword that it has."""
        inputs, outputs, drive, cell = self.inputs, self.outputs, self._drive, self.interlock.cell
        feedback, command, action = inputs.feedback, outputs.command, cell.action
        statusword, velocity, now = feedback.statusword, feedback.velocity_actual, inputs.now
        operating = action is _ENABLE_OPERATION or action is _PASS
        if known and self._check.is_due(operating, velocity, now):
            speeds = self.executor.speeds()
            asked = inputs.speed_asked_ns or now
            found = self._check.step(speeds, velocity, feedback.position_actual, inputs.position_ns, asked)
            self._orders.read_setpoint(command.controlword, speeds, self.executor.slowest)
            self._late = self._stop.late or self._check.is_late(now)
            self.lags_since = self._check.lags_since(now)
            if self._evidence.warning:
                self._evidence.step()
            if found is not None:
                self.units_contradicted = found[0] is FaultNumber.VELOCITY
                outputs.found.append(found)
        elif self.lags_since and not (known and operating):
            self.lags_since = 0
        shown = statusword & STATE_MASK if inputs.drive_ok else 0
        if shown != drive.shown:
            drive.changed(self._node, shown, statusword, commanded, self.interlock, now)
            if inputs.drive_ok:
                outputs.known_off = STATE_OF_STATUS[statusword & STATE_MASK] in UNPOWERED
            elif enables(commanded):
                outputs.known_off = False  # it may have received Enable Operation and not shown it
        if drive.fault_since:
            drive.step(self._node, now)
        order = cell.order
        if order:
            self._orders.begin()
        elif action is _ENABLE_OPERATION:
            order = self._orders.order
        if order or self._stop.began >= 0:
            if self._orders.step(order) is FaultNumber.VELOCITY:
                self.units_contradicted = True
            self._late = self._stop.late
        if self.demand.acknowledge or self.acknowledgement.waits:
            self._acknowledge()

    def _acknowledge(self) -> None:
        """The fault buffer moves on when the PLC acknowledged, and the drive has left its fault."""
        inputs, outputs, demand = self.inputs, self.outputs, self.demand
        state = STATE_OF_STATUS[inputs.feedback.statusword & STATE_MASK]
        faulty = state not in UNPOWERED if self.units_contradicted else self.in_fault
        if self.acknowledgement.step(demand.connected and demand.acknowledge, inputs.drive_ok, faulty, inputs.now):
            outputs.happened().acknowledged = True
            outputs.no_drive_error()
            self._node.acknowledged()
            self._drive.acknowledged()
            self.units_contradicted = False

    def _write_notes(self, reason: Reason | None) -> None:
        """The reason, and what this step has found."""
        outputs = self.outputs
        if reason is None and self.inputs.set_point_refused:
            reason = Reason.SET_POINT_REFUSED
        if self._stop.waits:
            reason = Reason.NOT_LEFT
        outputs.reason = reason
        if outputs.found:
            for number, detail in outputs.found:
                outputs.fault(gateway_fault(number, detail, self.inputs.now))
            outputs.found.clear()

    def _stop_unasked(self, now: int) -> None:
        """The last line: an Enable Operation that the PLC did not ask for is not sent."""
        command = self.outputs.command
        detail = f"Controlword {command.controlword:04X}h, Statusword {self.inputs.feedback.statusword:04X}h"
        command.controlword = CONTROLWORDS[Action.QUICK_STOP]
        command.target_velocity = command.target_torque = 0
        self.interlock.distrust(now)
        self.outputs.fault(gateway_fault(FaultNumber.ENABLE_UNASKED, detail, now))

    def _without_control(self) -> None:
        """STW1.10 = 0: if control is removed in operation, stop the axis and report it."""
        demand, interlock = self.demand, self.interlock
        interlock.notice_plc()
        if interlock.operates and demand.connected and demand.power is not _HOLD and not self._control_lost:
            self._control_lost = True
            self.outputs.found.append((FaultNumber.CONTROL_LOST, "STW1.10 = 0"))

    def _stop_without_plc(self) -> PowerWish | None:
        """OFF2 or OFF3 in a frame that does not count otherwise: without control after a loss, without sign of life, or while
        the gateway stops."""
        setpoints = self.inputs.setpoints
        return None if setpoints is None else STOPS_WITHOUT_PLC[setpoints[0] & POWER_BITS]

    def _step_sensors(self, sensor: SensorWords) -> None:
        inputs, outputs, demand, second = self.inputs, self.outputs, self.demand, self.second_sensor
        lost = self.life is not None and self.life.lost
        error = SensorError.CONTROLLER_SIGN_OF_LIFE if lost else None
        sensor.step(demand, inputs, error, outputs.actuals)
        outputs.probe, outputs.presets[0] = sensor.probe, sensor.channel.preset_write
        if second is not None:
            second.step(demand, inputs, error, outputs.actuals)
            outputs.presets[1] = second.channel.preset_write

    # -- events since the last cycle ----------------------------------------------------------------------------------

    def _process_news(self) -> None:
        inputs, outputs = self.inputs, self.outputs
        for item in inputs.news:
            match item:
                case NodeNotice(notice=Notice.OFF):
                    outputs.known_off = True
                case NodeNotice(notice=Notice.UNITS_CHANGED):
                    self.units_contradicted = True
                    outputs.found.append((FaultNumber.VELOCITY, item.text))
                case NodeNotice():
                    self._node.process(item)
                case Configured():
                    if item.restarted:
                        self.interlock.restarted()
                        self.executor.restarted()
                    self._set_drive(item.drive_type, item.homing_method)
                case SdoAnswer():
                    if outputs.writes == item.writes:
                        outputs.writes = None
                        self.executor.sdo_done(item.error)
                case PresetAnswer():
                    for sensor in (self.sensor, self.second_sensor):
                        if sensor is not None:
                            sensor.answered(item)
                case ProbeAnswer():
                    (self.executor if self.sensor is None else self.sensor).probed(item)
                case FaultRead():
                    self._drive.fault_read(item, inputs.feedback, self._node.fault_of_number, inputs.now)
                    self._node.set_error_code(item.code)
                case RestartAsked():
                    self._node.restart_asked = True
        inputs.news.clear()

    def lacking(self, drive: DriveType, homing_method: int) -> str:
        """Why this drive cannot be operated with the telegram; empty when it can, and the executor works for it from now on."""
        refusal = self.missing(drive).text or drive.uncorrected
        if not refusal:
            try:
                self.executor.set_drive(drive, homing_method)
            except (CanopenError, GatewayError, ProfidriveError) as error:
                refusal = str(error)
        return refusal

    def missing(self, drive: DriveType) -> Missing:
        """Everything the telegram lacks of the drive's units, with the keys that give it."""
        return missing(drive.scaling, self._needed, converts=self._converts)

    def _set_drive(self, drive: DriveType | None, homing_method: int) -> None:
        """Set the drive. One with unknown 100 % values or without a needed mode blocks operation (fault 104)."""
        self.usable = False
        if drive is None:
            return
        self._node.set_drive(drive.faults, drive.fault_of_code)
        refusal = self.lacking(drive, homing_method)
        if refusal:
            lacks = self.missing(drive)
            text, remedy = (lacks.why, lacks.remedy or SET_NAMED) if lacks.why else (refusal, "")
            self.outputs.fault(gateway_fault(FaultNumber.REFERENCE, text, self.inputs.now, remedy=remedy))
            return
        window = max(1, int(drive.scaling.reference(Quantity.SPEED) * self.settings.standstill_window))
        self._check.set_drive(drive.scaling, window)
        self._orders.set_drive(drive.scaling, window, self._check.counts_per_unit)
        if self._words is not None:
            self._words.set_drive(drive)
        if self.sensor is not None and not self.settings.g1_is_encoder:
            self.sensor.set_span(drive.scaling.position_span)
        self.usable = True
