"""Scenarios: what a PLC program does, as data.

A scenario is a list of steps; each has one action, an optional ``axis`` (from 1) and ``note``. ``read`` and ``write`` go to the
parameter channel, to the drive object with the number of the axis as DO-ID. A file of it is YAML (``scenario_file``), its
values are written as ``notation`` says, and ``engine`` plays it. See ``tools/scenarios`` for examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from pdgw.peers.plc.positioner import Mdi, SettingUp
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import MAX_PARAMETERS
from pdgw.profidrive.telegrams import telegram

Scalar = int | float | str


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class References(_Model):
    """What 100 % stands for, to write values in physical units."""

    speed_rpm: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 3000
    position: Annotated[int, Field(gt=0)] = 500_000


class Move(_Model):
    """A traversing task of telegram 9."""

    to: Scalar
    velocity: Scalar = "50 %"
    acc: Scalar = "50 %"
    dec: Scalar = "50 %"
    relative: bool = False


class Home(_Model):
    """A homing procedure of telegram 9."""

    method: int = 35
    velocity: Scalar = "20 %"


class Step(_Model):
    """One step: exactly one action."""

    axis: Annotated[int, Field(ge=1)] = 1
    note: str = ""
    within: str = "3 s"
    refused: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """The error number a ``write`` has to be refused with."""
    enable: Literal[True] | None = None
    off1: Literal[True] | None = None
    quick_stop: Literal[True] | None = None
    coast: Literal[True] | None = None
    ack: Literal[True] | None = None
    speed: Scalar | None = None
    home: Home | None = None
    home_end: Literal[True] | None = None
    move: Move | None = None
    mdi: Mdi | None = None
    setting_up: SettingUp | None = None
    block: int | None = None
    next_block: Literal[True] | None = None
    jog: Literal[0, 1, 2] | None = None
    """Jog 1 or 2; 0 lets go."""
    jog_distance: Literal[1, 2] | None = None
    set_reference: Literal[True] | None = None
    reject: Literal[True] | None = None
    intermediate_stop: Literal[True] | None = None
    resume: Literal[True] | None = None
    preset: Literal["absolute", "relative"] | None = None
    """The value is parameter 65000."""
    read: Annotated[dict[str, Scalar], Field(min_length=1, max_length=MAX_PARAMETERS)] | None = None
    """What parameters have to be, as in ``expect``; read again until they are."""
    write: Annotated[dict[str, Scalar], Field(min_length=1, max_length=MAX_PARAMETERS)] | None = None
    set: Annotated[dict[str, Scalar], Field(min_length=1)] | None = None
    expect: Annotated[dict[str, Scalar], Field(min_length=1)] | None = None
    hold: str | None = None
    mute: bool | None = None
    run: bool | None = None
    drive: str | None = None

    @property
    def action(self) -> str:
        """The name of the action."""
        return next(name for name in _ACTIONS if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _one_action(self) -> Step:
        given = [name for name in _ACTIONS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"{len(given)} actions ({', '.join(given) or 'none'}), allowed exactly one of {', '.join(_ACTIONS)}"
            )
        if self.refused is not None and self.write is None:
            raise ValueError("refused: only a write has it")
        return self


_ACTIONS = tuple(name for name in Step.model_fields if name not in {"axis", "note", "within", "refused"})


class Scenario(_Model):
    """The whole file."""

    name: str = "scenario"
    telegrams: Annotated[list[int], Field(min_length=1)] = [1]
    references: References = References()
    steps: Annotated[list[Step], Field(min_length=1)]

    @model_validator(mode="after")
    def _axes_exist(self) -> Scenario:
        for number in self.telegrams:
            try:
                telegram(number)
            except ProfidriveError as error:
                raise ValueError(str(error)) from error
        for position, step in enumerate(self.steps, 1):
            if step.axis > len(self.telegrams):
                raise ValueError(f"step {position}: axis {step.axis} does not exist, allowed 1..{len(self.telegrams)}")
        return self
