"""What the PROFIdrive profile says, written from published tables: general state machine, sensor machine, parameter manager.

Sources: profile 4.1 as drive manuals print it (general state diagram, STW1, ZSW1), encoder profile 4.1 (states of a sensor), base
mode parameter access with its error numbers. Imports nothing of the gateway.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

# -- the general state machine ----------------------------------------------------------------------------------------------

S1, S2, S3, S4, FAULT = "switching on inhibited", "ready for switching on", "switched on", "operation", "fault"
ON, NO_OFF2, NO_OFF3, ENABLE, ACKNOWLEDGE = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 7
SHOWN = {S1: 0x40, S2: 0x01, S3: 0x03, S4: 0x07, FAULT: 0x08}
"""ZSW1 bits 0 to 3 and 6."""
STATE_BITS = 0x7F
"""And bits 4 and 5: no OFF2, no OFF3."""


class StateMachine:
    """Each control word stays until the axis has executed it: S5, the way to standstill, is over then."""

    def __init__(self) -> None:
        self.state = S1
        self._cause = False
        self._word = 0

    def fault(self) -> None:
        """The drive finds a fault,"""
        self.state, self._cause = FAULT, True

    def repaired(self) -> None:
        """and its cause goes."""
        self._cause = False

    def run_out(self, word: int) -> int:
        """The bits of ZSW1 with this STW1."""
        edge = word & ~self._word & ACKNOWLEDGE
        self._word = word
        if self.state == FAULT and edge and not self._cause:
            self.state = S1
        while (follower := self._follower(word)) != self.state:
            self.state = follower
        return SHOWN[self.state] | (word & (NO_OFF2 | NO_OFF3)) << 3

    def _follower(self, word: int) -> str:
        stopped = word & (NO_OFF2 | NO_OFF3) != NO_OFF2 | NO_OFF3
        if self.state == S1:
            return S1 if stopped or word & ON else S2
        if self.state == FAULT or stopped:
            return FAULT if self.state == FAULT else S1
        if not word & ON:
            return S2
        if self.state == S2:
            return S3
        return S4 if word & ENABLE else S3


# -- the sensor machine -----------------------------------------------------------------------------------------------------

SENSOR_SHOWN = {
    "NORMAL": 0x0000,
    "PRESETTING": 0x0000,
    "PRESET_DONE": 0x1000,
    "PARKED": 0x4000,
    "ERROR": 0x8000,
    "ACKNOWLEDGING": 0x8800,
}
"""G1_ZSW of each state."""


def sensor_state(state: str, before: int, word: int, error: bool, answer: str) -> str:
    """The state after G1_STW ``word``; ``before``: the word of the previous cycle, ``answer``: the result of a preset."""
    edges = word & ~before
    if state == "PRESETTING":
        state = {"done": "PRESET_DONE", "failed": "ERROR"}.get(answer, state)
    if word & 0x4000:
        return "PARKED"
    if state == "PARKED":
        state = "NORMAL"
    if state == "ERROR":
        return "ACKNOWLEDGING" if edges & 0x8000 else "ERROR"
    if state == "ACKNOWLEDGING":
        if word & 0x8000:
            return state
        state = "NORMAL"
    if error:
        return "ERROR"
    if state == "NORMAL" and edges & 0x1000:
        return "PRESETTING"
    return "NORMAL" if state == "PRESET_DONE" and not word & 0x1000 else state


# -- the parameter manager --------------------------------------------------------------------------------------------------

_SIZES = {0x02: 1, 0x03: 2, 0x04: 4, 0x05: 1, 0x06: 2, 0x07: 4, 0x08: 4, 0x41: 1, 0x42: 2, 0x43: 4}
_GENERIC = {1: 0x41, 2: 0x42, 4: 0x43}


@dataclass
class OraclePnu:
    """A parameter with raw values of one type; ``limits`` where it may be written."""

    code: int
    values: list[int]
    array: bool = False
    limits: tuple[int, int] | None = None


@dataclass
class ParameterManager:
    """Answers whole requests of values, byte by byte."""

    parameters: dict[int, OraclePnu] = field(default_factory=dict)

    def answer(self, data: bytes) -> bytes:
        """To a request that is well formed but for what is in its fields."""
        reference, service, do_id, count = data[:4]
        if service not in (1, 2):
            return bytes((reference, 0x80, do_id, 1, 0x44, 1, 0, 0x21))
        addresses = [struct.unpack_from(">BBHH", data, 4 + 6 * place) for place in range(count)]
        parts, offset = [], 4 + 6 * count
        for attribute, elements, pnu, subindex in addresses:
            if service == 1:
                parts.append(self._read(attribute, elements, pnu, subindex))
                continue
            code, number = data[offset : offset + 2]
            size = _SIZES[code] * number
            values = data[offset + 2 : offset + 2 + size]
            offset += 2 + size + size % 2
            parts.append(self._write(elements, pnu, subindex, code, number, values))
        failed = any(part[0] == 0x44 for part in parts)
        head = bytes((reference, service | (0x80 if failed else 0), do_id, count))
        return head if service == 2 and not failed else head + b"".join(parts)

    def _refusal(self, elements: int, pnu: int, subindex: int) -> bytes | None:
        if not pnu or elements > 234 or subindex == 0xFFFF or (subindex and not elements):
            return _error(0x16)
        return None if pnu in self.parameters else _error(0x00)

    def _read(self, attribute: int, elements: int, pnu: int, subindex: int) -> bytes:
        if attribute not in (0x10, 0x20, 0x30):
            return _error(0x16)
        if refused := self._refusal(elements, pnu, subindex):
            return refused
        found = self.parameters[pnu]
        if not found.array:
            if subindex or elements > 1:
                return _error(0x04)
            return _values(found.code, found.values)
        if not elements:
            return _error(0x16)
        if subindex + elements > len(found.values):
            missing = max(subindex, len(found.values))
            return _error(0x03, missing) if elements > 1 else _error(0x03)
        return _values(found.code, found.values[subindex : subindex + elements])

    def _write(self, elements: int, pnu: int, subindex: int, code: int, number: int, data: bytes) -> bytes:
        if refused := self._refusal(elements, pnu, subindex):
            return refused
        found = self.parameters[pnu]
        if number != max(1, elements):
            return _error(0x18)
        if found.limits is None:
            return _error(0x01)
        if subindex or elements > 1:
            return _error(0x04)
        if code not in (found.code, _GENERIC[_SIZES[found.code]]):
            return _error(0x05)
        value = int.from_bytes(data, "big", signed=found.code < 0x05)
        if not found.limits[0] <= value <= found.limits[1]:
            return _error(0x02)
        found.values[0] = value
        return b"\x40\x00"


def _error(number: int, subindex: int | None = None) -> bytes:
    return struct.pack(">BBH", 0x44, 1, number) if subindex is None else struct.pack(">BBHH", 0x44, 2, number, subindex)


def _values(code: int, values: list[int]) -> bytes:
    data = b"".join(value.to_bytes(_SIZES[code], "big", signed=code < 0x05) for value in values)
    return bytes((code, len(values))) + data + b"\0" * (len(data) % 2)
