"""A small ring whose records contain their own number, for tests and for their writer."""

from __future__ import annotations

from pdgw.gateway.trace.layout import FramePlaces, RingLayout, TracedObject

LAYOUT = RingLayout(
    name="test",
    cycle_ns=1_000_000,
    places=FramePlaces("udp", 12, 10, (2,), (2,)),
    objects=(TracedObject(1, "axis", 1, "can", 1, True, False),),
    buses=("can",),
    cycles=16,
    frames=8,
    reasons=("NO_PLC",),
)
LIMIT = 1 << 20


def record(number: int) -> list[object]:
    """A cycle with its number in every field."""
    received, sent = number.to_bytes(12, "big"), bytearray(number.to_bytes(10, "big"))
    return [
        number,
        7,
        12,
        10,
        number & 0xFFFF,
        received,
        sent,
        number,
        -number,
        number & 0xFFFF,
        number & 0xFFFF,
        1,
        3,
        9,
    ]
