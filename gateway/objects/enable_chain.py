"""The chain of enables of a drive object: each link with its state, its evidence and its remedy.

Each link is checked by itself. The first broken link gives reason, remedy and state word. Physical links are first (bus, node,
supply, fault), then the drive, then the PLC's program. Status, page, metrics, MQTT, log and JSON show the result of this module
and derive nothing themselves.
"""

from __future__ import annotations

from typing import Any, Final

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.health import Outage
from pdgw.ds301.node.node import NodeStatus
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import DEVICE_WARNING, FaultNumber
from pdgw.gateway.base.reasons import AxisState, Enable, Finding, Reason
from pdgw.gateway.base.steps import Acknowledge, Give, Hindrance, Remedy
from pdgw.gateway.objects.bit_effects import bit_effects
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.enable_status import ChainLink, EnableStatus
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.objects.inquiry import SENDS_NOTHING
from pdgw.gateway.objects.origins import of_fault
from pdgw.profidrive.encoder import ENCODER_ACKNOWLEDGE, SENSOR_ACKNOWLEDGE
from pdgw.profidrive.sensor_states import SENSOR_ERROR_TEXTS, SensorError, SensorState

_WRONG_NODE_ID: Final = (
    "compare the node-ID of the device with the configuration (pdgw bus scan); check power, CAN cable and bit rate"
)
_ONE_WAY: Final = "its frames arrive, and it answers no SDO request: the interface may send nothing"
_ENCODER_WARNINGS: Final = (
    "it turned faster than its sensor can follow",
    "its light source is nearly worn out: plan its replacement",
    "its watchdog has restarted its processor",
    "its operating time has reached its limit: plan its replacement",
    "its battery is nearly empty: change the battery",
    "its reference point has not been reached",
)
"""The bits of 6505h, from 0 on."""
AXIS_CHAIN: Final = tuple(enable for enable in Enable if enable is not Enable.SENSOR)
ENCODER_CHAIN: Final = (Enable.BUS, Enable.NODE, Enable.NO_FAULT, Enable.PLC, Enable.CONTROL, Enable.SENSOR)
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


class Chain:
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


def sensor_fault(error: SensorError | None, source: DriveObject, acknowledge: Acknowledge) -> Finding:
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


def hindrance_of(no_control: bool, in_vain: bool, level: int, unheard: bool) -> Hindrance:
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


def encoder_enable_status(encoder: EncoderObject) -> EnableStatus:
    """Chain of an encoder after its last step."""
    chain, machine = Chain(encoder, ENCODER_CHAIN), encoder.machine
    reason = machine.outputs.reason
    if chain.check_node(Reason.ENCODER_OFFLINE):
        error = machine.channel.sensor.error if machine.in_error else None
        if machine.in_error or machine.control.fault:
            kind = Reason.SENSOR_ERROR if machine.in_error else Reason.ENCODER_FAULT
            found = sensor_fault(error, encoder, _acknowledge_encoder(encoder))
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


def _acknowledge_encoder(encoder: EncoderObject) -> Acknowledge:
    """What is missing for the acknowledge of an encoder in fault: first of its sensor error, then of its fault."""
    machine, sensor = encoder.machine, encoder.machine.channel.sensor
    adapter, control = machine.adapter, machine.control
    no_control = adapter.control is not None and not control.has_control
    if not machine.in_error:
        level = (adapter.control or 0) & ENCODER_ACKNOWLEDGE
        bit, hindrance = "STW2_ENC.7", hindrance_of(no_control, control.in_vain, level, control.unheard)
    else:
        level = (adapter.sensor_word or 0) & SENSOR_ACKNOWLEDGE
        bit, hindrance = "G1_STW.15", hindrance_of(no_control, sensor.in_vain, level, unheard=False)
        if level and sensor.state is SensorState.ACKNOWLEDGING and not sensor.in_vain:
            hindrance = Hindrance.UNFINISHED
    return Acknowledge(bit, "STW2_ENC.10", hindrance)
