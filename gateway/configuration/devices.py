"""The telegrams of a user's own (``[[telegram]]``), and the encoders: one table for each channel that is a drive object."""

from __future__ import annotations

import enum
from functools import cached_property
from math import ceil
from typing import Annotated

from pydantic import Field, Strict, model_validator

from pdgw.base.validation import misplaced
from pdgw.dsp406.kinds import CHANNELS_MAX, DEVICES, LINEAR, MULTI_SENSOR, ROTARY, EncoderDevice, multi_sensor
from pdgw.dsp406.settings import EncoderSettings
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS, own_drive_telegram
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.environment import Boolean, DriveObjectSection, Integer, Section, Simulated
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.telegrams import Telegram


class TelegramConfig(Section):
    """A telegram by its signals, for the axes of the same file."""

    number: Integer
    """P922, 999 to 32767."""
    like: Integer
    """The telegram that it is carried out as: a speed telegram or one of DSC."""
    setpoints: tuple[str, ...]
    actuals: tuple[str, ...]
    """Names of the signals in the order of the frame (docs/tables.md)."""

    @cached_property
    def own(self) -> Telegram:
        """The telegram that is declared."""
        return own_drive_telegram(self.number, self.like, self.setpoints, self.actuals)

    @model_validator(mode="after")
    def _is_possible(self) -> TelegramConfig:
        try:
            assert self.own
        except (GatewayError, ProfidriveError) as error:
            raise misplaced(str(error)) from error
        return self


_SILENCE_MS = 100


class EncoderModel(enum.Enum):
    """``model``: the encoders this package has a data sheet of."""

    ROTARY = ROTARY.name
    LINEAR = LINEAR.name
    MULTI_SENSOR = MULTI_SENSOR.name


class EncoderConfig(DriveObjectSection):
    """One channel of an encoder as a drive object. Channels of one device have a table each and agree in what the device is."""

    model: EncoderModel = EncoderModel.ROTARY
    channel: Annotated[Integer, Field(ge=1, le=CHANNELS_MAX)] = 1
    reference_speed: Annotated[float, Strict(), Field(gt=0, le=1e6)] | Annotated[Integer, Field(gt=0, le=1_000_000)] = (
        3000
    )
    """100 % of NIST_A and NIST_B: rpm, of a linear encoder mm/s."""
    simulate: Simulated = False
    motion: str = "still"
    """Motion of a simulated encoder, in the notation of ``pdgw sim encoder --motion``."""
    tpdo_event_ms: Annotated[Integer, Field(ge=1, le=10_000)] | None = None
    """Cyclic timer 6200h. None: the cycle of the PLC."""
    sync: Boolean = False

    @model_validator(mode="after")
    def _telegram_is_supported(self) -> EncoderConfig:
        if self.telegram not in ENCODER_TELEGRAM_NUMBERS:
            raise misplaced(
                f"telegram = {self.telegram} is not supported, allowed: {list(ENCODER_TELEGRAM_NUMBERS)}", "telegram"
            )
        if self.channel > 1 and self.model is not EncoderModel.MULTI_SENSOR:
            text = f'channel = {self.channel}: only model = "{EncoderModel.MULTI_SENSOR.value}" has several channels'
            raise misplaced(text, "channel")
        return self

    @property
    def is_linear(self) -> bool:
        return self.model is EncoderModel.LINEAR

    @property
    def device_keys(self) -> tuple[object, ...]:
        """Keys that must be equal for all channels of a device."""
        return (
            self.model,
            self.eds,
            self.dcf,
            self.objects,
            self.simulate,
            self.heartbeat_ms,
            self.tpdo_event_ms,
            self.sdo_timeout_ms,
            self.sync,
        )

    @property
    def speed_unit(self) -> str:
        """Unit of ``reference_speed``."""
        return "mm/s" if self.is_linear else "rpm"

    def event_ms(self, cycle_time_ms: float) -> int:
        """The cyclic timer in force."""
        return max(1, int(cycle_time_ms)) if self.tpdo_event_ms is None else self.tpdo_event_ms

    def settings(self, channels: tuple[int, ...], cycle_time_ms: float) -> EncoderSettings:
        """Settings of the device's client."""
        event_ms = max(self.event_ms(cycle_time_ms), ceil(cycle_time_ms) if self.sync else 1)
        return EncoderSettings(
            node_id=self.node_id,
            eds=self.eds,
            heartbeat_ms=self.heartbeat_ms,
            tpdo_event_ms=event_ms,
            # A position every few milliseconds is late long before its encoder is lost. A user with slower values can set a
            # heartbeat here.
            tpdo_timeout_factor=max(4, ceil(max(_SILENCE_MS, self.heartbeat_ms) / event_ms)),
            sdo_timeout_ms=self.sdo_timeout_ms,
            sync=self.sync,
            cycle_ms=ceil(cycle_time_ms),
            channels=channels,
            device=self.device,
        )

    @property
    def device(self) -> EncoderDevice:
        """The device of the package whose EDS is taken, and that is simulated."""
        device = DEVICES[self.model.value]
        return device if self.channel <= device.channels else multi_sensor(self.channel)
