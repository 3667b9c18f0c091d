"""Golden files: small hand-made captures with their reviewed text and JSON.

``python -m tests.decoder.test_golden`` writes the expectations again. Read the difference before you commit it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.view.render import record_line, record_tree

GOLDEN = Path(__file__).parent / "golden"
BEGIN_NS = 1_700_000_000_000_000_000

CASES = {
    "canopen": ("canopen.log", Settings()),
    "canopen-block": ("block.log", Settings()),
    "canopen-telegram-9": ("telegram9.log", Settings(given_axes([9]), "--telegram")),
    "plc": ("plc.hex", Settings(given_axes([1]), "--telegram")),
    "plc-inferred": ("plc.hex", Settings()),
}


def packets(name: str) -> Iterator[Packet | CanPacket]:
    """The packets of a golden capture: a candump log, or lines of milliseconds, link type and bytes."""
    if not name.endswith(".hex"):
        with open_source(str(GOLDEN / name)) as source:
            yield from source.packets
        return
    lines = [line for line in (GOLDEN / name).read_text().splitlines() if not line.startswith("#")]
    for number, line in enumerate(lines, 1):
        milliseconds, link, data = line.split()
        yield Packet(number, BEGIN_NS + int(milliseconds) * 1_000_000, int(link), "", bytes.fromhex(data))


def decoded(case: str) -> tuple[list[str], list[str]]:
    """Text (the tree for the first of every kind) and JSON of a case."""
    name, settings = CASES[case]
    decoder = Decoder(settings)
    text: list[str] = []
    documents: list[str] = []
    kinds: set[str] = set()
    for packet in packets(name):
        record = decoder.decode(packet)
        text += [f"note: {notice}" for notice in decoder.notices]
        decoder.notices.clear()
        text.append(record_line(record, BEGIN_NS))
        if record.kind not in kinds:
            kinds.add(record.kind)
            text += record_tree(record)
            documents.append(json.dumps(record.document()))
    return text, documents


@pytest.mark.parametrize("case", CASES)
def test_the_capture_becomes_the_reviewed_text_and_json(case: str) -> None:
    text, documents = decoded(case)
    assert text == (GOLDEN / f"{case}.txt").read_text().splitlines()
    assert documents == (GOLDEN / f"{case}.jsonl").read_text().splitlines()


if __name__ == "__main__":
    for case in CASES:
        for ending, lines in zip(("txt", "jsonl"), decoded(case), strict=True):
            (GOLDEN / f"{case}.{ending}").write_text("\n".join(lines) + "\n")
