"""Whole Ethernet frames through tshark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import wrpcap

from tests.support.readers import tshark


def datagram(
    payload: bytes,
    source: tuple[str, int],
    destination: tuple[str, int],
    source_mac: bytes = bytes.fromhex("020000000001"),
    destination_mac: bytes = bytes.fromhex("020000000002"),
) -> bytes:
    """A UDP datagram as a frame."""
    return bytes(
        Ether(src=source_mac.hex(":"), dst=destination_mac.hex(":"))
        / IP(src=source[0], dst=destination[0])
        / UDP(sport=source[1], dport=destination[1])
        / payload
    )


def read(frames: Sequence[bytes], path: Path, names: Sequence[str], *, every: bool = False) -> list[dict[str, str]]:
    """The fields of each frame; AssertionError when tshark finds one malformed."""
    wrpcap(str(path), [Ether(frame) for frame in frames])
    options = ["-E", "occurrence=a"] if every else []
    rows = tshark.fields(path, [*names, "_ws.malformed"], options)
    assert len(rows) == len(frames)
    bad = [index for index, row in enumerate(rows) if row["_ws.malformed"]]
    assert not bad, f"tshark calls frames {bad} malformed: {[frames[index].hex() for index in bad]}"
    return rows
