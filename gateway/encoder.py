"""An encoder as a drive object: a channel of a CiA 406 encoder behind telegrams 81 to 84, or as G1 of a drive's telegram 3.

Several channels of a multi-sensor device are several drive objects with one client. Source: docs/dsp406-encoder.md "Encoder
telegrams".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from fractions import Fraction
from typing import Any

from pdgw.ds301.client import NodeClient, NodeEvent
from pdgw.ds301.network import CanNetwork
from pdgw.dsp402.drive import DriveClient
from pdgw.dsp406.encoder import CYCLIC_TIMER, PRESET, PRESET_MULTI_SENSOR, EncoderClient
from pdgw.dsp406.images import PARAMETER_OBJECTS, EncoderParameters
from pdgw.dsp406.objects import PROFILE
from pdgw.gateway.config import EncoderConfig
from pdgw.gateway.drive_object import CANOPEN_FAULT, INTERNAL_FAULT, OWNED, DriveObject
from pdgw.gateway.faults import FaultRecord
from pdgw.gateway.translator.base import SdoWrite
from pdgw.gateway.translator.encoder import (
    EncoderInput,
    EncoderReferences,
    EncoderTranslator,
    EncoderTranslatorSettings,
    SensorChannel,
)
from pdgw.gateway.translator.factory import ENCODER_TELEGRAM_NUMBERS, make_encoder_translator
from pdgw.profidrive.encoder import STATUS_BITS, SensorError, SensorState
from pdgw.profidrive.sensor_format import SensorFormat
from pdgw.profidrive.sign_of_life import MONITORING_OFF, SignOfLife
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram, telegram

log = logging.getLogger("gateway")

_TYPES = {row.index: row.type for row in PROFILE}
_PARAMETERS = {(index, subindex) for _, index, subindex in PARAMETER_OBJECTS}
_LATCHED = frozenset({INTERNAL_FAULT, CANOPEN_FAULT, 101, 102, 105})
"""Fault numbers after which the PLC has to acknowledge: an EMCY, and the loss of an encoder that was online."""
_CONTROL_BY_PLC = signal("STW1").bit("CONTROL_BY_PLC").mask


class EncoderNode:
    """One encoder on the bus with the drive objects of its channels; its events reach all of them."""

    def __init__(self, network: CanNetwork, configs: Sequence[EncoderConfig], cycle_time_ms: float) -> None:
        self.objects: list[EncoderObject] = []
        channels = tuple(config.channel for config in configs)
        self.client = EncoderClient(network, configs[0].settings(channels, cycle_time_ms), self._on_event)

    def _on_event(self, event: NodeEvent) -> None:
        for item in self.objects:
            item.on_node_event(event)


class ChannelInput:
    """One channel of an encoder as translators see it."""

    def __init__(self, client: EncoderClient, channel: int) -> None:
        self._client = client
        self._channel = channel
        self._feedback = client.feedback.channel(channel)

    @property
    def position(self) -> int:
        return self._feedback.position

    @property
    def position_time(self) -> int:
        return self._client.position_time(self._channel)

    @property
    def speed(self) -> int | None:
        return self._feedback.speed if self._client.has_speed else None

    @property
    def alarms(self) -> int:
        return self._client.feedback.alarms

    @property
    def warnings(self) -> int:
        return self._client.feedback.warnings

    @property
    def error_register(self) -> int:
        return self._client.feedback.error_register

    @property
    def error_code(self) -> int:
        return self._client.feedback.error_code

    @property
    def valid(self) -> bool:
        """A channel that was configured has shown its position before the encoder counts as online."""
        return self._client.generation > 0


class EncoderObject(DriveObject):
    """A drive object (DO) with one channel of an encoder behind it."""

    kind = "encoder"
    telegram_numbers = ENCODER_TELEGRAM_NUMBERS

    def __init__(self, config: EncoderConfig, node: EncoderNode, number: int, tolerance: int = MONITORING_OFF) -> None:
        super().__init__(config.do_id, node.client.network, telegram(number))
        self.config: EncoderConfig = config
        self._node = node
        self.input = ChannelInput(node.client, config.channel)
        self._tolerance = tolerance
        self._parameters: EncoderParameters | None = None
        self._fault_told = False
        self.translator = self._make_translator(number)
        node.objects.append(self)

    def _make_translator(self, number: int) -> EncoderTranslator:
        return make_encoder_translator(number, EncoderTranslatorSettings(self._tolerance))

    @property
    def client(self) -> EncoderClient:
        return self._node.client

    @property
    def _translator(self) -> EncoderTranslator:
        return self.translator

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def step(self, setpoints: Sequence[int] | None, now: int) -> None:
        client, translator = self.client, self.translator
        ok = client.refresh(now)
        if client.generation != self._generation:
            self._generation = client.generation
            translator.drive_restarted()
        if client.parameters is not self._parameters:
            self._parameters = client.parameters
            translator.set_references(self.references)
        if self._fault_told:
            self._fault_told = False
            translator.fault_told()
        if setpoints is not None:
            self._take_setpoints(setpoints, now)
        self.actuals = translator.step(setpoints, self.input, ok, now)
        self._after_step(translator, ok, now)

    # -- beside the cycle -----------------------------------------------------------------------------------------------

    def _record(self, record: FaultRecord) -> None:
        super()._record(record)
        if record.number in _LATCHED and not record.is_warning:
            self._fault_told = True

    @property
    def warning(self) -> bool:
        return self.translator.channel.sensor.state in {SensorState.ERROR, SensorState.ACKNOWLEDGING}

    @property
    def references(self) -> EncoderReferences | None:
        """What gives the channel's values their meaning, None before the encoder was read."""
        parameters = self.client.parameters
        if parameters is None:
            return None
        dictionary, config = self.client.dictionary, self.config
        channel = config.channel if PRESET_MULTI_SENSOR in dictionary else None
        make = EncoderReferences.linear if config.is_linear else EncoderReferences.rotary
        return make(parameters, Fraction(str(config.reference_speed)), channel)

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
    def powered(self) -> bool:
        """An encoder moves nothing."""
        return False

    @property
    def faulty(self) -> bool:
        return bool(self.input.alarms or self.input.error_register)

    def entry_size(self, index: int, subindex: int) -> tuple[int, bool]:
        return _TYPES[index].bits // 8, _TYPES[index].char.islower()

    def change_telegram(self, number: int) -> None:
        translator = self._make_translator(number)
        translator.channel.sensor.preset_value = self.preset_value
        translator.set_references(self.references)
        self.translator = translator
        self._telegram_changed(telegram(number))

    @property
    def preset_value(self) -> int:
        """P65000, in measuring units."""
        return self.translator.channel.sensor.preset_value

    @preset_value.setter
    def preset_value(self, value: int) -> None:
        self.translator.channel.sensor.preset_value = value

    def set_sign_of_life_tolerance(self, failures: int) -> None:
        self._tolerance = failures
        self.translator.control.sign_of_life = SignOfLife(failures)

    def submit_write(self, item: SdoWrite) -> Future[None]:
        """Have the encoder take a preset asked for by a drive's G1."""
        return self.client.submit(lambda client: self._write_all(client, (item,)))

    def owns(self, index: int, subindex: int) -> bool:
        return (index, subindex) in OWNED or index == CYCLIC_TIMER

    def is_reference(self, index: int, subindex: int) -> bool:
        return (index, subindex) in _PARAMETERS or index in {PRESET, PRESET_MULTI_SENSOR}

    def read_references(self, client: NodeClient[Any]) -> None:
        self.client.read_parameters()


class DriveSensor:
    """The drive's own position as an encoder: 6064h, which has no preset."""

    alarms = warnings = error_register = error_code = 0
    speed = None
    valid = True
    references = EncoderReferences(1 << 32, Fraction(1), preset_supported=False)

    def __init__(self, drive: DriveClient) -> None:
        self._drive = drive

    @property
    def position(self) -> int:
        return self._drive.feedback.position_actual & 0xFFFF_FFFF

    @property
    def position_time(self) -> int:
        return 0


class SensorWords:
    """G1 of a drive's telegram: G1_STW in, G1_ZSW, G1_XIST1 and G1_XIST2 out, beside the drive's translator."""

    def __init__(self, chosen: Telegram) -> None:
        self.channel = SensorChannel()
        self._stw = chosen.setpoints.names.index("G1_STW")
        self.first = chosen.actuals.names.index("G1_ZSW")
        """Where G1_ZSW is in the actual values; XIST1 and XIST2 follow."""
        self._word: int | None = None
        self._write: SdoWrite | None = None
        self._future: Future[None] | None = None

    def step(
        self,
        setpoints: Sequence[int] | None,
        source: EncoderInput,
        ok: bool,
        now: int,
        submit: Callable[[SdoWrite], Future[None]],
    ) -> tuple[int, int, int]:
        """One cycle; returns G1_ZSW, G1_XIST1, G1_XIST2. ``submit`` has the encoder take a preset."""
        if setpoints is None:
            self._word = None
        elif setpoints[0] & _CONTROL_BY_PLC:
            self._word = setpoints[self._stw]
        channel = self.channel
        values = channel.step(self._word, source, ok, now)
        if channel.preset_write is not self._write:
            self._write = channel.preset_write
            self._future = None if self._write is None else submit(self._write)
        elif self._future is not None and self._future.done():
            error = self._future.exception()
            self._future = None
            if error is None:
                channel.sensor.preset_done()
            else:
                log.warning("preset of G1 refused: %s", error)
                channel.sensor.preset_failed()
        if not channel.valid and channel.sensor.state is SensorState.NORMAL:
            # There was no position yet, but the drive's IOPS may be good: not latched, it ends with the first position.
            return STATUS_BITS[SensorState.ERROR], values[1], SensorError.SENSOR_GROUP
        return values


def has_sensor(chosen: Telegram) -> bool:
    """A drive's telegram with G1 words."""
    return "STW1" in chosen.setpoints.names and "G1_STW" in chosen.setpoints.names
