"""``pdgw decode --hex``: what data is recognised as, and the record it becomes."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import float_pattern
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import RtFrame
from pdgw.profidrive.telegrams import Direction, Telegram, telegram
from pdgw.tools.decoder.frames.recognise import parse_hex, recognise, swapped_words
from pdgw.tools.decoder.frames.records import CyclicRecord, OtherRecord
from pdgw.tools.decoder.view.render import line_parts
from tests.support.axis.strategies import directions, half_values, telegrams
from tests.support.cli import pdgw

FRAME = "C001 047F 2000 80 80" + "00" * 34 + "0020 35 00"
WORDS = "axis 1 T1 STW1 047Fh NSOLL_A 50.000 %"
REQUEST, RESPONSE = (f"{call} of B02Fh (parameters, global), slot 0.1: " for call in ("write request", "read response"))

GOLDEN = [
    ("047F 2000", 1, None, ("PLC ->", "FrameID C001h counter 0 status 35h", WORDS)),
    ("047F 2000", None, None, ("PLC ->", "FrameID C001h counter 0 status 35h", WORDS)),
    (
        "0x0637 0x0666",
        1,
        "actual",
        ("PLC <-", "FrameID C000h counter 0 status 35h", "axis 1 T1 ZSW1 0637h NIST_A 9.998 %"),
    ),
    (FRAME, 1, None, ("PLC ->", "FrameID C001h counter 32 status 35h", WORDS)),
    ("047F 2000 80 80" + "00" * 34, 1, None, ("PLC ->", "FrameID C001h counter 0 status 35h", WORDS)),
    ("01 01 00 01 10 01 10 18 00 03", None, None, ("acyclic", REQUEST + "request parameter ref 1 DO 0 | 1018h.3", "")),
    ("01 01 01 00 01 10 18 10 00 03", None, None, ("acyclic", REQUEST + "request parameter ref 1 DO 0 | 1018h.3", "")),
    (
        "03 02 01 01 10 00 03 9A 00 00 42 01 00 09",
        None,
        None,
        ("acyclic", REQUEST + "change parameter ref 3 DO 1 | P922.0 = 9", ""),
    ),
    ("02 01 00 01 06 01 03 29", None, None, ("acyclic", RESPONSE + "request parameter ref 2 DO 0 | 809", "")),
    (
        "07 82 01 02 40 00 44 01 00 01",
        None,
        None,
        (
            "acyclic",
            RESPONSE + "change parameter ref 7 DO 1 | written | error 01h: parameter value cannot be changed",
            "",
        ),
    ),
]


@pytest.mark.parametrize(("text", "number", "direction", "parts"), GOLDEN)
def test_golden_lines(text: str, number: int | None, direction: str | None, parts: tuple[str, str, str]) -> None:
    chosen = [number] if number else []
    record = recognise(parse_hex(text), chosen, Direction(direction) if direction else None)
    assert line_parts(record) == parts
    json.dumps(record.document())


def test_a_frame_of_several_axes_has_all_their_words() -> None:
    record = recognise(bytes.fromhex("047F 2000 80 0C7F 80EF 80 80 80"), [1, 1])
    assert [unit.values for unit in record.units] == [(0x047F, 0x2000), (0x0C7F, -0x7F11)]


def test_actual_value_frame_is_recognised_by_its_frame_id() -> None:
    record = recognise(RtFrame(0xC000, bytes.fromhex("0637 2000 80 80"), 5).encode(), [1])
    assert isinstance(record, CyclicRecord)
    assert record.direction is Direction.ACTUAL
    signals = record.units[0].document()["signals"]
    assert signals["ZSW1"]["bits"]["OPERATION_ENABLED"] == 1
    assert signals["NIST_A"] == {"raw": 0x2000, "value": 50.0, "unit": "%", "bits": {}}


def test_a_frame_with_a_bad_status_is_still_a_frame() -> None:
    data = RtFrame(0xC000, bytes.fromhex("0637 2000 00 80"), 5, data_status=0, transfer_status=1).encode()
    document = recognise(data, [1]).document()
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
    (unit,) = recognise(half.encode(half.from_dict({"STW1": 0x0C7F, "SATZANW": 0x80EF})), [9]).units
    signals = unit.document()["signals"]
    assert signals["STW1"]["bits"]["START_HOMING"] == 1
    assert signals["SATZANW"]["bits"] == {"HOMING_METHOD": -17, "MDI": 1}


@given(data=st.data(), chosen=telegrams, direction=directions)
def test_telegram_words_of_every_telegram_come_back(
    data: st.DataObject, chosen: Telegram, direction: Direction
) -> None:
    half = chosen.half(direction)
    values = data.draw(half_values(half))
    (unit,) = recognise(half.encode(values), [chosen.number], direction).units
    assert (unit.layout.telegram, unit.layout.direction, tuple(unit.values)) == (chosen.number, direction, values)


@pytest.mark.parametrize(("position", "value"), [(12.5, 12.5), (float("nan"), None), (float("inf"), None)])
def test_a_float_has_its_number_as_value(position: float, value: float | None) -> None:
    half = telegram(112).setpoints
    (unit,) = recognise(half.encode(half.from_dict({"MDI_TARPOS_F": float_pattern(position)})), [112]).units
    signal = unit.document()["signals"]["MDI_TARPOS_F"]
    assert (signal["value"], signal["raw"]) == (value, float_pattern(position))
    if value is not None:
        assert "MDI_TARPOS_F 12.5 unit of length" in [item.text(raw) for item, raw in unit.items()]


@given(data=st.binary(min_size=1, max_size=100), chosen=st.one_of(st.none(), telegrams))
def test_arbitrary_data_is_decoded_or_refused_with_the_packages_error(data: bytes, chosen: Telegram | None) -> None:
    try:
        record = recognise(data, [] if chosen is None else [chosen.number])
    except ProfidriveError:
        return
    assert not isinstance(record, OtherRecord)
    json.dumps(record.document())


@given(data=st.binary(min_size=1, max_size=40), separator=st.sampled_from(["", " ", "\n", ", 0x", ":"]))
def test_hex_is_read_in_every_common_notation(data: bytes, separator: str) -> None:
    assert parse_hex(data.hex(separator[:1]) if separator == ":" else separator.join(f"{b:02x}" for b in data)) == data


@pytest.mark.parametrize(
    ("text", "message"),
    [("04zz", "hex at offset 2: 'z'"), ("047", "hex digits: 3"), ("", "hex digits: 0"), ("0x", "hex digits: 0")],
)
def test_bad_hex_is_rejected_with_its_offset(text: str, message: str) -> None:
    with pytest.raises(ProfidriveError, match=message):
        parse_hex(text)


def test_the_command_prints_the_documented_object_and_one_line_for_an_error() -> None:
    good = pdgw("decode", "--telegram", "1", "--json", "--hex", "047F 2000")
    assert good.returncode == 0
    sent, received = (json.loads(line)["units"][0]["signals"] for line in good.stdout.splitlines())
    assert (sent["NSOLL_A"]["value"], received["NIST_A"]["value"]) == (50.0, 50.0)
    bad = pdgw("decode", "--telegram", "1", "--json", "--hex", "047F 20")
    assert bad.returncode == 1
    assert "telegram 1 have 4 bytes" in bad.stderr
    assert "Traceback" not in bad.stderr


@pytest.mark.parametrize(
    ("words", "direction", "hint"),
    [
        ("7E04 0020", Direction.SETPOINT, "STW1 7E04h is 047Eh with its bytes swapped: check the byte order"),
        ("31EB 0000", Direction.ACTUAL, "ZSW1 31EBh is EB31h"),
        ("047F 2000", Direction.SETPOINT, ""),
        ("0000 0000", Direction.SETPOINT, ""),
        ("0400 0000", Direction.SETPOINT, ""),
        ("EB31 0000", Direction.ACTUAL, ""),
        ("7E04", Direction.SETPOINT, ""),
    ],
)
def test_words_with_swapped_bytes_get_a_hint(words: str, direction: Direction, hint: str) -> None:
    found = swapped_words(parse_hex(words), 1, direction)
    assert found.startswith(hint)
    assert bool(found) == bool(hint)
