"""Cost of one axis cycle of the translation: bytecodes by function, and memory."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any

from tests.long.bench.translation import FRAMES, axis_cycle

TELEGRAMS = (1, 9, 100, 111)
_WARM = 64
_HISTORY = 3 * FRAMES
"""After this number of 1 ms cycles the gateway's history of frames is full."""
_CYCLES = 64
"""A multiple of the 16 different actual values."""


def bytecodes(number: int) -> dict[str, float]:
    """Bytecodes of one axis cycle with a telegram, by function (``module:name``); the mean of some cycles."""
    cycle = _warm(number)
    counts: Counter[str] = Counter()
    before = sys.gettrace()
    sys.settrace(counting(counts))
    try:
        for _ in range(_CYCLES):
            cycle()
    finally:
        sys.settrace(before)
    own = f"{__name__}:"
    return {name: count / _CYCLES for name, count in counts.items() if not name.startswith(own)}


def counting(counts: Counter[str]) -> Callable[[FrameType, str, Any], Any]:
    """A function for ``sys.settrace`` that counts bytecodes by function (``module:name``)."""

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        if event == "call":
            frame.f_trace_opcodes = True
            frame.f_trace_lines = False
        elif event == "opcode":
            counts[f"{frame.f_globals.get('__name__')}:{frame.f_code.co_name}"] += 1
        return trace

    return trace


def kept_blocks(number: int) -> float:
    """Memory blocks that each axis cycle leaves allocated when the history of frames is full."""
    gc.collect()
    gc.disable()  # a collection empties the interpreter's free lists, which would then fill again
    try:
        cycle = _warm(number, _HISTORY)
        before = sys.getallocatedblocks()
        for _ in range(_CYCLES):
            cycle()
        return (sys.getallocatedblocks() - before) / _CYCLES
    finally:
        gc.enable()


def peak_bytes(number: int) -> int:
    """Peak of the memory that an axis cycle allocates, in bytes."""
    cycle = _warm(number)
    peaks = []
    tracemalloc.start()
    try:
        for _ in range(_CYCLES):
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            cycle()
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()
    return sorted(peaks)[len(peaks) // 2]


def _warm(number: int, cycles: int = _WARM) -> Callable[[], object]:
    cycle = axis_cycle(number)
    for _ in range(cycles):
        cycle()
    return cycle
