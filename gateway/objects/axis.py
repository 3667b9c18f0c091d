"""An axis: the axis machine bound to a drive's client. It has no rules; see ``gateway.objects.drive_object``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final

from pdgw.ds301.aborts import SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import CONSUMER_HEARTBEAT, GUARD_TIME, LIFE_TIME_FACTOR
from pdgw.ds301.emcy import PDO_ERRORS
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.client import DriveClient, DriveStatus
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.drive_type import DriveFault, Scaling
from pdgw.dsp402.objects import (
    ABORT_OPTION,
    CONTROLWORD,
    DRIVE_OBJECTS,
    ERROR_CODE,
    HOMING_METHOD,
    MAX_TORQUE,
    MODE,
)
from pdgw.dsp402.states import ControlBit, StatusBit, enables, operates, state_of
from pdgw.dsp402.units.scaling import SCALING_OBJECTS
from pdgw.gateway.axis.demand_report import STATE_MASK
from pdgw.gateway.axis.executors.positions.tasks import PositionerExecutor
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.axis.supervision.drive_events import EMERGENCY_PATIENCE_NS, FAULTY, POWERED
from pdgw.gateway.axis.values import Configured, FaultRead, FaultRecord, Inputs, Outputs
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, By, FaultNumber
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.base.store import ConfirmedUnits
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.objects.drive_object import OWNED, DriveObject
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.objects.fault_buffer import ReportedFault
from pdgw.gateway.objects.inquiry import PATIENCE_NS, REMAP, UNFOLLOWED, Answer, LimitInquiry, ask, untaken
from pdgw.gateway.objects.origins import used_up
from pdgw.gateway.objects.sensor_link import ProbeReader, SensorLink
from pdgw.profidrive.sensor_format import SensorFormat
from pdgw.profidrive.sign_of_life import MONITORING_OFF
from pdgw.profidrive.telegrams import Telegram

_OWNED: Final = OWNED | {(ABORT_OPTION, 0), (GUARD_TIME, 0), (LIFE_TIME_FACTOR, 0), CONTROLWORD, MODE}
_REFERENCES: Final = {*SCALING_OBJECTS, HOMING_METHOD}
_SECOND_FORMAT: Final = SensorFormat(resolution=0, turns=0, xist1_absolute=False, valid=False)
"""Format of the drive's second encoder; its resolution is not read."""
_POWER_BITS: Final = 0x8F
"""Bits 0 to 3 and 7 of the Controlword, which a drive shows as they were sent."""
_NO_BRAKE: Final = Brake.NONE
_WITHHOLD_HEARTBEAT: Final = Brake.WITHHOLD_HEARTBEAT
"""A constant, because each access to a member of an enum is a look-up."""


class Axis(DriveObject):
    """A drive object (DO) with a drive."""

    kind: ClassVar[str] = "axis"
    warning_word: ClassVar[str] = "Statusword.7 = 1"

    def __init__(
        self,
        config: AxisConfig,
        network: CanNetwork,
        cycle_time_ms: float,
        number: int | None = None,
        sign_of_life_failures: int = MONITORING_OFF,
    ) -> None:
        number = config.telegram if number is None else number
        super().__init__(config.do_id, network, config.telegram_of(number))
        self.config: AxisConfig = config
        self.telegram_numbers = config.telegrams
        self._cycle_time_ms = cycle_time_ms
        drive_settings = self._drive_settings(number)
        reaction_ns = config.reaction_ns(number, cycle_time_ms)
        self._settings = replace(config.settings_at(cycle_time_ms), reaction_ns=reaction_ns)
        self.drive = DriveClient(
            network,
            drive_settings,
            config.drive_layout(number),
            self.on_node_event,
        )
        self.sign_of_life_tolerance = sign_of_life_failures
        """P925."""
        self.machine = self._make_machine(self.telegram)
        self._links: list[SensorLink | None] = [None, None]
        """The encoders that are G1 and G2."""
        self.units_witnessed: ConfirmedUnits | None = None
        """The stored result of the last axis test."""
        self._brake: Brake = _NO_BRAKE
        self._word = 0
        """The Controlword of the last step."""
        self.acknowledged_at = 0
        """When a fault reset was sent to the drive last."""
        self._probe = ProbeReader(self.drive, self._news)
        self._probing = False
        self._warning = self._lags_since = 0
        """P953, and ``AxisMachine.lags_since``, after the last step."""
        self._untaken: dict[tuple[int, int], Finding] = {}
        """The last Controlword that the drive did not take, by ``_place``."""
        self.limits = LimitInquiry(self.drive)
        self._sound_until = 0
        """When it was not in fault last."""

    def _drive_settings(self, number: int) -> DriveSettings:
        """Those of a telegram, with the values of the drive's files."""
        config = self.config
        return replace(config.drive_settings(number, self._cycle_time_ms), values=config.device_values("axis"))

    def _make_machine(self, chosen: Telegram) -> AxisMachine:
        machine = AxisMachine(chosen, self._settings, self.drive.feedback)
        machine.tolerate(self.sign_of_life_tolerance)
        self.drive.needs_last_stop = machine.needs_last_stop
        return machine

    def connect_sensor(self, encoder: EncoderObject, place: int) -> None:
        """This encoder's channel is G1 (``place`` 0) or G2 (1)."""
        link = SensorLink(encoder, place, self.do_id)
        self._links[place] = link
        link.connect(self.machine)

    @property
    def client(self) -> DriveClient:
        return self.drive

    @property
    def outputs(self) -> Outputs:
        return self.machine.outputs

    def on_node_event(self, notice: NodeNotice) -> None:
        super().on_node_event(notice)
        if notice.notice is Notice.UNITS_READ:
            self.references_changed()

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def step(self, setpoints: Sequence[int] | None, now: int) -> Outputs:
        drive, machine = self.drive, self.machine
        inputs = machine.inputs
        inputs.now = now
        inputs.setpoints = setpoints
        inputs.fresh = self.fresh
        inputs.gateway_stops = self.gateway_stops
        inputs.drive_ok = drive.refresh(now)
        inputs.set_point_refused = drive.rpdos.set_point_refused
        inputs.unacknowledged = not self.fault_log.acknowledged
        if machine.shows_codes:
            if not machine.in_fault:
                self._sound_until = now
            inputs.fault_code = self.fault_log.fault_code(self._sound_until - EMERGENCY_PATIENCE_NS)
        inputs.node_stopped = drive.heartbeat.stopped
        inputs.position_ns = drive.units.position_ns
        if drive.generation != self._generation:
            self._generation = drive.generation
            inputs.speed_asked_ns = inputs.position_asked_ns = 0
            inputs.position_old = False
            inputs.news.append(Configured(drive.drive_type, drive.homing_method))
        if drive.polls:
            self._read_ages(inputs)
        if self._news or self._future is not None:
            self._deliver(inputs.news)
        if machine.sensor is not None:
            self._step_links(now)
        if inputs.news:
            self._note_news(inputs.news)
        if setpoints is not None:
            self.last_setpoints = setpoints
        outputs = machine.step()
        word = outputs.command.controlword
        if word != self._word or self.stops:
            self._note_word(word, now)
        if self._probing or outputs.probe is not None:
            self._probing = self._probe.step(outputs.probe, now) or outputs.probe is not None
        events = outputs.events
        if events is not None or outputs.writes is not None or outputs.reason is not self._reported_reason:
            self.stops = self.stops or outputs.reason not in (None, self._reported_reason)
            self._serve(outputs)
        if outputs.warning != self._warning or machine.lags_since != self._lags_since:
            self._watch(outputs.warning, machine.lags_since)
        if outputs.released is not (self.origins.present is None):
            self._turn_origin(outputs, now)
        return outputs

    def _step_links(self, now: int) -> None:
        """One cycle of the axis' encoders."""
        for link in self._links:
            if link is not None:
                link.step(self.machine, now, self.note)

    def _note_word(self, word: int, now: int) -> None:
        """The Controlword has changed now, or in the step before: does it stop the drive, or acknowledge a fault?"""
        if word == self._word:
            self.stops = False
            return
        self._word = word
        self.stops = not operates(word)
        if word & ControlBit.FAULT_RESET:
            self.acknowledged_at = now

    def _watch(self, warning: int, lags_since: int) -> None:
        """The warnings or the lag of the axis have changed."""
        self._watch_warning(warning)
        if lags_since != self._lags_since:
            self._show_reason()
            if lags_since:
                self.limits.ask(self.network.loop.now())
        self._warning, self._lags_since = warning, lags_since

    def _turn_origin(self, outputs: Outputs, now: int) -> None:
        """The drive follows the PLC again, or something has begun a stop."""
        if outputs.released:
            self.origins.released(now)
        else:
            self.origins.present = self._origin()._replace(since_ns=now)

    def _read_ages(self, inputs: Inputs) -> None:
        """When the speed and the position were requested that are read by SDO."""
        speed, position = self.drive.polled_speed, self.drive.polled_position
        if speed is not None:
            inputs.speed_asked_ns, inputs.speed_until_ns = speed.asked_ns, speed.until_ns
        if position is not None:
            inputs.position_asked_ns, inputs.position_old = position.asked_ns, inputs.now > position.until_ns

    def _origin(self) -> Finding:
        """That of the stop of this step, if no fault of it is reported. Its time is left out."""
        interlock, reason = self.machine.interlock, self.machine.interlock.reason or Reason.NEEDS_OFF
        found = Finding(reason, reason.value, Reason.NEEDS_OFF.remedy, by=By.DRIVE)
        if self.gateway_stops:
            return found._replace(evidence=Reason.GATEWAY_STOPS.value, by=By.GATEWAY)
        if (fault := GATEWAY_FAULTS.get(interlock.cell.fault or 0)) is None:
            if reason is Reason.INHIBITED and self.inhibited is not None:
                return self.inhibited
            return found._replace(evidence=reason.past, by=By.PLC) if reason.past else found
        if fault is FaultNumber.PLC_LOST and (finding := self.link_finding()) is not None:
            return finding._replace(by=By.PLC, number=fault, last_ns=self.machine.inputs.now, times=1)
        evidence = fault.title
        if fault is FaultNumber.NODE_LOST:
            if self.machine.restart_asked:
                return found._replace(evidence="a parameter request has restarted the node (P970, P972)", by=By.PLC)
            evidence = ": ".join(filter(None, (evidence, self.drive.unconfirmed)))
        return found._replace(evidence=evidence, remedy=fault.remedy, by=fault.by, number=fault)

    @property
    def inhibited(self) -> Finding | None:
        """Why the drive has not followed ON in time; None if its state is unknown."""
        machine, word = self.machine, self.drive.feedback.statusword
        if (state := state_of(word)) is None:
            return None
        supply = bool(word & StatusBit.VOLTAGE_ENABLED) or not machine.lacks_supply(state, unproven=True)
        remote = bool(word & StatusBit.REMOTE)
        return self.unheard or used_up(state, machine.settings.enter_ns, supply=supply, remote=remote)

    def transmit(self, now: int) -> None:
        outputs, guarding = self.machine.outputs, self.drive.guarding
        # A drive that monitors the gateway by its RPDOs stops when they are missing.
        if outputs.brake is not _WITHHOLD_HEARTBEAT or guarding is None or not guarding.rpdos:
            self.drive.send(outputs.command, now, stop=self.stops)
        else:
            self.drive.withhold()
        if outputs.brake is not self._brake:
            self._brake = outputs.brake
            by_sync = outputs.brake is _WITHHOLD_HEARTBEAT and guarding is not None and guarding.sync
            self.network.sync.withhold(self.node_id, withheld=by_sync)
            if outputs.brake is not _NO_BRAKE:
                self.drive.stop_node()

    def _read_fault(self, drive: DriveClient) -> None:
        own = drive.drive_type.quirks.fault_number if drive.drive_type is not None else None
        numbers = []
        for address in (own, ERROR_CODE):
            try:
                numbers.append(0 if address is None else drive.sdo.read_number(*address))
            except (SdoAbortedError, SdoCommunicationError):
                numbers.append(0)  # the fault is reported without its number
        self._news.append(FaultRead(*numbers))

    # -- queries ----------------------------------------------------------------------------------------------------------

    def lasts(self, by: By) -> bool:
        if by is By.PLC:
            return not self.machine.demand.connected
        return not self.good if by in (By.NODE, By.BUS) else self.machine.in_fault

    @property
    def powered(self) -> bool:
        """The power stage may be on: the Statusword shows it, or operation is commanded and not shown yet."""
        return self.drive.status is DriveStatus.ONLINE and (
            state_of(self.drive.feedback.statusword) in POWERED or enables(self._word)
        )

    @property
    def turns(self) -> bool:
        """Its shaft is known to turn: faster than the standstill window."""
        inputs = self.machine.inputs
        return self.good and self.machine.usable and not inputs.standstill and not inputs.standstill_unknown

    @property
    def scaling(self) -> Scaling:
        """100 % of its quantities; everything is unknown before its drive was read."""
        drive_type = self.drive.drive_type
        return Scaling() if drive_type is None else drive_type.scaling

    def _record(self, record: FaultRecord) -> None:
        if not record.is_warning:
            self.machine.adapter.unheard = False
        super()._record(record)

    def _serve(self, outputs: Outputs) -> None:
        if outputs.reason is not self._reported_reason and outputs.reason in UNFOLLOWED:
            self.network.loop.call_later(PATIENCE_NS, self._ask_controlword)
        super()._serve(outputs)
        if outputs.events is not None and outputs.events.read_fault:
            self.drive.submit(self._read_fault)

    def _ask_controlword(self) -> None:
        """The drive does not follow ON: does it have the Controlword that was sent?"""
        sent, place = self._word, self._place
        if not self.good or self.outputs.reason not in UNFOLLOWED:
            return

        def compare(answer: Answer) -> None:
            if self._word == sent and answer.contradicts(CONTROLWORD, sent, _POWER_BITS):
                found = untaken(sent, answer.values.get(CONTROLWORD))
                self._untaken = {place: found}
                self.origins.prove(found._replace(since_ns=self.network.loop.now()))

        ask(self.drive, [CONTROLWORD], compare)

    @property
    def unheard(self) -> Finding | None:
        """That the drive does not take the gateway's RPDOs; None: nothing shows that."""
        for record in self.active_reports():
            if record.code in PDO_ERRORS:
                evidence = f"the drive does not process the gateway's RPDOs: {record.text}"
                return Finding(Reason.NOT_OPERATING, evidence, REMAP, by=By.DRIVE)
        return self._untaken.get(self._place)

    @property
    def _place(self) -> tuple[int, int]:
        """The state of the drive, as bits of the Statusword, and the number of the configuration of its node."""
        return self.drive.feedback.statusword & STATE_MASK, self._generation

    @property
    def acknowledged_in_vain(self) -> bool:
        """The drive got a fault reset since its fault began."""
        return self.acknowledged_at > self.machine.fault_began

    @property
    def cause(self) -> ReportedFault | None:
        origin = super().cause
        if state_of(self.drive.feedback.statusword) not in FAULTY:
            return origin
        own = self.fault_log.of_device(self.machine.fault_began - EMERGENCY_PATIENCE_NS)
        if own is not None and (self.acknowledged_in_vain or own.record.is_explained):
            return own  # what it follows from is over, or it follows from nothing
        present = self.origins.present
        return origin if present is not None and present.number in GATEWAY_FAULTS else own

    @property
    def encoders(self) -> list[EncoderObject | None]:
        """The encoders that are G1 and G2; None for a position of the drive."""
        return [None if link is None else link.encoder for link in self._links]

    @property
    def withholds_heartbeat(self) -> bool:
        """The drive follows no command: without the gateway's heartbeat its own abort option stops it."""
        return self.machine.outputs.brake is _WITHHOLD_HEARTBEAT

    def owns(self, index: int, subindex: int) -> bool:
        address = (index, subindex)
        executor = self.machine.executor
        if (
            address in _OWNED
            or (self.drive.guarding is not None and address == (CONSUMER_HEARTBEAT, self.drive.guarding.entry))
            or address in self.drive.zeroed
            or (address == MAX_TORQUE and isinstance(executor, PositionerExecutor) and executor.clamps)
        ):
            return True
        # The exchange with an online drive runs with or without a PLC, so a written value would be overwritten.
        commanded = () if self.drive.plan is None else self.drive.plan.commanded
        return any(address == entry.address for entry in commanded)

    def is_reference(self, index: int, subindex: int) -> bool:
        if (index, subindex) == MAX_TORQUE:
            return isinstance(self.machine.executor, PositionerExecutor)
        return (index, subindex) in _REFERENCES

    def read_references(self, client: NodeClient[Any]) -> None:
        self.drive.learn()
        self.drive.homing_method = self.drive.sdo.read_number(*HOMING_METHOD, signed=True)

    def references_changed(self) -> None:
        self._news.append(Configured(self.drive.drive_type, self.drive.homing_method, restarted=False))

    @property
    def sensor_formats(self) -> tuple[SensorFormat, ...]:
        """P979: what G1 and, where there is one, G2 is."""
        first, second = self.encoders
        formats = (self._own_format if first is None else first.sensor_format,)
        if self.machine.second_sensor is None:
            return formats
        return (*formats, _SECOND_FORMAT if second is None else second.sensor_format)

    @property
    def _own_format(self) -> SensorFormat:
        """The drive's own position, counted from power-on; not valid while the units of a revolution are unknown."""
        counts = self.scaling.counts_per_revolution
        if counts is None or counts.denominator != 1:
            return SensorFormat(0, turns=0, xist1_absolute=False, validity_static=False, valid=False)
        return SensorFormat(counts.numerator, turns=0, xist1_absolute=False)

    @property
    def manufacturer_faults(self) -> Mapping[int, DriveFault]:
        """The drive's own fault numbers, as far as its family is known."""
        return self.drive.drive_type.faults if self.drive.drive_type is not None else {}

    def set_sign_of_life_tolerance(self, failures: int) -> None:
        self.sign_of_life_tolerance = failures
        self.machine.tolerate(failures)
        self.note("tolerate", failures)

    def entry_size(self, index: int, subindex: int) -> tuple[int, bool]:
        entry = DRIVE_OBJECTS.entry(index, subindex)
        return entry.type.bits // 8, entry.type.char.islower()

    def change_telegram(self, number: int) -> None:
        chosen = self.config.telegram_of(number)
        machine = self._make_machine(chosen)
        machine.adopt(self.machine)
        self.machine = machine
        self.drive.reconfigure(self.config.drive_layout(number), self._drive_settings(number))
        self._telegram_changed(chosen)
        for link in self._links:
            if link is not None:
                link.connect(machine)
