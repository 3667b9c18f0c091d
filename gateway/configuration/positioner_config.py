"""[axis.positioner] and [[axis.block]]: what a positioner needs to know, checked key by key."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, model_validator

from pdgw.base.validation import misplaced
from pdgw.gateway.base.errors import GatewayError
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
