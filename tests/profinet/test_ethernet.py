"""Ethernet frames: header with and without a priority tag, padding, what is too short."""

from __future__ import annotations

import pytest

from pdgw.profinet import ethernet

TO, FROM = bytes.fromhex("010ecf000000"), bytes.fromhex("020000000001")


def test_a_frame_is_header_payload_and_zeros_up_to_60_bytes() -> None:
    assert ethernet.frame(TO, FROM, b"data") == TO + FROM + bytes.fromhex("8892") + b"data" + bytes(42)
    tagged = ethernet.frame(TO, FROM, b"data", tag=0xC000, ethertype=0x88CC)
    assert tagged == TO + FROM + bytes.fromhex("8100 c000 88cc") + b"data" + bytes(38)
    assert len(ethernet.frame(TO, FROM, bytes(46))) == 60
    assert ethernet.frame(TO, FROM, b"x" * 47) == TO + FROM + bytes.fromhex("8892") + b"x" * 47


@pytest.mark.parametrize(
    ("behind", "found"),
    [
        ("8892", (0x8892, 14)),
        ("0800", (0x0800, 14)),
        ("88", (0, 0)),
        ("8100 c000 8892", (0x8892, 18)),
        ("8100 c000 88", (0, 0)),
        ("8100", (0, 0)),
        ("", (0, 0)),
    ],
    ids=["untagged", "another type", "13 bytes", "tagged", "17 bytes", "tag cut short", "addresses alone"],
)
def test_payload_follows_the_type_with_and_without_a_tag(behind: str, found: tuple[int, int]) -> None:
    assert ethernet.payload_of(TO + FROM + bytes.fromhex(behind)) == found
