"""Telegram declarations and their codec: tables of the reference, and worked examples of positioner and drive telegrams.

In the examples a revolution has 10000 LU, and the reference speed is 3000 rpm.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.scapy_layers import telegram_layer
from pdgw.profidrive.signals import CATALOGUE, POSITIONER_FORMS, SIGNALS, Signal, signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Direction, Telegram, TelegramHalf, likeliest, telegram
from tests.support.axis.strategies import directions, half_values, telegrams
from tests.support.documents.profile_numbers import word_positions

WORDS = {1: (2, 2), 2: (4, 4), 3: (5, 9), 7: (2, 2), 9: (10, 5), 20: (2, 6), 100: (19, 17)}
ENCODER_WORDS = {81: (2, 6), 82: (2, 7), 83: (2, 8), 84: (2, 10)}
MOTION_WORDS = {
    4: (6, 14),
    5: (9, 9),
    6: (10, 14),
    102: (6, 10),
    103: (7, 15),
    105: (10, 10),
    106: (11, 15),
    110: (12, 7),
    111: (12, 12),
}

TELEGRAM_100_SETPOINT_WORDS = {
    "Controlword": 1,
    "Modes of Operation": 2,
    "Target Torque": 3,
    "Target Position": 4,
    "Profile Velocity": 6,
    "Profile Acceleration": 8,
    "Profile Deceleration": 10,
    "Dynamic Speed Limit": 12,
    "Dynamic Torque Limit": 13,
    "Digital Outputs": 14,
    "Digital Outputs Mask": 16,
    "Target Velocity": 18,
}
TELEGRAM_100_ACTUAL_WORDS = {
    "Statusword": 1,
    "Modes of Operation Display": 2,
    "Position Actual Value": 3,
    "Velocity Demand Value": 5,
    "Velocity Actual Value": 7,
    "Current Actual Value": 9,
    "DC-link Circuit Voltage": 10,
    "Digital Inputs": 12,
    "Analogue Input 1": 14,
    "Analogue Input 2": 15,
    "Encoder Position Value": 16,
    "Error Code": 17,
}


@pytest.mark.parametrize(("number", "words"), sorted((WORDS | ENCODER_WORDS | MOTION_WORDS).items()))
def test_telegram_has_the_words_of_the_standard(number: int, words: tuple[int, int]) -> None:
    assert (telegram(number).setpoints.words, telegram(number).actuals.words) == words


@pytest.mark.parametrize(
    ("number", "direction", "words"),
    [
        (4, Direction.SETPOINT, {"NSOLL_B": 2, "STW2": 4, "G1_STW": 5, "G2_STW": 6}),
        (
            4,
            Direction.ACTUAL,
            {"G1_ZSW": 5, "G1_XIST1": 6, "G1_XIST2": 8, "G2_ZSW": 10, "G2_XIST1": 11, "G2_XIST2": 13},
        ),
        (5, Direction.SETPOINT, {"G1_STW": 5, "XERR": 6, "KPC": 8}),
        (6, Direction.SETPOINT, {"G2_STW": 6, "XERR": 7, "KPC": 9}),
        (102, Direction.SETPOINT, {"NSOLL_B": 2, "STW2": 4, "MOMRED": 5, "G1_STW": 6}),
        (102, Direction.ACTUAL, {"MELDW": 5, "G1_ZSW": 6, "G1_XIST1": 7, "G1_XIST2": 9}),
        (103, Direction.ACTUAL, {"G2_ZSW": 11, "G2_XIST1": 12, "G2_XIST2": 14}),
        (105, Direction.SETPOINT, {"XERR": 7, "KPC": 9}),
        (106, Direction.SETPOINT, {"G2_STW": 7, "XERR": 8, "KPC": 10}),
        (110, Direction.SETPOINT, {"POS_STW": 3, "STW2": 4, "OVERRIDE": 5, "MDI_TARPOS": 6, "MDI_MOD": 12}),
        (110, Direction.ACTUAL, {"AKTSATZ": 2, "POS_ZSW": 3, "ZSW2": 4, "MELDW": 5, "XIST_A": 6}),
        (
            111,
            Direction.SETPOINT,
            {"POS_STW1": 2, "POS_STW2": 3, "OVERRIDE": 5, "MDI_VELOCITY": 8, "MDI_ACC": 10, "USER": 12},
        ),
        (
            111,
            Direction.ACTUAL,
            {"POS_ZSW2": 3, "XIST_A": 6, "NIST_B": 8, "FAULT_CODE": 10, "WARN_CODE": 11, "USER": 12},
        ),
    ],
)
def test_signals_of_motion_telegrams_have_the_offsets_of_real_drives(
    number: int, direction: Direction, words: dict[str, int]
) -> None:
    half = telegram(number).half(direction)
    places = dict(zip(half.names, word_positions(half), strict=True))
    assert {name: places[name] for name in words} == words


def test_length_units_and_block_numbers_are_for_the_positioner_alone() -> None:
    for number, name, unit in ((9, "MDI_TARPOS", "%"), (110, "MDI_TARPOS", "LU"), (111, "MDI_VELOCITY", "1000 LU/min")):
        half = telegram(number).setpoints
        assert half.signals[half.index(name)].unit == unit
    for number, field in ((7, "BLOCK"), (110, "BLOCK"), (9, "HOMING_METHOD")):
        half = telegram(number).setpoints
        assert next(half.signals[half.index("SATZANW")].fields(positioning=True)).name == field


def test_a_form_of_the_positioner_has_the_number_and_width_of_the_catalogues() -> None:
    for name, form in POSITIONER_FORMS.items():
        assert (form.number, form.words) == (signal(name).number, signal(name).words)


def test_of_equally_long_telegrams_the_more_common_one_is_assumed() -> None:
    assert likeliest([6, 9, 105]) == 9
    assert likeliest([4, 102]) == 102
    assert likeliest([82, 81]) == 81


def test_telegram_100_has_the_manufacturers_offsets() -> None:
    manufacturer = telegram(100)
    setpoints, actuals = manufacturer.setpoints, manufacturer.actuals
    assert dict(zip(setpoints.names, word_positions(setpoints), strict=True)) == TELEGRAM_100_SETPOINT_WORDS
    assert dict(zip(actuals.names, word_positions(actuals), strict=True)) == TELEGRAM_100_ACTUAL_WORDS


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("STW1", 1),
        ("ZSW1", 2),
        ("NSOLL_A", 5),
        ("NIST_A", 6),
        ("XIST_A", 28),
        ("SATZANW", 32),
        ("AKTSATZ", 33),
        ("MDI_TARPOS", 34),
        ("MDI_VELOCITY", 35),
        ("MDI_ACC", 36),
        ("MDI_DEC", 37),
        ("MDI_MOD", 38),
        ("G2_STW", 13),
        ("G2_XIST2", 16),
        ("XERR", 25),
        ("KPC", 26),
        ("MOMRED", 101),
        ("MELDW", 102),
        ("POS_STW", 203),
        ("POS_ZSW", 204),
        ("OVERRIDE", 205),
        ("POS_STW1", 220),
        ("POS_ZSW1", 221),
        ("POS_STW2", 222),
        ("POS_ZSW2", 223),
        ("FAULT_CODE", 301),
        ("WARN_CODE", 303),
    ],
)
def test_signal_numbers_are_those_of_profidrive(name: str, number: int) -> None:
    assert signal(name).number == number


def test_catalogue_has_no_name_or_number_twice_and_bits_do_not_overlap() -> None:
    assert len(SIGNALS) == len(CATALOGUE)
    numbers = [item.number for item in CATALOGUE if item.number]
    assert len(set(numbers)) == len(numbers)
    for item in (*CATALOGUE, *POSITIONER_FORMS.values()):
        for positioning in (False, True):
            used = 0
            for bit in item.fields(positioning=positioning):
                assert not used & bit.mask, f"{item.name} bit {bit.position} declared twice"
                used |= bit.mask
            assert used < 1 << (8 * item.type.size)


def test_stw1_bits_change_meaning_in_the_positioning_telegrams() -> None:
    stw1 = signal("STW1")
    assert stw1.bit("ENABLE_SETPOINT").position == 6
    assert stw1.bit("ACTIVATE_TASK", positioning=True).position == 6
    with pytest.raises(ProfidriveError, match="ACTIVATE_TASK"):
        stw1.bit("ACTIVATE_TASK")


@given(data=st.data(), chosen=telegrams, direction=directions)
def test_decode_is_the_inverse_of_encode(data: st.DataObject, chosen: Telegram, direction: Direction) -> None:
    half = chosen.half(direction)
    values = data.draw(half_values(half))
    assert half.decode(half.encode(values)) == values
    frame = bytearray(half.size + 3)
    half.encode_into(frame, 3, values)
    assert half.decode(frame, 3) == values
    assert half.from_dict(half.as_dict(values)) == values


@given(raw=st.binary(max_size=48), chosen=telegrams, direction=directions)
def test_arbitrary_bytes_decode_or_raise_the_packages_error(raw: bytes, chosen: Telegram, direction: Direction) -> None:
    half = chosen.half(direction)
    if len(raw) >= half.size:
        assert half.encode(half.decode(raw)) == raw[: half.size]
    else:
        with pytest.raises(ProfidriveError, match=f"at least {half.size} bytes"):
            half.decode(raw)


def test_a_value_that_does_not_fit_is_named() -> None:
    half = telegram(9).setpoints
    with pytest.raises(ProfidriveError, match=r"MDI_ACC: 40000 is not allowed, expected an integer in -32768\.\.32767"):
        half.encode(half.from_dict({"MDI_ACC": 40000}))
    with pytest.raises(ProfidriveError, match="8 values: STW1"):
        half.encode((1, 2))
    with pytest.raises(ProfidriveError, match="NSOLL_A"):
        half.from_dict({"NSOLL_A": 1})


def test_unknown_telegram_lists_the_known_ones() -> None:
    with pytest.raises(ProfidriveError, match="telegram: 113 is not allowed, expected one of") as error:
        telegram(113)
    assert all(str(number) in error.value.allowed for number in TELEGRAMS)


def test_a_word_is_built_from_the_names_of_its_bits() -> None:
    stw1 = signal("STW1")
    assert stw1.word() == 0
    assert stw1.word("ON", "CONTROL_BY_PLC") == 0x0401
    names = [bit.name for bit in stw1.bits]
    assert stw1.word(*names) == sum(bit.mask for bit in stw1.bits)
    assert (
        stw1.word("NO_INTERMEDIATE_STOP", positioning=True) == stw1.bit("NO_INTERMEDIATE_STOP", positioning=True).mask
    )
    with pytest.raises(ProfidriveError, match="OFF1"):
        stw1.word("OFF1")


@given(st.sampled_from([s for s in SIGNALS.values() if s.type in {DataType.N2, DataType.N4}]), st.data())
def test_percent_and_raw_are_each_others_inverse(chosen: Signal, data: st.DataObject) -> None:
    low, high = chosen.type.integer_range
    raw = data.draw(st.integers(low, high))
    percent = chosen.percent(raw)
    assert percent is not None
    assert chosen.raw(percent) == raw


@pytest.mark.parametrize(
    ("name", "percent"), [("NSOLL_A", 200.0), ("NSOLL_A", -200.1), ("STW1", 1.0), ("NSOLL_A", float("nan"))]
)
def test_a_percentage_that_does_not_fit_is_refused(name: str, percent: float) -> None:
    with pytest.raises(ProfidriveError, match="percent"):
        signal(name).raw(percent)


# -- worked examples --------------------------------------------------------------------------------------------------


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
