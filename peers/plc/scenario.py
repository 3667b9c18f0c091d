"""Scenarios: PLC programs as data.

A scenario is a list of steps. Each has one action, an optional ``axis`` (from 1) and ``note``. ``Step`` declares the actions
for scenarios, keyboard and docs: value, program (``actions``), examples and description. In addition every value and bit of
the telegram is a word (``vocabulary``). ``read`` and ``write`` use the parameter channel of the drive object whose DO-ID is
the number of the axis. A scenario file is YAML (``scenario_file``), its values are in the notation of ``notation``, and
``engine`` runs it. For examples see ``tools/scenarios``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field, ValidationInfo, model_validator

from pdgw.base.phrases import did_you_mean
from pdgw.base.validation import misplaced
from pdgw.peers.plc import actions
from pdgw.peers.plc.actions import Access, Action, Home, Mdi, Measuring, Model, Move, Reading, Set, SettingUp, Wait
from pdgw.peers.plc.exchange.following import Follow
from pdgw.peers.plc.notation import Scalar, parse_time, telegrams_of
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import MAX_PARAMETERS
from pdgw.profidrive.telegrams import TELEGRAMS, telegram

_Flag = Literal[True] | None
_Parameters = Annotated[dict[str, Scalar], Field(min_length=1, max_length=MAX_PARAMETERS)] | None
_Values = Annotated[dict[str, Scalar], Field(min_length=1)] | None


class References(Model):
    """100 % of the quantities, for values in physical units."""

    speed_rpm: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 3000
    position: Annotated[int, Field(gt=0)] = 500_000
    increments: Annotated[int, Field(gt=0)] = 4096
    """Increments of G1_XIST1 per revolution, with its fine resolution."""


class Step(Model):
    """One step with exactly one action. Words of the telegram are a ``set``."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    axis: Annotated[int, Field(ge=1)] = 1
    note: str = ""
    within: str | None = None
    """Timeout of the step; default: that of the scenario."""
    refused: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    enable: Annotated[_Flag, actions.enable] = None
    """OFF, then ON when the drive is ready"""
    off1: Annotated[_Flag, actions.off1] = None
    """OFF1: ramp down, power off"""
    quick_stop: Annotated[_Flag, actions.quick_stop] = None
    """OFF3: quick stop"""
    coast: Annotated[_Flag, actions.coast] = None
    """OFF2: coast"""
    ack: Annotated[_Flag, actions.ack] = None
    """acknowledge faults, also those of an encoder"""
    speed: Annotated[Scalar | None, actions.speed, Field(examples=["1500 rpm"])] = None
    """speed setpoint"""
    move: Annotated[Move | None, actions.move, Field(examples=[{"to": "60000 inc", "velocity": "80 %"}])] = None
    """task of telegram 9"""
    mdi: Annotated[
        Mdi | None, actions.mdi, Field(examples=[{"to": 50000, "velocity": 12000}, {"to": 0, "update": True}])
    ] = None
    """task in LU, of 112 in its unit of length; with ``update`` STW1.6 stays 1, and further ``mdi`` steps change the task"""
    setting_up: Annotated[SettingUp | None, actions.setting_up, Field(examples=[{"velocity": -3000}])] = None
    """move with a signed velocity until ``reject``"""
    block: Annotated[int | None, actions.block, Field(examples=[5])] = None
    """a traversing block, or the chain that starts with it"""
    next_block: Annotated[_Flag, actions.next_block] = None
    """external block change: the edge of STW1.13"""
    jog: Annotated[Literal[0, 1, 2] | None, actions.jog, Field(examples=[1, 0])] = None
    """jog 1 or 2; 0 ends it. With a speed telegram STW1.4-6 are 0 during the jog"""
    jog_distance: Annotated[Literal[1, 2] | None, actions.jog_distance, Field(examples=[1])] = None
    """incremental jog 1 or 2"""
    home: Annotated[Home | None, actions.home, Field(examples=[{}, {"passive": True}])] = None
    """homing; STW1.11 stays 1 until ``stop_homing``"""
    stop_homing: Annotated[_Flag, actions.stop_homing] = None
    """end of a homing, also of a waiting passive one"""
    set_reference: Annotated[_Flag, actions.set_reference] = None
    """set the reference point at the current position"""
    reject: Annotated[_Flag, actions.reject] = None
    """reject the task: ramp"""
    intermediate_stop: Annotated[_Flag, actions.intermediate_stop] = None
    """intermediate stop; the drive keeps the task"""
    resume: Annotated[_Flag, actions.resume] = None
    """end of the intermediate stop"""
    follow: Annotated[
        Follow | None,
        actions.follow,
        Field(examples=[{"by": 4096, "error": 200}, {"by": 4096, "error": 900, "dsc": False}]),
    ] = None
    """the PLC closes the position loop and follows a sine for one period within ``error``; with ``dsc`` by XERR and KPC"""
    reference_mark: Annotated[Literal[1, 2] | None, actions.reference_mark, Field(examples=[1])] = None
    """sensor 1 or 2 searches its reference mark"""
    measure: Annotated[Measuring | None, actions.measure, Field(examples=[{"function": 1}])] = None
    """measurement on the fly: functions 1, 2 are probe 1 rising, falling, 3, 4 probe 2"""
    read_value: Annotated[Reading | None, actions.read_value, Field(examples=[{"function": 1}])] = None
    """wait for the value of a function and show it in Gn_XIST2, until the next word for this sensor"""
    stop_measuring: Annotated[Literal[1, 2] | None, actions.stop_measuring, Field(examples=[1])] = None
    """abort the search or measurement of sensor 1 or 2"""
    sign_of_life: Annotated[bool | None, actions.sign_of_life, Field(examples=[True])] = None
    """the sign of life in STW2 counts with each frame (true) or stops (false)"""
    preset: Annotated[Literal["absolute", "relative"] | None, actions.preset, Field(examples=["absolute"])] = None
    """preset of an encoder; the value is parameter 65000"""
    read: Annotated[_Parameters, lambda _, values: [Access(values, write=False)], Field(examples=[{"P947.0": 0}])] = (
        None
    )
    """expected values of parameters, as in ``expect``; repeated until they match"""
    write: Annotated[_Parameters, lambda _, values: [Access(values, write=True)], Field(examples=[{"6083h": 250}])] = (
        None
    )
    """write parameters; ``refused`` is the expected error number"""
    set: Annotated[_Values, lambda _, values: [Set(values)], Field(examples=[{"STW1.ON": 0}])] = None
    """set setpoints and bits, by signal or by name"""
    expect: Annotated[_Values, lambda _, values: [Wait(values)], Field(examples=[{"NIST_A": "1500 rpm +- 10 rpm"}])] = (
        None
    )
    """expected actual values; the step waits for them (``within``)"""
    hold: Annotated[str | None, lambda _, text: [parse_time(text)], Field(examples=["500 ms"])] = None
    """a pause"""
    mute: Annotated[
        bool | None, actions.order(lambda engine, muted: setattr(engine, "muted", muted)), Field(examples=[True])
    ] = None
    """send nothing, as an unplugged PLC"""
    run: Annotated[
        bool | None,
        actions.order(lambda engine, running: setattr(engine.endpoint, "run", running)),
        Field(examples=[False]),
    ] = None
    """provider state RUN or STOP"""
    drive: Annotated[
        str | None,
        actions.order(lambda engine, line: engine.drive(line)),
        Field(examples=["@1 fault 7"]),
    ] = None
    """a command for the simulated devices, as for `pdgw sim inject`"""

    @model_validator(mode="before")
    @classmethod
    def _words(cls, document: Any) -> Any:
        """Convert keys that are not actions to words of the telegram."""
        if not isinstance(document, dict):
            return document
        known, words = {}, {}
        for key, value in document.items():
            name = "on" if key is True else key  # YAML reads ``on:`` as True
            if name in cls.model_fields or not isinstance(name, str):
                known[name] = value
            elif name in telegrams_of():
                words[name] = value
            else:
                hint = did_you_mean(name, [*cls.model_fields, *telegrams_of()]) or (
                    f" (actions: {', '.join(ACTIONS)}; and every value and bit of the telegram in lower case, like "
                    "override, tracking: docs/simulation.md)"
                )
                raise misplaced(f"{name}: unknown word{hint}", name)
        if words:
            given = known.get("set", {})
            known["set"] = {**given, **words} if isinstance(given, dict) else given
        return known

    @property
    def action(self) -> str:
        """The name of the action."""
        return self._given()[0]

    def _given(self) -> list[str]:
        return [name for name in ACTIONS if getattr(self, name) is not None]

    @model_validator(mode="after")
    def _one_action(self) -> Step:
        given = self._given()
        if len(given) != 1:
            raise ValueError(
                f"{len(given)} actions ({', '.join(given) or 'none'}), allowed exactly one of {', '.join(ACTIONS)}"
            )
        if self.refused is not None and self.write is None:
            raise ValueError("refused: allowed only with a write")
        return self


ACTIONS: Final[Mapping[str, Action]] = {
    name: program for name, field in Step.model_fields.items() for program in field.metadata if callable(program)
}
"""The actions with their programs."""


def examples(action: str) -> list[dict[str, Any]]:
    """The examples in the declaration of this action."""
    return [{action: example} for example in Step.model_fields[action].examples or [True]]


class Scenario(Model):
    """A scenario file."""

    name: str = "scenario"
    within: str = "3 s"
    """Timeout of the steps without their own."""
    telegrams: list[int] = Field([1], min_length=1)
    references: References = References()
    steps: Annotated[list[Step], Field(min_length=1)]

    @model_validator(mode="after")
    def _axes_exist(self, info: ValidationInfo) -> Scenario:
        for number in self.telegrams:
            try:
                telegram(number, TELEGRAMS if info.context is None else info.context)
            except ProfidriveError as error:
                raise ValueError(str(error)) from error
        for position, step in enumerate(self.steps, 1):
            if step.axis > len(self.telegrams):
                raise ValueError(f"step {position}: axis {step.axis} does not exist, allowed 1..{len(self.telegrams)}")
        return self
