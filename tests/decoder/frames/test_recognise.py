"""``pdgw decode --hex``: what data is recognised as, and the documents it becomes."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.decoder.frames.profinet.cyclic import CyclicDecoder, given_axes
from pdgw.decoder.frames.recognise import parse_hex, recognise
from pdgw.decoder.view.render import one_line, tree
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import C_SDU_MIN, RtFrame
from pdgw.profidrive.signals import float_pattern
from pdgw.profidrive.telegrams import Direction, Telegram, telegram
from tests.support.axis.strategies import directions, half_values, telegrams
from tests.support.cli import pdgw

FRAME = "C001 047F 2000 80 80" + "00" * 34 + "0020 35 00"

GOLDEN = [
    ("047F 2000", 1, None, "telegram | telegram 1 setpoint | STW1 047Fh | NSOLL_A 50.000 %"),
    ("0x0637 0x0666", 1, "actual", "telegram | telegram 1 actual | ZSW1 0637h | NIST_A 9.998 %"),
    (FRAME, 1, None, "frame | FrameID C001h counter 32 | telegram 1 setpoint | STW1 047Fh | NSOLL_A 50.000 %"),
    (FRAME, None, None, "frame | FrameID C001h counter 32"),
    ("047F 2000 80 80" + "00" * 34, 1, None, "c_sdu | telegram 1 setpoint | STW1 047Fh | NSOLL_A 50.000 %"),
    ("01 01 00 01 10 01 10 18 00 03", None, None, "parameter-request | request parameter ref 1 DO 0 | 1018h.3"),
    (
        "01 01 01 00 01 10 18 10 00 03",
        None,
        None,
        "parameter-request-swapped | request parameter ref 1 DO 0 | 1018h.3",
    ),
    (
        "03 02 01 01 10 00 03 9A 00 00 42 01 00 09",
        None,
        None,
        "parameter-request | change parameter ref 3 DO 1 | P922.0 = 9",
    ),
    ("02 01 00 01 06 01 03 29", None, None, "parameter-response | request parameter ref 2 DO 0 | 809"),
    (
        "07 82 01 02 40 00 44 01 00 01",
        None,
        None,
        "parameter-response | change parameter ref 7 DO 1 | written | error 01h: parameter value cannot be changed",
    ),
]


@pytest.mark.parametrize(("text", "number", "direction", "line"), GOLDEN)
def test_golden_lines(text: str, number: int | None, direction: str | None, line: str) -> None:
    chosen = telegram(number) if number else None
    document = recognise(parse_hex(text), chosen, Direction(direction) if direction else None)
    assert one_line(document) == line
    json.dumps(document)
    assert next(iter(tree(document))).startswith(document["kind"] + ": ")


def test_actual_value_frame_is_recognised_by_its_frame_id() -> None:
    data = RtFrame(0xC000, bytes.fromhex("0637 2000 80 80"), 5).encode()
    document = recognise(data, telegram(1))
    assert document["direction"] == "actual"
    assert document["signals"]["ZSW1"]["bits"]["OPERATION_ENABLED"] == 1
    assert document["signals"]["NIST_A"] == {"raw": 0x2000, "value": 50.0, "unit": "%", "bits": {}}


def test_a_frame_with_a_bad_status_is_still_a_frame() -> None:
    data = RtFrame(0xC000, bytes.fromhex("0637 2000 00 80"), 5, data_status=0, transfer_status=1).encode()
    document = recognise(data, telegram(1))
    assert document["kind"] == "frame"
    assert document["data_status"] == {
        "raw": 0,
        "primary": False,
        "data_valid": False,
        "run": False,
        "no_problem": False,
    }
    assert document["transfer_status"] == 1


def test_positioning_meanings_and_signed_fields() -> None:
    half = telegram(9).setpoints
    data = half.encode(half.from_dict({"STW1": 0x0C7F, "SATZANW": 0x80EF}))
    signals = recognise(data, telegram(9))["signals"]
    assert signals["STW1"]["bits"]["START_HOMING"] == 1
    assert signals["SATZANW"]["bits"] == {"HOMING_METHOD": -17, "MDI": 1}


@given(data=st.data(), chosen=telegrams, direction=directions)
def test_telegram_words_of_every_telegram_come_back(
    data: st.DataObject, chosen: Telegram, direction: Direction
) -> None:
    half = chosen.half(direction)
    values = data.draw(half_values(half))
    document = recognise(half.encode(values), chosen, direction)
    assert document["kind"] == "telegram"
    assert tuple(item["raw"] for item in document["signals"].values()) == values


@pytest.mark.parametrize(("position", "value"), [(12.5, 12.5), (float("nan"), None), (float("inf"), None)])
def test_a_float_has_its_number_as_value_in_a_piece_of_data_and_in_a_capture(
    position: float, value: float | None
) -> None:
    half = telegram(112).setpoints
    data = half.encode(half.from_dict({"MDI_TARPOS_F": float_pattern(position)}))
    frame = RtFrame(0xC001, (data + bytes([0x80, 0x80])).ljust(C_SDU_MIN, b"\0"), 5).encode()
    (unit,) = CyclicDecoder(given_axes([112]), print).decode(1, 0, "", frame).units
    for signals in (recognise(data, telegram(112))["signals"], unit.document()["signals"]):
        assert signals["MDI_TARPOS_F"]["value"] == value
        assert signals["MDI_TARPOS_F"]["raw"] == float_pattern(position)
    if value is not None:
        assert "MDI_TARPOS_F 12.5 unit of length" in one_line(recognise(data, telegram(112)))
        assert "MDI_TARPOS_F 12.5 unit of length" in [item.text(raw) for item, raw in unit.items()]


@given(data=st.binary(min_size=1, max_size=100), chosen=st.one_of(st.none(), telegrams))
def test_arbitrary_data_is_decoded_or_refused_with_the_packages_error(data: bytes, chosen: Telegram | None) -> None:
    try:
        document = recognise(data, chosen)
    except ProfidriveError:
        return
    assert one_line(document)
    json.dumps(document)


@given(data=st.binary(min_size=1, max_size=40), separator=st.sampled_from(["", " ", "\n", ", 0x", ":"]))
def test_hex_is_read_in_every_common_notation(data: bytes, separator: str) -> None:
    assert parse_hex(data.hex(separator[:1]) if separator == ":" else separator.join(f"{b:02x}" for b in data)) == data


@pytest.mark.parametrize(
    ("text", "message"),
    [("04zz", "hex at offset 2: 'z'"), ("047", "hex digits: 3"), ("", "hex digits: 0"), ("0x", "hex digits: 0")],
)
def test_bad_hex_is_told_with_its_offset(text: str, message: str) -> None:
    with pytest.raises(ProfidriveError, match=message):
        parse_hex(text)


def test_the_command_prints_the_documented_object_and_one_line_for_an_error() -> None:
    good = pdgw("decode", "--telegram", "1", "--json", "--hex", "047F 2000")
    assert good.returncode == 0
    document = json.loads(good.stdout)
    assert set(document) >= {"kind", "signals"}
    assert document["signals"]["NSOLL_A"]["value"] == 50.0
    bad = pdgw("decode", "--telegram", "1", "--json", "--hex", "047F 20")
    assert bad.returncode == 1
    assert "telegram 1 have 4 bytes" in bad.stderr
    assert "Traceback" not in bad.stderr
