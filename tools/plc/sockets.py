"""PDGW_Udp: the block that reads and writes the UDP frames, alone or with the sockets of CODESYS or of an S7.

Frames are big-endian and written byte by byte, whatever the byte order of the PLC.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

from pdgw.gateway.configuration.byte_map import FrameMap, Place, counter_step, frame_maps
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.profidrive.frame import (
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    IOPS_GOOD,
    STATUS_NORMAL,
    TICK,
)
from pdgw.tools.plc.frame_fields import code_names, identifier, type_of
from pdgw.tools.plc.library import plain

_BITS = {1: "BYTE", 2: "WORD", 4: "DWORD", 8: "LWORD"}
LOST_AFTER = 50
"""Calls of PDGW_Udp without a new frame after which the actual values count as invalid."""


class Sockets(StrEnum):
    """What exchanges the frames; the value is the name of the template."""

    NONE = "udp"
    """The program: the frames are an input and an output."""
    CODESYS = "udp_codesys"
    S7 = "udp_s7"


def udp_block(config: GatewayConfig, sockets: Sockets) -> str:
    """Generate PDGW_Udp."""
    sending, receiving = frame_maps(config)
    actuals = [
        line
        for name, axis in zip(code_names(receiving), receiving.axes, strict=True)
        for line in (
            f"{name}_actual : {type_of(axis.half)};",
            f"{name}_good : BOOL; (* the actual values are valid *)",
            f"{name}_used : BOOL; (* the gateway uses the setpoints *)",
        )
    ]
    setpoints = [
        f"{name}_set : {type_of(axis.half)};" for name, axis in zip(code_names(sending), sending.axes, strict=True)
    ]
    values = {
        "setpoints": setpoints,
        "actuals": actuals,
        "variables": ["counter : UINT;", "high : BYTE;", "low : BYTE;", "seen : BOOL;", "missed : INT;"],
        "read": _read(receiving),
        "build": _build(sending, receiving, counter_step(config)),
    }
    sizes = {"received bytes": receiving.size, "sent bytes": sending.size}
    numbers = {**sizes, "received last": receiving.size - 1, "sent last": sending.size - 1}
    numbers["port"] = config.transport.cyclic_port
    texts = {name: "\n".join(f"    {line}" for line in lines) for name, lines in values.items()}
    return plain(sockets, {**texts, **{name: str(number) for name, number in numbers.items()}})


def _build(frame: FrameMap, receiving: FrameMap, step: int) -> Iterator[str]:
    """Lines that write the PLC's frame. ``step``: increment of the cycle counter."""
    yield _byte(0, f"16#{FRAME_ID_TO_DEVICE >> 8:02X}")
    yield _byte(1, f"16#{FRAME_ID_TO_DEVICE & 0xFF:02X}")
    for name, axis in zip(code_names(frame), frame.axes, strict=True):
        for place in axis.places:
            if place.signal is not None:
                yield from _bytes_of(place, f"{name}_set.{identifier(place.name)}")
        yield _byte(axis.iops, f"16#{IOPS_GOOD:02X}")
        yield _byte(axis.iocs, f"SEL(G := {name}_good, IN0 := BYTE#16#00, IN1 := BYTE#16#{IOPS_GOOD:02X})")
    for position in range(-TICK.size, 0):
        yield _byte(frame.trailer + position, f"received[{receiving.trailer + position}]")
    yield f"counter := counter + {step};"
    yield _byte(frame.trailer, "WORD_TO_BYTE(SHR(IN := UINT_TO_WORD(counter), N := 8))")
    yield _byte(frame.trailer + 1, "WORD_TO_BYTE(UINT_TO_WORD(counter))")
    yield _byte(frame.trailer + 2, f"16#{STATUS_NORMAL:02X}")
    yield _byte(frame.trailer + 3, "16#00")


def _byte(offset: int, value: str) -> str:
    return f"sent[{offset}] := {value};"


def _bytes_of(place: Place, value: str) -> Iterator[str]:
    """Assign one value to its bytes, high byte first."""
    bits = _BITS[place.length]
    whole = value if place.type == bits else f"{place.type}_TO_{bits}({value})"
    for position in range(place.length):
        shift = 8 * (place.length - 1 - position)
        part = f"SHR(IN := {whole}, N := {shift})" if shift else whole
        yield _byte(place.in_frame + position, part if bits == "BYTE" else f"{bits}_TO_BYTE({part})")


def _read(frame: FrameMap) -> Iterator[str]:
    """Lines that read the gateway's frame. The values become invalid after too long without a new valid frame."""
    names = code_names(frame)
    valid = [
        f"received[0] = 16#{FRAME_ID_TO_CONTROLLER >> 8:02X}",
        f"received[1] = 16#{FRAME_ID_TO_CONTROLLER & 0xFF:02X}",
        f"(received[{frame.trailer + 2}] AND 16#05) = 16#05",
        f"(NOT seen OR received[{frame.trailer}] <> high OR received[{frame.trailer + 1}] <> low)",
    ]
    yield f"IF {' AND '.join(valid)} THEN"
    for name, axis in zip(names, frame.axes, strict=True):
        for place in axis.places:
            if place.signal is not None:
                yield f"    {name}_actual.{identifier(place.name)} := {_value(place)};"
        yield f"    {name}_good := (received[{axis.iops}] AND 16#80) = 16#80;"
        yield f"    {name}_used := (received[{axis.iocs}] AND 16#80) = 16#80;"
    yield f"    high := received[{frame.trailer}];"
    yield f"    low := received[{frame.trailer + 1}];"
    yield from ("    seen := TRUE;", "    missed := 0;")
    yield from (f"ELSIF missed < {LOST_AFTER} THEN", "    missed := missed + 1;", "ELSE")
    yield from (f"    {name}_{what} := FALSE;" for name in names for what in ("good", "used"))
    yield "END_IF;"


def _value(place: Place) -> str:
    bits = _BITS[place.length]
    parts = []
    for position in range(place.length):
        shift = 8 * (place.length - 1 - position)
        byte = f"received[{place.in_frame + position}]"
        part = byte if bits == "BYTE" else f"BYTE_TO_{bits}({byte})"
        parts.append(f"SHL(IN := {part}, N := {shift})" if shift else part)
    whole = " OR ".join(parts)
    return whole if place.type == bits else f"{bits}_TO_{place.type}({whole})"
