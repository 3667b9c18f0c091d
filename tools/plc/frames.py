"""Structured Text (second edition) for the data types of the telegrams and the blocks that write and read UDP frames.

Frames are big-endian and written byte by byte, whatever the byte order of the PLC. On PROFINET the PLC's driver does this:
there the types and the access to the submodules are enough.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from pdgw.gateway.configuration.byte_map import AxisMap, FrameMap, Place
from pdgw.profidrive.frame import FRAME_ID_TO_CONTROLLER, FRAME_ID_TO_DEVICE, IOPS_GOOD, STATUS_NORMAL, TICK
from pdgw.profidrive.telegrams import Direction, TelegramHalf

_KINDS = {Direction.SETPOINT: "SET", Direction.ACTUAL: "ACT"}
_BITS = {1: "BYTE", 2: "WORD", 4: "DWORD", 8: "LWORD"}
_RESERVED = {"PROGRAM", "TIME", "DATE", "WORD", "BYTE", "LIMIT", "MODE", "OVERRIDE"}
LOST_AFTER = 50
"""Calls of PDGW_Read without a new frame after which the actual values count as invalid."""


def identifier(name: str) -> str:
    """Convert a name to an identifier of these languages."""
    text = re.sub(r"_+", "_", re.sub(r"\W", "_", name)).strip("_")
    return f"{text}_VALUE" if text.upper() in _RESERVED else text


def type_of(half: TelegramHalf) -> str:
    """Name of a telegram's structure."""
    return f"PDGW_T{half.telegram}_{_KINDS[half.direction]}"


def comment(text: str) -> str:
    """Format a comment that every edition of the standard accepts."""
    return f"(* {text} *)"


def frame_code(maps: tuple[FrameMap, FrameMap], step: int) -> Iterator[str]:
    """Generate the types, PDGW_Build and PDGW_Read. ``step``: increment of the cycle counter."""
    for name, axis in {type_of(axis.half): axis for frame in maps for axis in frame.axes}.items():
        yield from _structure(name, axis)
    sending, receiving = maps
    yield comment(f"UDP: {sending.size} bytes to the gateway, {receiving.size} bytes back, one frame each cycle")
    # What PDGW_Build leaves 0 is for the program: only the gateway's newest frame has it.
    copied, to = receiving.trailer - TICK.size, sending.trailer - TICK.size
    yield comment(f"Tick: copy received[{copied}..{copied + 3}] to sent[{to}..{to + 3}] after PDGW_Build (docs/plc.md)")
    yield from _build(sending, step)
    yield from _read(receiving)


def _structure(name: str, axis: AxisMap) -> Iterator[str]:
    yield f"TYPE {name} : STRUCT"
    for place in axis.places:
        if place.signal is not None:
            said = "; ".join(part for part in (place.description, place.full or place.unit) if part)
            yield f"    {identifier(place.name)} : {place.type}; {comment(said)}"
    yield "END_STRUCT; END_TYPE"
    yield ""


def block(name: str, sections: Sequence[tuple[str, Sequence[str]]], body: Sequence[str]) -> Iterator[str]:
    """Format a function block."""
    yield f"FUNCTION_BLOCK {name}"
    for kind, lines in sections:
        yield from (kind, *(f"    {line}" for line in lines), "END_VAR")
    yield from (f"    {line}" for line in body)
    yield "END_FUNCTION_BLOCK"
    yield ""


def _build(frame: FrameMap, step: int) -> Iterator[str]:
    """The block that writes the PLC's frame."""
    inputs = [f"axis_{axis.do_id} : {type_of(axis.half)};" for axis in frame.axes]
    inputs += [f"good_{axis.do_id} : BOOL; {comment('from PDGW_Read: actual values arrive')}" for axis in frame.axes]
    body = [_byte(0, f"16#{FRAME_ID_TO_DEVICE >> 8:02X}"), _byte(1, f"16#{FRAME_ID_TO_DEVICE & 0xFF:02X}")]
    for axis in frame.axes:
        for place in axis.places:
            if place.signal is not None:
                body += _bytes_of(place, f"axis_{axis.do_id}.{identifier(place.name)}")
        body.append(_byte(axis.iops, f"16#{IOPS_GOOD:02X}"))
    for axis in frame.axes:
        good, bad = _byte(axis.iocs, f"16#{IOPS_GOOD:02X}"), _byte(axis.iocs, "16#00")
        body.append(f"IF good_{axis.do_id} THEN {good} ELSE {bad} END_IF;")
    body += [
        f"counter := counter + {step};",
        _byte(frame.trailer, "WORD_TO_BYTE(SHR(IN := UINT_TO_WORD(counter), N := 8))"),
        _byte(frame.trailer + 1, "WORD_TO_BYTE(UINT_TO_WORD(counter))"),
        _byte(frame.trailer + 2, f"16#{STATUS_NORMAL:02X}"),
        _byte(frame.trailer + 3, "16#00"),
    ]
    sections = [
        ("VAR_INPUT", inputs),
        ("VAR_OUTPUT", [f"frame : ARRAY[0..{frame.size - 1}] OF BYTE;"]),
        ("VAR", ["counter : UINT;"]),
    ]
    yield from block("PDGW_Build", sections, body)


def _byte(offset: int, value: str) -> str:
    return f"frame[{offset}] := {value};"


def _bytes_of(place: Place, value: str) -> Iterator[str]:
    """Assign one value to its bytes, high byte first."""
    bits = _BITS[place.length]
    whole = value if place.type == bits else f"{place.type}_TO_{bits}({value})"
    for position in range(place.length):
        shift = 8 * (place.length - 1 - position)
        part = f"SHR(IN := {whole}, N := {shift})" if shift else whole
        yield _byte(place.in_frame + position, part if bits == "BYTE" else f"{bits}_TO_BYTE({part})")


def _read(frame: FrameMap) -> Iterator[str]:
    """The block that reads the gateway's frame. The values become invalid after too long without a new valid frame."""
    outputs = [f"axis_{axis.do_id} : {type_of(axis.half)};" for axis in frame.axes]
    for axis in frame.axes:
        outputs.append(f"good_{axis.do_id} : BOOL; {comment('IOPS: the values are valid')}")
        outputs.append(f"used_{axis.do_id} : BOOL; {comment('IOCS: the gateway uses the setpoints')}")
    valid = [
        f"frame[0] = 16#{FRAME_ID_TO_CONTROLLER >> 8:02X}",
        f"frame[1] = 16#{FRAME_ID_TO_CONTROLLER & 0xFF:02X}",
        f"(frame[{frame.trailer + 2}] AND 16#05) = 16#05",
        f"(NOT seen OR frame[{frame.trailer}] <> high OR frame[{frame.trailer + 1}] <> low)",
    ]
    body = [f"IF {' AND '.join(valid)} THEN"]
    for axis in frame.axes:
        body += [
            f"    axis_{axis.do_id}.{identifier(place.name)} := {_value(place)};"
            for place in axis.places
            if place.signal is not None
        ]
        body.append(f"    good_{axis.do_id} := (frame[{axis.iops}] AND 16#80) = 16#80;")
        body.append(f"    used_{axis.do_id} := (frame[{axis.iocs}] AND 16#80) = 16#80;")
    body += [
        f"    high := frame[{frame.trailer}];",
        f"    low := frame[{frame.trailer + 1}];",
        "    seen := TRUE;",
        "    missed := 0;",
        f"ELSIF missed < {LOST_AFTER} THEN",
        "    missed := missed + 1;",
        "ELSE",
        *(f"    {name}_{axis.do_id} := FALSE;" for axis in frame.axes for name in ("good", "used")),
        "END_IF;",
    ]
    sections = [
        ("VAR_INPUT", [f"frame : ARRAY[0..{frame.size - 1}] OF BYTE;"]),
        ("VAR_OUTPUT", outputs),
        ("VAR", ["high : BYTE;", "low : BYTE;", "seen : BOOL;", "missed : INT;"]),
    ]
    yield from block("PDGW_Read", sections, body)


def _value(place: Place) -> str:
    bits = _BITS[place.length]
    parts = []
    for position in range(place.length):
        shift = 8 * (place.length - 1 - position)
        byte = f"frame[{place.in_frame + position}]"
        part = byte if bits == "BYTE" else f"BYTE_TO_{bits}({byte})"
        parts.append(f"SHL(IN := {part}, N := {shift})" if shift else part)
    whole = " OR ".join(parts)
    return whole if place.type == bits else f"{bits}_TO_{place.type}({whole})"


def profinet_variables(maps: tuple[FrameMap, FrameMap]) -> Iterator[str]:
    """List the data on PROFINET in a comment: each system declares such variables differently."""
    yield "(* PROFINET: slot n, subslot 2 holds the telegram of axis n. Declare these at the addresses of the submodules:"
    sending, receiving = maps
    for axis in receiving.axes:
        yield f"    axis_{axis.do_id}_actual AT %I* : {type_of(axis.half)};  {axis.half.size} bytes"
    for axis in sending.axes:
        yield f"    axis_{axis.do_id}_set AT %Q* : {type_of(axis.half)};  {axis.half.size} bytes"
    yield "*)"


def profinet_block(maps: tuple[FrameMap, FrameMap]) -> Iterator[str]:
    """The block for TIA Portal on PROFINET, where the driver handles IOPS, IOCS, counter and byte order."""
    sending, receiving = maps
    inputs = [f"hw_{axis.do_id} : HW_IO; {comment('hardware identifier of the submodule')}" for axis in sending.axes]
    inputs += [f"axis_{axis.do_id}_set : {type_of(axis.half)};" for axis in sending.axes]
    outputs = [f"axis_{axis.do_id}_actual : {type_of(axis.half)};" for axis in receiving.axes]
    outputs += [
        f"good_{axis.do_id} : BOOL; {comment('the values are valid: DPRD_DAT had no error')}" for axis in receiving.axes
    ]
    body = []
    for axis in sending.axes:
        number = axis.do_id
        body.append(f"result := DPRD_DAT(LADDR := hw_{number}, RECORD => axis_{number}_actual);")
        body.append(f"good_{number} := result = 0;")
        body.append(f"result := DPWR_DAT(LADDR := hw_{number}, RECORD := axis_{number}_set);")
    sections = [("VAR_INPUT", inputs), ("VAR_OUTPUT", outputs), ("VAR_TEMP", ["result : INT;"])]
    yield from block("PDGW_Profinet", sections, body)
