"""Everything a PLC can send to the power stage of an axis: each class of control word once, and no frame at all."""

from __future__ import annotations

from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from pdgw.workshop.walk.values import Plc

STW1 = signal("STW1")
CONTROL = STW1.bit("CONTROL_BY_PLC").mask
ACKNOWLEDGE = STW1.bit("FAULT_ACKNOWLEDGE").mask
ENABLES_SETPOINT = (
    STW1.bit("ENABLE_RAMP_GENERATOR").mask | STW1.bit("UNFREEZE_RAMP_GENERATOR").mask | STW1.bit("ENABLE_SETPOINT").mask
)
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
_HALF = {"NSOLL_A": 0x2000, "NSOLL_B": 0x2000 << 16}
"""Half the reference speed."""
LOST = Plc("no PLC", None)


def _frame(number: int, name: str, word: int) -> Plc:
    names = telegram(number).setpoints.names
    return Plc(
        f"{name:13} STW1 {word:04X}", tuple(word if i == 0 else _HALF.get(n, 0) for i, n in enumerate(names)), word
    )


def speed_words(number: int) -> list[Plc]:
    """Of a telegram with STW1 and a speed; the setpoint stands at 50 %."""
    with_control = CONTROL | ENABLES_SETPOINT
    frames = [LOST]
    frames += [_frame(number, name, bits | with_control) for bits, name in _NAMES.items()]
    frames += [_frame(number, f"{_NAMES[bits]} ack", bits | with_control | ACKNOWLEDGE) for bits in (OFF1, ENABLE)]
    frames += [_frame(number, f"{_NAMES[bits]} no ctrl", bits | ENABLES_SETPOINT) for bits in (OFF1, ON, ENABLE)]
    frames.append(_frame(number, "zeros", 0))
    return frames
