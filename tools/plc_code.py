"""Data types and sample blocks for a PLC, out of the byte map: Structured Text (IEC 61131-3) or SCL (Siemens TIA Portal).

For UDP the blocks make and read whole frames, byte by byte and big-endian, whatever the byte order of the PLC is. On PROFINET the
PLC's own driver does that: there the types and the reading and writing of the submodules are enough.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from pdgw.gateway.bytemap import AxisMap, FrameMap, Place
from pdgw.profidrive.frame import FRAME_ID_TO_CONTROLLER, FRAME_ID_TO_DEVICE, IOPS_GOOD, STATUS_NORMAL
from pdgw.profidrive.telegrams import Direction, TelegramHalf

_KINDS = {Direction.SETPOINT: "SET", Direction.ACTUAL: "ACT"}
_BITS = {1: "BYTE", 2: "WORD", 4: "DWORD"}
_RESERVED = {"PROGRAM", "TIME", "DATE", "WORD", "BYTE", "LIMIT", "MODE"}


@dataclass(frozen=True, slots=True)
class Dialect:
    """How the two languages differ."""

    siemens: bool

    def local(self, name: str) -> str:
        """A variable of the block itself."""
        return f"#{name}" if self.siemens else name

    def type_name(self, name: str) -> str:
        return f'"{name}"' if self.siemens else name

    def shift(self, function: str, value: str, bits: int) -> str:
        return f"{function}(IN := {value}, N := {bits})" if self.siemens else f"{function}({value}, {bits})"

    def block(self, name: str, sections: list[str], body: list[str]) -> Iterator[str]:
        yield f"FUNCTION_BLOCK {self.type_name(name)}"
        if self.siemens:
            yield "VERSION : 0.1"
        yield from sections
        if self.siemens:
            yield "BEGIN"
        yield from (f"    {line}" for line in body)
        yield "END_FUNCTION_BLOCK"
        yield ""


def identifier(name: str) -> str:
    """A name as these languages take it."""
    text = re.sub(r"_+", "_", re.sub(r"\W", "_", name)).strip("_")
    return f"{text}_" if text.upper() in _RESERVED else text


def type_of(half: TelegramHalf) -> str:
    """The name of a telegram's structure."""
    return f"PDGW_T{half.telegram}_{_KINDS[half.direction]}"


def code(maps: tuple[FrameMap, FrameMap], step: int, dialect: Dialect) -> Iterator[str]:
    """The whole file; ``step`` is what the cycle counter grows by."""
    yield "// Made by pdgw map. Order and lengths are those of the configuration: make it again when that changes."
    halves = {type_of(axis.half): axis for frame in maps for axis in frame.axes}
    for name, axis in halves.items():
        yield from _structure(name, axis, dialect)
    sending, receiving = maps
    yield f"// -- UDP: {sending.size} bytes to the gateway, {receiving.size} bytes back, one frame each cycle"
    yield from _build(sending, step, dialect)
    yield from _read(receiving, dialect)
    yield from _profinet(maps, dialect)


def _structure(name: str, axis: AxisMap, dialect: Dialect) -> Iterator[str]:
    yield f"TYPE {dialect.type_name(name)}" + ("" if dialect.siemens else " :")
    if dialect.siemens:
        yield "VERSION : 0.1"
    yield "STRUCT"
    for place in axis.places:
        if place.signal is not None:
            said = "; ".join(part for part in (place.description, place.full or place.unit) if part)
            yield f"    {identifier(place.name)} : {place.type};  // {said}"
    yield "END_STRUCT;"
    yield "END_TYPE"
    yield ""


def _variables(kind: str, lines: list[str]) -> list[str]:
    return [kind, *(f"    {line}" for line in lines), "END_VAR"]


def _build(frame: FrameMap, step: int, dialect: Dialect) -> Iterator[str]:
    """The block that makes the PLC's frame."""
    inputs = [f"axis_{axis.do_id} : {dialect.type_name(type_of(axis.half))};" for axis in frame.axes]
    inputs += [f"good_{axis.do_id} : BOOL;  // from PDGW_Read: actual values arrive" for axis in frame.axes]
    sections = [
        *_variables("VAR_INPUT", inputs),
        *_variables("VAR_OUTPUT", [f"frame : ARRAY[0..{frame.size - 1}] OF BYTE;"]),
        *_variables("VAR", ["counter : UINT;"]),
    ]
    local = dialect.local

    def byte(offset: int, value: str) -> str:
        return f"{local('frame')}[{offset}] := {value};"

    body = [byte(0, f"16#{FRAME_ID_TO_DEVICE >> 8:02X}"), byte(1, f"16#{FRAME_ID_TO_DEVICE & 0xFF:02X}")]
    for axis in frame.axes:
        for place in axis.places:
            if place.signal is not None:
                body += _bytes_of(place, f"{local(f'axis_{axis.do_id}')}.{identifier(place.name)}", byte, dialect)
        body.append(byte(axis.iops, f"16#{IOPS_GOOD:02X}"))
    for axis in frame.axes:
        good = local(f"good_{axis.do_id}")
        body.append(f"IF {good} THEN {byte(axis.iocs, f'16#{IOPS_GOOD:02X}')} ELSE {byte(axis.iocs, '16#00')} END_IF;")
    counter = local("counter")
    body.append(f"{counter} := {counter} + {step};")
    high = dialect.shift("SHR", f"UINT_TO_WORD({counter})", 8)
    body += [
        byte(frame.trailer, f"WORD_TO_BYTE({high})"),
        byte(frame.trailer + 1, f"WORD_TO_BYTE(UINT_TO_WORD({counter}))"),
    ]
    body += [byte(frame.trailer + 2, f"16#{STATUS_NORMAL:02X}"), byte(frame.trailer + 3, "16#00")]
    yield from dialect.block("PDGW_Build", sections, body)


def _bytes_of(place: Place, value: str, byte: object, dialect: Dialect) -> Iterator[str]:
    """The assignments of one value, the high byte first."""
    assert callable(byte)
    bits = _BITS[place.length]
    whole = value if place.type == bits else f"{place.type}_TO_{bits}({value})"
    for position in range(place.length):
        shift = 8 * (place.length - 1 - position)
        part = dialect.shift("SHR", whole, shift) if shift else whole
        yield byte(place.in_frame + position, part if bits == "BYTE" else f"{bits}_TO_BYTE({part})")


def _read(frame: FrameMap, dialect: Dialect) -> Iterator[str]:
    """The block that reads the gateway's frame; it changes nothing when the frame is no valid one."""
    local = dialect.local
    outputs = [f"axis_{axis.do_id} : {dialect.type_name(type_of(axis.half))};" for axis in frame.axes]
    for axis in frame.axes:
        outputs.append(f"good_{axis.do_id} : BOOL;  // IOPS: the values are valid")
        outputs.append(f"used_{axis.do_id} : BOOL;  // IOCS: the gateway uses the setpoints")
    sections = [
        *_variables("VAR_INPUT", [f"frame : ARRAY[0..{frame.size - 1}] OF BYTE;"]),
        *_variables("VAR_OUTPUT", outputs),
    ]

    def byte(offset: int) -> str:
        return f"{local('frame')}[{offset}]"

    head = f"{byte(0)} = 16#{FRAME_ID_TO_CONTROLLER >> 8:02X} AND {byte(1)} = 16#{FRAME_ID_TO_CONTROLLER & 0xFF:02X}"
    body = [f"IF {head} AND ({byte(frame.trailer + 2)} AND 16#05) = 16#05 THEN"]
    for axis in frame.axes:
        body += [
            f"    {local(f'axis_{axis.do_id}')}.{identifier(place.name)} := {_value(place, byte, dialect)};"
            for place in axis.places
            if place.signal is not None
        ]
        body.append(f"    {local(f'good_{axis.do_id}')} := ({byte(axis.iops)} AND 16#80) = 16#80;")
        body.append(f"    {local(f'used_{axis.do_id}')} := ({byte(axis.iocs)} AND 16#80) = 16#80;")
    body.append("END_IF;")
    yield from dialect.block("PDGW_Read", sections, body)


def _value(place: Place, byte: object, dialect: Dialect) -> str:
    assert callable(byte)
    bits = _BITS[place.length]
    parts = []
    for position in range(place.length):
        shift = 8 * (place.length - 1 - position)
        part = (
            byte(place.in_frame + position) if bits == "BYTE" else f"BYTE_TO_{bits}({byte(place.in_frame + position)})"
        )
        parts.append(dialect.shift("SHL", part, shift) if shift else part)
    whole = " OR ".join(parts)
    return whole if place.type == bits else f"{bits}_TO_{place.type}({whole})"


def _profinet(maps: tuple[FrameMap, FrameMap], dialect: Dialect) -> Iterator[str]:
    """The same data on PROFINET, where IOPS, IOCS, counter and byte order are the driver's business."""
    yield "// -- PROFINET: slot n, subslot 2 holds the telegram of axis n; give the variables the addresses of the submodules"
    sending, receiving = maps
    if not dialect.siemens:
        yield "VAR_GLOBAL"
        for axis in receiving.axes:
            yield f"    axis_{axis.do_id}_actual AT %I* : {type_of(axis.half)};  // {axis.half.size} bytes"
        for axis in sending.axes:
            yield f"    axis_{axis.do_id}_set AT %Q* : {type_of(axis.half)};  // {axis.half.size} bytes"
        yield "END_VAR"
        return
    inputs = [f"hw_{axis.do_id} : HW_IO;  // hardware identifier of the submodule" for axis in sending.axes]
    inputs += [f"axis_{axis.do_id}_set : {dialect.type_name(type_of(axis.half))};" for axis in sending.axes]
    outputs = [f"axis_{axis.do_id}_actual : {dialect.type_name(type_of(axis.half))};" for axis in receiving.axes]
    body = []
    for axis in sending.axes:
        number = axis.do_id
        body.append(f"#result := DPRD_DAT(LADDR := #hw_{number}, RECORD => #axis_{number}_actual);")
        body.append(f"#result := DPWR_DAT(LADDR := #hw_{number}, RECORD := #axis_{number}_set);")
    sections = [
        *_variables("VAR_INPUT", inputs),
        *_variables("VAR_OUTPUT", outputs),
        *_variables("VAR_TEMP", ["result : INT;"]),
    ]
    yield from dialect.block("PDGW_Profinet", sections, body)
