"""Tables of a configuration for telegrams, encoders and positioners."""

from __future__ import annotations

import enum
from math import ceil
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, model_validator

from pdgw.ds301.node.node import GATEWAY_NODE_ID
from pdgw.dsp406.encoder import EncoderSettings
from pdgw.dsp406.kinds import CHANNELS_MAX, DEVICES, LINEAR, MULTI_SENSOR, ROTARY, EncoderDevice, multi_sensor
from pdgw.explain import misplaced
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS, add_telegram
from pdgw.gateway.configuration.environment import Boolean, DriveObjectSection, Integer, Section, Simulated
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.blocks import (
    HIGHEST_BLOCK,
    PERCENT_MAX,
    TORQUE_MAX,
    Block,
    BlockMode,
    BlockNext,
    BlockTable,
    BlockTask,
)
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError

# The telegrams of a user's own: ``[[telegram]]``.


class TelegramConfig(Section):
    """A telegram by its signals. It is known to the process, to axes and commands alike, as soon as it is read."""

    number: Integer
    """P922, 999 to 32767."""
    like: Integer
    """The telegram that it is carried out as: a speed telegram or one of DSC."""
    setpoints: tuple[str, ...]
    actuals: tuple[str, ...]
    """Names of the signals in the order of the frame (docs/tables.md)."""

    @model_validator(mode="after")
    def _is_possible(self) -> TelegramConfig:
        try:
            add_telegram(self.number, self.like, self.setpoints, self.actuals)
        except (GatewayError, ProfidriveError) as error:
            raise misplaced(str(error)) from error
        return self


# The encoders of a configuration: one table for each channel that is a drive object.


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
            gateway_node_id=GATEWAY_NODE_ID,
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


# [axis.positioner] and [[axis.block]]: what a positioner needs to know, checked key by key.
#
# Source: docs/motion.md. Positions are LU, speeds 1000 LU/min, accelerations 1000 LU/s2. No scaling has a default.


_LOWEST, _HIGHEST = DataType.INTEGER32.integer_range
_Integer = Annotated[int, Strict()]
_Position = Annotated[_Integer, Field(ge=_LOWEST, le=_HIGHEST)]
_Distance = Annotated[_Integer, Field(ge=0, le=_HIGHEST)]
_Above0 = Annotated[_Integer, Field(ge=1, le=_HIGHEST)]
_Percent = Annotated[_Integer, Field(ge=1, le=PERCENT_MAX)]


class BlockConfig(BaseModel):
    """One traversing block; the keys are those of ``motion.blocks.Block``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    number: Annotated[_Integer, Field(ge=0, le=HIGHEST_BLOCK)]
    position: _Position = 0
    velocity: _Distance = 0
    acceleration: _Percent = PERCENT_MAX
    deceleration: _Percent = PERCENT_MAX
    mode: BlockMode = BlockMode.ABSOLUTE
    task: BlockTask = BlockTask.POSITION
    next: BlockNext = BlockNext.END
    value: Annotated[_Integer, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _makes_sense(self) -> BlockConfig:
        try:
            self.block()
        except GatewayError as error:
            raise ValueError(str(error)) from error
        return self

    def block(self) -> Block:
        """For the positioner."""
        return Block(**dict(self))


class PositionerConfig(BaseModel):
    """Keys for telegrams 7, 110, 111 and 112."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    lu_per_revolution: _Above0
    """Length units in one revolution of the motor."""
    max_velocity: _Above0
    max_acceleration: _Above0
    """100 % of MDI_ACC."""
    max_deceleration: _Above0
    position_window: _Above0
    """Window around the target, in LU, in which it counts as reached."""
    jog_velocities: tuple[_Position, _Position] = (-300, 300)
    """Those of jog 1 and jog 2, signed."""
    jog_distances: tuple[_Distance, _Distance] = (0, 0)
    """Those of incremental jog 1 and 2."""
    software_limits: tuple[_Position, _Position] | None = None
    """Smallest and largest position."""
    reference_coordinate: _Position = 0
    homing_method: _Integer | None = None
    set_of_setpoints: Annotated[bool, Strict()] = True
    """The drive keeps a setpoint for after the one that runs."""

    clamping_torque: Annotated[_Integer, Field(ge=1, le=TORQUE_MAX)] | None = None
    """Torque of a task with STW2.8, in 1/1000 of the rated torque."""
    lu_per_unit: _Above0 | None = None
    """Telegram 112: LU in one unit of length."""
    velocity_per: Literal["second", "minute"] | None = None
    """Telegram 112: the time of velocities."""
    modulo_range: _Distance = 0
    """LU after which the positions of a rotary axis wrap: they are 0 to this value - 1. 0: a linear axis."""

    @model_validator(mode="after")
    def _modulo_is_complete(self) -> PositionerConfig:
        if self.modulo_range and self.software_limits is not None:
            text = "software_limits: not allowed with modulo_range, because such an axis has no end"
            raise misplaced(text, "software_limits")
        if self.modulo_range and not 0 <= self.reference_coordinate < self.modulo_range:
            text = f"reference_coordinate = {self.reference_coordinate}: allowed 0 to {self.modulo_range - 1}"
            raise misplaced(f"{text} with modulo_range", "reference_coordinate")
        return self

    @model_validator(mode="after")
    def _limits_have_room(self) -> PositionerConfig:
        if self.software_limits is not None and self.software_limits[0] >= self.software_limits[1]:
            text = f"software_limits = {list(self.software_limits)}: the first must be below the second"
            raise misplaced(text, "software_limits")
        return self

    def choices(self, blocks: tuple[BlockConfig, ...]) -> PositionerChoices:
        """For the executor; GatewayError for blocks that cannot be run."""
        table = tuple(item.block() for item in blocks)
        BlockTable(table)
        return PositionerChoices(
            **self.model_dump(exclude={"set_of_setpoints", "modulo_range", "lu_per_unit", "velocity_per"}),
            waiting_setpoints=self.set_of_setpoints,
            blocks=table,
            modulo=self.modulo_range,
            lu_per_unit=self.lu_per_unit or 0,
            units_per_second=self.velocity_per == "second",
        )

    @property
    def has_unit(self) -> bool:
        """Whether the keys for telegram 112 are set."""
        return self.lu_per_unit is not None and self.velocity_per is not None
