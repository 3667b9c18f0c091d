"""Everything a PLC can command: each class of control word once, and no frame at all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from struct import pack

from pdgw.gateway.axis.telegrams import (
    CENTRAL_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
)
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.long.walk.values import Life, Plc

STW1 = signal("STW1")
CONTROL = STW1.bit("CONTROL_BY_PLC").mask
ACKNOWLEDGE = STW1.bit("FAULT_ACKNOWLEDGE").mask
ENABLES_SETPOINT = (
    STW1.bit("ENABLE_RAMP_GENERATOR").mask | STW1.bit("UNFREEZE_RAMP_GENERATOR").mask | STW1.bit("ENABLE_SETPOINT").mask
)
ACTIVATE = STW1.bit("ACTIVATE_TASK", positioning=True).mask
HOME = STW1.bit("START_HOMING", positioning=True).mask
JOG = STW1.bit("JOG_1_ON", positioning=True).mask
FUNCTIONS = ACTIVATE | HOME | JOG
"""Bits whose rising edge starts a motion."""
DO_NOT_REJECT = STW1.bit("DO_NOT_REJECT", positioning=True).mask
NO_INTERMEDIATE_STOP = STW1.bit("NO_INTERMEDIATE_STOP", positioning=True).mask
READY_FOR_TASKS = DO_NOT_REJECT | NO_INTERMEDIATE_STOP
OFF1, OFF2, OFF3, ON, ENABLE = 0b1110, 0b1101, 0b1011, 0b0111, 0b1111
OFF1_DISABLED, OFF3_DISABLED = 0b0110, 0b0011
"""Bits 0-3 of STW1."""
_NAMES = {
    OFF1: "OFF1",
    OFF1_DISABLED: "OFF1 disable",
    OFF2: "OFF2",
    OFF3: "OFF3",
    OFF3_DISABLED: "OFF3 disable",
    ON: "ON",
    ENABLE: "ON+enable",
}
_SHORT = (OFF1, OFF2, OFF3, ON, ENABLE)
VALUES = {
    "NSOLL_A": 0x2000,
    "NSOLL_B": 0x2000 << 16,
    "XERR": 1000,
    "KPC": 1000,
    "POS_STW1": signal("POS_STW1").bit("MDI").mask | signal("POS_STW1").bit("ABSOLUTE").mask,
    "MDI_TARPOS": 1000,
    "MDI_VELOCITY": 6144,  # 1500 rpm, as NSOLL_A
    "MDI_ACC": 0x4000,
    "MDI_DEC": 0x4000,
    "MDI_MOD": signal("MDI_MOD").bit("ABSOLUTE").mask,
    "MDI_TARPOS_F": int.from_bytes(pack(">f", 1000.0), "big"),
    "MDI_VELOCITY_F": int.from_bytes(pack(">f", 6144.0), "big"),
    "MDI_ACC_F": int.from_bytes(pack(">f", 100.0), "big"),
    "MDI_DEC_F": int.from_bytes(pack(">f", 100.0), "big"),
    "OVERRIDE": 0x4000,
    "Target Velocity": 1500,
    "Modes of Operation": 3,
}
"""Constant setpoints; the others are 0."""
MDI = 0x8000
HOMING_METHOD = 35
OF_TELEGRAM = {
    9: {"SATZANW": MDI | HOMING_METHOD, "MDI_TARPOS": 0x1000_0000, "MDI_VELOCITY": 0x2000_0000},
}
"""In telegram 9 they are fractions of a reference value. In the others SATZANW selects traversing block 0."""
RAW = 100
"""The telegram that carries the Controlword itself."""
LOST = Plc("no PLC", None)


def frame(number: int, name: str, word: int, **values: int) -> Plc:
    """A frame of a telegram with constant setpoints, or with these values."""
    chosen = VALUES | OF_TELEGRAM.get(number, {}) | values
    setpoints = (chosen.get(item, 0) for item in telegram(number).setpoints.names[1:])
    return Plc(f"{name} {word:04X}", (word, *setpoints), word)


def frames(number: int, *, homing: bool, jog: bool, full: bool) -> list[Plc]:
    """What a PLC can send in one cycle. ``homing`` and ``jog``: with these functions of telegrams with tasks.

    ``full``: also words that differ only by Disable Operation, or by bits without effect.
    """
    tasks = number in TASK_TELEGRAM_NUMBERS
    standing = 0 if number == RAW else READY_FOR_TASKS if tasks else ENABLES_SETPOINT
    control = 0 if number == RAW else CONTROL
    words = {f"{_NAMES[bits]}": bits | standing | control for bits in (_NAMES if full else _SHORT)}
    words |= {f"{_NAMES[bits]} ack": bits | standing | control | ACKNOWLEDGE for bits in (OFF1, ENABLE)[: 1 + full]}
    if number != RAW:
        without = (OFF1, OFF3, ON, ENABLE) if full else (OFF1, OFF3, ENABLE)
        words |= {f"{_NAMES[bits]} without control": bits | standing for bits in without}
        words["zeros"] = 0
    if tasks:
        enable = ENABLE | standing | control
        words |= {
            "task": enable | ACTIVATE,
            "intermediate stop": enable & ~NO_INTERMEDIATE_STOP,
            "reject": enable & ~DO_NOT_REJECT,
        }
        for name, chosen_bit in (("homing", HOME),) * homing + (("jog", JOG),) * jog:
            words |= {name: enable | chosen_bit, f"OFF1 {name}": OFF1 | standing | control | chosen_bit}
    made = [frame(number, name, word) for name, word in words.items()]
    if number in DSC_TELEGRAM_NUMBERS:
        made.append(
            next(item for item in made if item.word & ENABLE == ENABLE)._replace(name="ON+enable, old", fresh=False)
        )
    return [LOST, *made]


def with_life(made: Iterable[Plc]) -> Iterator[Plc]:
    """Each frame with a counting and with an unchanged sign of life. The PLC of ``RAW`` and similar telegrams has none."""
    for item in made:
        if item.setpoints is None:
            yield item
        else:
            yield from (
                item._replace(name=f"{item.name} {life.value}", life=life) for life in (Life.COUNTS, Life.CONSTANT)
            )


def stops(made: Iterable[Plc]) -> list[Plc]:
    """The absence of a frame, OFF1, OFF2, OFF3 and ON among these frames."""
    words = {bits | CONTROL for bits in (OFF1, OFF2, OFF3, ENABLE)}
    return [item for item in made if item is LOST or item.word & (ENABLE | CONTROL | ACKNOWLEDGE) in words]


def is_central(number: int) -> bool:
    """Whether the gateway generates the ramps of a telegram itself (DSC)."""
    return number in CENTRAL_TELEGRAM_NUMBERS and "XERR" in telegram(number).setpoints.names
