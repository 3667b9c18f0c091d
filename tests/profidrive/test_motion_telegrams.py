"""Worked examples of the positioner and drive telegrams: words on the wire and what they say, bit by bit.

L = 10000 LU per revolution, 3000 rpm reference speed.
"""

from __future__ import annotations

import pytest

from pdgw.profidrive.scapy_layers import telegram_layer
from pdgw.profidrive.telegrams import ApplicationMode, Direction, TelegramHalf, telegram

_ENABLED = {"ON", "NO_COAST_STOP", "NO_QUICK_STOP", "ENABLE_OPERATION", "CONTROL_BY_PLC"}
_TASK = {*_ENABLED, "DO_NOT_REJECT", "NO_INTERMEDIATE_STOP", "ACTIVATE_TASK"}
_OPERATING = {"READY_TO_SWITCH_ON", "READY_TO_OPERATE", "OPERATION_ENABLED", "NO_COAST_STOP", "NO_QUICK_STOP"}


def half(number: int, direction: Direction = Direction.SETPOINT) -> TelegramHalf:
    return telegram(number).half(direction)


def decode(layout: TelegramHalf, text: str) -> dict[str, int]:
    data = bytes.fromhex(text)
    values = layout.decode(data)
    assert layout.encode(values) == data
    layer = telegram_layer(layout.telegram, layout.direction)(data)
    assert [getattr(layer, name) for name in layout.names] == list(values), "scapy reads other values"
    return layout.as_dict(values)


def bits(layout: TelegramHalf, name: str, word: int) -> set[str]:
    """The names of the bits set, as ``NAME=value`` for numbers in bit ranges."""
    signal = layout.signals[layout.index(name)]
    fields = list(signal.fields(positioning=layout.mode is ApplicationMode.POSITIONING))
    assert not word & ~sum(field.mask for field in fields), f"{name} {word:04X}h has bits without a name"
    return {field.name if field.width == 1 else f"{field.name}={field.of(word)}" for field in fields if field.of(word)}


def test_111_absolute_to_50000_lu() -> None:
    layout = half(111)
    values = decode(layout, "047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000")
    assert bits(layout, "STW1", values["STW1"]) == _TASK
    assert bits(layout, "POS_STW1", values["POS_STW1"]) == {"MDI", "ABSOLUTE"}
    assert (values["MDI_TARPOS"], values["MDI_VELOCITY"]) == (50000, 12000)
    percents = {item.name: item.percent(values[item.name]) for item in layout.signals}
    assert (percents["OVERRIDE"], percents["MDI_ACC"], percents["MDI_DEC"]) == (100, 100, 100)


@pytest.mark.parametrize(
    ("word", "set_bits"),
    [
        ("8000", {"MDI"}),
        ("C400", {"MDI", "SETTING_UP", "NEGATIVE_DIRECTION"}),
        ("0005", {"BLOCK=5"}),
        ("9100", {"MDI", "ABSOLUTE", "CONTINUOUS_UPDATE"}),
    ],
)
def test_111_modes_of_the_positioner(word: str, set_bits: set[str]) -> None:
    layout = half(111)
    values = decode(layout, f"047F {word} 0000 0000 2000 0000 0000 0000 0000 0000 0000 0000")
    assert bits(layout, "POS_STW1", values["POS_STW1"]) == set_bits
    assert values["OVERRIDE"] == 0x2000


def test_111_jog_1() -> None:
    assert bits(half(111), "STW1", 0x053F) == {*_TASK - {"ACTIVATE_TASK"}, "JOG_1_ON"}


@pytest.mark.parametrize(
    ("zsw1", "shown"),
    [
        (0x1B37, {*_OPERATING, "WITHIN_TOLERANCE", "CONTROL_REQUESTED", "HOME_POSITION_SET", "TASK_ACKNOWLEDGE"}),
        (
            0x3F37,
            {
                *_OPERATING,
                *("WITHIN_TOLERANCE", "CONTROL_REQUESTED", "HOME_POSITION_SET", "TASK_ACKNOWLEDGE"),
                *("TARGET_REACHED", "DRIVE_STOPPED"),
            },
        ),
    ],
)
def test_111_moving_and_reached(zsw1: int, shown: set[str]) -> None:
    layout = half(111, Direction.ACTUAL)
    values = decode(layout, f"{zsw1:04X} 8000 8010 0000 0000 0000 C350 1999 9999 0000 0000 0000")
    assert bits(layout, "ZSW1", values["ZSW1"]) == shown
    assert bits(layout, "POS_ZSW1", values["POS_ZSW1"]) == {"MDI_ACTIVE"}
    assert bits(layout, "POS_ZSW2", values["POS_ZSW2"]) == {"TRAVERSING", "MOVES_FORWARD"}
    assert values["XIST_A"] == 50000
    assert values["NIST_B"] * 3000 // (1 << 30) == 1199, "1200 rpm truncated toward zero"


def test_105_position_error_and_gain_of_the_controller_in_the_plc() -> None:
    values = decode(half(105), "047F 0000 0000 0000 0000 0000 0000 0800 0000 C350")
    assert (values["XERR"], values["KPC"], values["NSOLL_B"]) == (2048, 50_000, 0)


def test_105_position_error_is_signed() -> None:
    assert decode(half(105), "047F 0000 0000 0000 0000 0000 FFFF F800 0000 C350")["XERR"] == -2048


def test_102_750_rpm_at_half_torque() -> None:
    layout = half(102)
    values = decode(layout, "047F 1000 0000 0000 2000 0000")
    percents = {item.name: item.percent(values[item.name]) for item in layout.signals}
    assert (percents["NSOLL_B"], percents["MOMRED"]) == (25, 50)
