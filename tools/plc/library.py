"""Function blocks for the telegrams of a configuration: templates, filled in from the declarations of signals and bits.

A template is Structured Text with ``%if NAME`` / ``%else`` / ``%end`` (the telegram has the signal or the bit, or the caller
names it) and these in braces:

    {TARGET_REACHED}, {ZSW1.FAULT}    a bit of the actual values as a condition; left of ``:=`` a bit of the setpoints
    {NSOLL*}                          the signal whose name begins so
    {type NSOLL*}, {full NSOLL*}      its type, and its 100 %; {percent NSOLL*}: 1 %
    {word BLOCK}, {top BLOCK}         the setpoint that has these bits, and their greatest value
    {reason DRIVE_FAULT}              the number of a reason
    {name}                            what the caller gives, of several lines too
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.byte_map import plc_type
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT, DataType
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, Telegram, TelegramHalf
from pdgw.profidrive.words import Bit
from pdgw.tools.plc.frame_fields import type_of

_TEMPLATES = Path(__file__).parent / "templates"
_FULL = {DataType.N2: N2_100_PERCENT, DataType.N4: N4_100_PERCENT}
_MACRO = re.compile(r"\{([^{}]+)\}")
_SET_BIT = re.compile(r"^(\s*)\{([\w.]+)\} := (.+);$")
_SIGN_OF_LIFE = """\
    life := life + 1;
    IF life > 15 THEN
        life := 1;
    END_IF;
    Setpoints.{word} := Setpoints.{word} OR SHL(IN := INT_TO_WORD(life), N := 12);"""
MODES = {
    1: "relative",
    2: "absolute",
    3: "setting up",
    4: "homing",
    5: "set the reference point",
    6: "traversing block",
    7: "jog",
    8: "jog by a distance",
}
"""Modes of PDGW_Pos."""
_CONTROL_WORDS = ("SATZANW", "POS_STW", "POS_STW1", "POS_STW2", "MDI_MOD", "STW2")
Values = Mapping[str, str]


_KINDS = {
    ApplicationMode.VELOCITY: ("speed", "Speed"),
    ApplicationMode.POSITIONING: ("position", "Pos"),
    ApplicationMode.ENCODER: ("encoder", "Encoder"),
    ApplicationMode.TRANSPARENT: ("transparent", "Drive"),
}
"""The template and the block name of each application mode."""


def kind_of(telegram: Telegram) -> str:
    """Name of the template for a telegram's block."""
    return _KINDS[telegram.mode][0]


def block_name(telegram: Telegram) -> str:
    """Name of a telegram's block."""
    return f"PDGW_{_KINDS[telegram.mode][1]}_T{telegram.number}"


def modes_of(telegram: Telegram) -> tuple[int, ...]:
    """The modes of PDGW_Pos that a telegram supports."""
    names = _names(telegram)
    needs = {
        1: "ABSOLUTE",
        2: "ABSOLUTE",
        3: "SETTING_UP",
        4: "START_HOMING",
        5: "SET_REFERENCE_POINT",
        6: "BLOCK",
        7: "BLOCK",
        8: "JOG_INCREMENTAL",
    }
    return tuple(mode for mode, name in needs.items() if name in names)


def _commanded(telegram: Telegram) -> tuple[int, ...]:
    """The modes of PDGW_AXIS that a telegram supports: 0 halt, 1 relative, 2 absolute, 3 velocity, 4 homing."""
    if kind_of(telegram) == "speed":
        return 0, 3
    return 0, *(mode for mode in modes_of(telegram) if mode <= 4)


def telegram_block(telegram: Telegram, values: Values) -> str:
    """Generate the block of a telegram. ``values``: initial values from the configuration, by the names in the templates."""
    return filled(kind_of(telegram), telegram, values)


def axis_block(telegram: Telegram, values: Values) -> str:
    """Generate the block that executes PLCopen's commands with a telegram's block. ``values``: as in ``telegram_block``."""
    return filled("axis", telegram, values)


def plain(name: str, values: Values) -> str:
    """Fill in a template that depends on no telegram, with ``values`` and reasons."""
    return _MACRO.sub(
        lambda macro: values[macro[1]] if macro[1] in values else str(Reason[macro[1].removeprefix("reason ")].code),
        template(name),
    )


def filled(name: str, telegram: Telegram, values: Values) -> str:
    """Fill in a template for a telegram."""
    modes = modes_of(telegram)
    tasks = [mode for mode in (1, 2, 3, 6) if mode in modes]
    mdi = [mode for mode in (1, 2, 3) if mode in modes]
    flags = {
        "POSITION": {"XIST_A", "XIST_F"} & set(telegram.actuals.names),
        "MDI_MODES": mdi,
        "JOGS": 7 in modes,
        "FULL_VELOCITY": 3 in modes and "NIST_B" in telegram.actuals.names,
    }
    known = {"speed": "ReferenceSpeed > 0.0", "position": "TRUE"}
    if mdi:
        known["position"] = "PositionFactor > 0.0 AND VelocityFactor > 0.0"
    life = next((signal.name for signal in telegram.setpoints.signals if signal.name.startswith("STW2")), "")
    own = {
        "name": block_name(telegram),
        "number": str(telegram.number),
        "actual": type_of(telegram.actuals),
        "setpoints": type_of(telegram.setpoints),
        "power variables": template("power_variables"),
        "power": template("power"),
        "known": known.get(kind_of(telegram), "TRUE"),
        "sign of life": _SIGN_OF_LIFE.replace("{word}", life) if life else "",
        "modes": ", ".join(f"{mode} {MODES[mode]}" for mode in modes),
        "refusal": _refusal(mdi, tasks),
        "task_mode": _any("ModePos", tasks),
        "mdi_mode": _any("ModePos", mdi),
        "mode bits": f"{sum(1 << mode for mode in _commanded(telegram)):04X}",
        "mdi_selected": "TRUE" if "HOMING_METHOD" in _names(telegram) else _any("mode_active", mdi),
        "clear": "\n".join(
            f"    Setpoints.{name} := 16#0000;" for name in _CONTROL_WORDS if name in telegram.setpoints.names
        ),
    }
    return _Filling(telegram, {**own, **values}, {flag for flag, on in flags.items() if on}).fill(template(name))


def _refusal(mdi: Sequence[int], tasks: Sequence[int]) -> str:
    """Expression for the reason of a rejected task: unknown block or target out of range."""
    block, target = Reason.TASK_BLOCK_UNKNOWN.code, Reason.TASK_TARGET_RANGE.code
    if mdi and 6 in tasks:
        return f"SEL(G := mode_active = 6, IN0 := {target}, IN1 := {block})"
    return str(target if mdi else block)


def _any(variable: str, numbers: Sequence[int]) -> str:
    return f"({' OR '.join(f'{variable} = {number}' for number in numbers)})" if numbers else "FALSE"


@cache
def template(name: str) -> str:
    """The text of a template."""
    return (_TEMPLATES / f"{name}.st").read_text(encoding="utf-8").rstrip("\n")


def _bits(half: TelegramHalf) -> Iterator[tuple[Signal, Bit]]:
    for signal in half.signals:
        for bit in signal.fields(positioning=half.mode is ApplicationMode.POSITIONING):
            yield signal, bit


@cache
def _names(telegram: Telegram) -> frozenset[str]:
    """Names of all signals and bits of a telegram."""
    found = {bit.name for half in (telegram.setpoints, telegram.actuals) for _, bit in _bits(half)}
    return frozenset(found | set(telegram.setpoints.names) | set(telegram.actuals.names))


class _Filling:
    def __init__(self, telegram: Telegram, values: Values, flags: set[str]) -> None:
        self._telegram = telegram
        self._values = values
        self._flags = flags

    def fill(self, text: str) -> str:
        return "\n".join(line for line in self._lines(text) if line.strip())

    def _lines(self, text: str) -> Iterator[str]:
        kept = [True]
        for line in text.split("\n"):
            directive, _, name = line.partition(" ")
            if directive == "%if":
                kept.append(kept[-1] and self._has(name))
            elif directive == "%else":
                kept[-1] = kept[-2] and not kept[-1]
            elif directive == "%end":
                kept.pop()
            elif kept[-1]:
                yield self._line(line)

    def _has(self, name: str) -> bool:
        if name.endswith("*"):
            return any(self._beginning(half, name) for half in (self._telegram.setpoints, self._telegram.actuals))
        return name in self._flags or name in _names(self._telegram)

    def _line(self, line: str) -> str:
        if "{" not in line:
            return line
        whole = line.strip("{} ")
        if line.strip() == f"{{{whole}}}" and "\n" in self._values.get(whole, ""):
            return "\n".join(self._lines(self._values[whole]))
        found = _SET_BIT.match(line)
        if found is None:
            return _MACRO.sub(lambda macro: self._macro(macro[1]), line)
        indent, name, condition = found[1], found[2], _MACRO.sub(lambda macro: self._macro(macro[1]), found[3])
        signal, bit = self._bit(self._telegram.setpoints, name)
        word = f"Setpoints.{signal.name}"
        change = f"{word} := {word} OR 16#{bit.mask:04X};"
        return f"{indent}{change}" if condition == "TRUE" else f"{indent}IF {condition} THEN {change} END_IF;"

    def _macro(self, text: str) -> str:
        verb, _, name = text.partition(" ")
        if text in self._values:
            return self._values[text]
        if verb == "initial":
            return f" := {self._values[name]}" if name in self._values else ""
        if verb == "reason":
            return str(Reason[name].code)
        if verb == "word":
            return self._bit(self._telegram.setpoints, name)[0].name
        if verb == "top":
            bit = self._bit(self._telegram.setpoints, name)[1]
            return str(bit.mask >> bit.position)
        if verb in {"type", "full", "percent"}:
            signal = self._signal(name)
            if verb == "type":
                return plc_type(signal)
            return f"{_FULL[signal.type] / (100 if verb == 'percent' else 1):.2f}"
        if text.endswith("*"):
            return self._signal(text).name
        signal, bit = self._bit(self._telegram.actuals, text)
        return f"((Actual.{signal.name} AND 16#{bit.mask:04X}) <> 16#0000)"

    def _signal(self, name: str) -> Signal:
        for half in (self._telegram.setpoints, self._telegram.actuals):
            if found := self._beginning(half, name):
                return found
        raise KeyError(f"telegram {self._telegram.number} has no signal {name}")

    @staticmethod
    def _beginning(half: TelegramHalf, name: str) -> Signal | None:
        for signal in half.signals:
            if signal.name == name or (name.endswith("*") and signal.name.startswith(name[:-1])):
                return signal
        return None

    @staticmethod
    def _bit(half: TelegramHalf, name: str) -> tuple[Signal, Bit]:
        for signal, bit in _bits(half):
            if name in {bit.name, f"{signal.name}.{bit.name}"}:
                return signal, bit
        raise KeyError(f"telegram {half.telegram} has no bit {name}")
