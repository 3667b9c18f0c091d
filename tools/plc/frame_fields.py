"""Structured Text (second edition) for the data types of the telegrams and the access to the submodules on PROFINET.

On PROFINET the PLC's driver handles IOPS, IOCS, counter and byte order.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from pdgw.gateway.configuration.byte_map import FrameMap
from pdgw.profidrive.telegrams import Direction, TelegramHalf

_KINDS = {Direction.SETPOINT: "SET", Direction.ACTUAL: "ACT"}
_RESERVED = {"PROGRAM", "TIME", "DATE", "WORD", "BYTE", "LIMIT", "MODE", "OVERRIDE"}


def identifier(name: str) -> str:
    """Convert a name to an identifier of these languages."""
    text = re.sub(r"[\W_]+", "_", name, flags=re.ASCII).strip("_")
    return f"{text}_VALUE" if text.upper() in _RESERVED else text


def code_names(frame: FrameMap) -> list[str]:
    """The name of each axis in the code: its configured name if that is unique as an identifier, else its DO-ID."""
    named = [identifier(axis.name or "") for axis in frame.axes]
    keys = [name.upper() for name in named]
    return [
        name if re.match(r"(?!axis_?\d)[a-z]", key, re.IGNORECASE) and keys.count(key) == 1 else f"axis_{axis.do_id}"
        for axis, name, key in zip(frame.axes, named, keys, strict=True)
    ]


def type_of(half: TelegramHalf) -> str:
    """Name of a telegram's structure."""
    return f"PDGW_T{half.telegram}_{_KINDS[half.direction]}"


def comment(text: str) -> str:
    """Format a comment that every edition of the standard accepts."""
    return f"(* {text} *)"


def type_code(maps: tuple[FrameMap, FrameMap]) -> Iterator[str]:
    """Generate the structures of the telegrams."""
    for name, axis in {type_of(axis.half): axis for frame in maps for axis in frame.axes}.items():
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


def profinet_variables(maps: tuple[FrameMap, FrameMap]) -> Iterator[str]:
    """List the data on PROFINET in a comment: each system declares such variables differently."""
    yield "(* PROFINET: slot n, subslot 2 holds the telegram of axis n. Declare these at the addresses of the submodules:"
    for frame, suffix, area in zip(maps, ("set", "actual"), "QI", strict=True):
        for name, axis in zip(code_names(frame), frame.axes, strict=True):
            yield f"    {name}_{suffix} AT %{area}* : {type_of(axis.half)};  {axis.half.size} bytes"
    yield "*)"


def profinet_block(maps: tuple[FrameMap, FrameMap]) -> Iterator[str]:
    """The block for TIA Portal on PROFINET."""
    sending, receiving = maps
    names = code_names(sending)
    inputs = [f"{name}_hw : HW_IO; {comment('hardware identifier of the submodule')}" for name in names]
    inputs += [f"{name}_set : {type_of(axis.half)};" for name, axis in zip(names, sending.axes, strict=True)]
    outputs = [f"{name}_actual : {type_of(axis.half)};" for name, axis in zip(names, receiving.axes, strict=True)]
    outputs += [f"{name}_good : BOOL; {comment('the values are valid: DPRD_DAT had no error')}" for name in names]
    body = []
    for name in names:
        body.append(f"result := DPRD_DAT(LADDR := {name}_hw, RECORD => {name}_actual);")
        body.append(f"{name}_good := result = 0;")
        body.append(f"result := DPWR_DAT(LADDR := {name}_hw, RECORD := {name}_set);")
    sections = [("VAR_INPUT", inputs), ("VAR_OUTPUT", outputs), ("VAR_TEMP", ["result : INT;"])]
    yield from block("PDGW_Profinet", sections, body)
