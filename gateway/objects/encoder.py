"""An encoder as a drive object: a channel of a CiA 406 encoder with telegrams 81 to 84, or as G1 of a drive's telegram 3.

Several channels of a multi-sensor device are several drive objects with one client. Source: docs/devices.md "Encoder
telegrams".
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from fractions import Fraction
from typing import Any, ClassVar

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import NodeNotice
from pdgw.ds301.node.plan import PdoPlan
from pdgw.dsp406.encoder import EncoderClient
from pdgw.dsp406.images import PARAMETER_OBJECTS, EncoderParameters, position_of, speed_of
from pdgw.dsp406.objects import CYCLIC_TIMER, PRESET, PRESET_MULTI_SENSOR, PROFILE
from pdgw.gateway.axis.encoder_machine import EncoderMachine
from pdgw.gateway.axis.executors.sensor import EncoderReferences
from pdgw.gateway.axis.settings import SensorSettings
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import Outputs, SdoWrite
from pdgw.gateway.base.fault_numbers import By
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.objects.drive_object import OWNED, DriveObject
from pdgw.gateway.objects.fault_buffer import ReportedFault
from pdgw.profidrive.sensor_format import SensorFormat
from pdgw.profidrive.sign_of_life import MONITORING_OFF
from pdgw.profidrive.telegrams import telegram

_TYPES = {row.index: row.type for row in PROFILE}
_PARAMETERS = {(index, subindex) for _, index, subindex in PARAMETER_OBJECTS}


class EncoderNode:
    """One encoder on the bus with the drive objects of its channels; its events reach all of them."""

    def __init__(self, network: CanNetwork, configs: Sequence[EncoderConfig], cycle_time_ms: float) -> None:
        self.objects: list[EncoderObject] = []
        channels = tuple(config.channel for config in configs)
        settings = replace(configs[0].settings(channels, cycle_time_ms), values=configs[0].device_values("encoder"))
        self.client = EncoderClient(network, settings, self._on_event)

    def _on_event(self, notice: NodeNotice) -> None:
        for item in self.objects:
            item.on_node_event(notice)


class ChannelInput:
    """One channel of an encoder as the machines see it."""

    def __init__(self, client: EncoderClient, channel: int) -> None:
        self.client = client
        self._channel = channel
        self._feedback = client.feedback.channel(channel)
        self._plan: PdoPlan | None = None
        self._has_speed = False
        """The encoder sends the speed with this plan."""
        self.attributes = {position_of(channel): "position", speed_of(channel): "speed"}
        """Its values in TPDOs, by the attribute of the encoder's image."""

    @property
    def position(self) -> int:
        return self._feedback.position

    @property
    def position_time(self) -> int:
        return self.client.position_time(self._channel)

    @property
    def speed(self) -> int | None:
        plan = self.client.plan
        if plan is not self._plan:
            self._plan, self._has_speed = plan, self.client.has_speed(self._channel)
        return self._feedback.speed if self._has_speed else None

    @property
    def alarms(self) -> int:
        return self.client.feedback.alarms

    @property
    def warnings(self) -> int:
        return self.client.feedback.warnings

    @property
    def error_register(self) -> int:
        return self.client.feedback.error_register

    @property
    def error_code(self) -> int:
        return self.client.feedback.error_code

    @property
    def valid(self) -> bool:
        """A channel that was configured has shown its position before the encoder counts as online."""
        return self.client.generation > 0


class EncoderObject(DriveObject):
    """A drive object (DO) with one channel of an encoder."""

    kind: ClassVar[str] = "encoder"
    warning_word: ClassVar[str] = "6505h"

    def __init__(self, config: EncoderConfig, node: EncoderNode, number: int, tolerance: int = MONITORING_OFF) -> None:
        super().__init__(config.do_id, node.client.network, telegram(number))
        self.config: EncoderConfig = config
        self.telegram_numbers = ENCODER_TELEGRAM_NUMBERS
        self._node = node
        self.input = ChannelInput(node.client, config.channel)
        self.sign_of_life_tolerance = tolerance
        self._parameters: EncoderParameters | None = None
        self.machine = self._make_machine(number)
        node.objects.append(self)

    def _make_machine(self, number: int) -> EncoderMachine:
        return EncoderMachine(number, SensorSettings(self.sign_of_life_tolerance), self.input)

    @property
    def client(self) -> EncoderClient:
        return self._node.client

    @property
    def outputs(self) -> Outputs:
        return self.machine.outputs

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def step(self, setpoints: Sequence[int] | None, now: int) -> Outputs:
        client, machine = self.client, self.machine
        inputs = machine.inputs
        inputs.now = now
        inputs.setpoints = None if self.gateway_stops else setpoints
        inputs.ok = client.refresh(now)
        inputs.unacknowledged = not self.fault_log.acknowledged
        if client.parameters is not self._parameters:
            self._parameters = client.parameters
            machine.set_references(references := self.references)
            self.note("references", (0, references))
        if self._news or self._future is not None:
            self._deliver(inputs.news)
            self._note_news(inputs.news)
        if setpoints is not None:
            self.last_setpoints = setpoints
        outputs = machine.step()
        if outputs.events is not None or outputs.writes is not None or outputs.reason is not self._reported_reason:
            self._serve(outputs)
        self._watch_warning(outputs.warning)
        if self.origins.present is not None and self.fault_log.acknowledged and not machine.in_error:
            self.origins.released(now)
        return outputs

    # -- queries ----------------------------------------------------------------------------------------------------------

    @property
    def references(self) -> EncoderReferences | None:
        """Reference values of the channel; None before the encoder was read."""
        parameters = self.client.parameters
        if parameters is None:
            return None
        dictionary, config = self.client.sdo.dictionary, self.config
        channel = config.channel if PRESET_MULTI_SENSOR in dictionary else None
        make = EncoderReferences.linear if config.is_linear else EncoderReferences.rotary
        references = make(parameters, Fraction(str(config.reference_speed)), channel)
        return replace(references, position_age_ns=self.client.position_age_ns)

    @property
    def sensor_format(self) -> SensorFormat:
        """P979; not valid before the encoder was read."""
        parameters = self.client.parameters
        is_64_bit = "G1_XIST3" in self.telegram.actuals.names
        if parameters is None:
            return SensorFormat(
                0, linear=self.config.is_linear, is_64_bit=is_64_bit, validity_static=False, valid=False
            )
        if self.config.is_linear:
            step_nm = 1000 * (parameters.position_step or parameters.resolution)
            return SensorFormat(step_nm, linear=True, is_64_bit=is_64_bit, is_static=False)
        per_turn = parameters.units_per_turn
        turns = max(1, parameters.total_range // per_turn) if per_turn else 1
        return SensorFormat(per_turn, turns, is_64_bit=is_64_bit, is_static=False)

    @property
    def cause(self) -> ReportedFault | None:
        """What the encoder itself reports while it shows an error, else the origin."""
        own = self.fault_log.of_device(0) if self.machine.faulty else None
        return own or super().cause

    def lasts(self, by: By) -> bool:
        if by is By.PLC:
            return self.machine.adapter.control is None or self.machine.control.sign_of_life.failed
        return self.machine.in_fault  # until the PLC acknowledges

    @property
    def powered(self) -> bool:
        """False: an encoder has no power stage."""
        return False

    def entry_size(self, index: int, subindex: int) -> tuple[int, bool]:
        return _TYPES[index].bits // 8, _TYPES[index].char.islower()

    def change_telegram(self, number: int) -> None:
        machine = self._make_machine(number)
        machine.adopt(self.machine)
        machine.set_references(references := self.references)
        self.note("references", (0, references))
        self.machine = machine
        self._telegram_changed(telegram(number))

    @property
    def preset_value(self) -> int:
        """P65000, in measuring units."""
        return self.machine.channel.sensor.preset_value

    @preset_value.setter
    def preset_value(self, value: int) -> None:
        self.machine.channel.sensor.preset_value = value
        self.note("preset", value)

    def set_sign_of_life_tolerance(self, failures: int) -> None:
        self.sign_of_life_tolerance = failures
        self.machine.tolerate(failures)
        self.note("tolerate", failures)

    def submit_write(self, item: SdoWrite) -> Future[None]:
        """Send a preset to the encoder that G1 of a drive has requested."""
        return self.client.submit(lambda client: self._write_all(client, (item,)))

    def owns(self, index: int, subindex: int) -> bool:
        return (index, subindex) in OWNED or index == CYCLIC_TIMER

    def is_reference(self, index: int, subindex: int) -> bool:
        return (index, subindex) in _PARAMETERS or index in {PRESET, PRESET_MULTI_SENSOR}

    def read_references(self, client: NodeClient[Any]) -> None:
        self.client.read_parameters()

    def references_changed(self) -> None:
        """Another object replaces its parameters, so that the next step detects the change."""
