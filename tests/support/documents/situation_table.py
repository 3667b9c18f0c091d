"""The table of situations in docs/situations.md: what the gateway reports in each of them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from tests.support.documents.device_situations import DEVICE_SITUATIONS
from tests.support.documents.encoder_situations import ENCODER_SITUATIONS
from tests.support.documents.night_situations import NIGHT_SITUATIONS
from tests.support.documents.origin_situations import ORIGIN_SITUATIONS
from tests.support.documents.parts import read_part, write_part
from tests.support.documents.plc_situations import CONTROLLER_SITUATIONS, PLC_SITUATIONS
from tests.support.documents.situations import SITUATIONS, at_situation

_PLACE = ("situations.md", "situations")
ON_BOTH_LINKS = SITUATIONS | DEVICE_SITUATIONS | ENCODER_SITUATIONS | ORIGIN_SITUATIONS | NIGHT_SITUATIONS
BY_LINK = {"udp": ON_BOTH_LINKS | PLC_SITUATIONS, "profinet": ON_BOTH_LINKS | CONTROLLER_SITUATIONS}
"""All situations of each link, by what a technician finds."""
_LIKE_OTHERS = {
    "the drive has no power, and the PLC idles",
    "the drive reports a fault, then the PLC stops",
    "the drive sends its EMCY with another COB-ID (1014h)",
    "the drive sends an EMCY of three bytes",
    "the drive sends heartbeats of two bytes, and has a fault",
    "telegram 111: STW1.6 rises while STW1.5 = 0",
    "the same, with a short watchdog time",
}
"""Situations with the line and the remedy of another one."""
WRITTEN = {
    "udp": {title: item for title, item in BY_LINK["udp"].items() if title not in _LIKE_OTHERS},
    "profinet": CONTROLLER_SITUATIONS,
}
"""The situations in the table: those of both links once."""
_HEAD = ("| situation | first line | remedy |", "| --- | --- | --- |")


def _rows() -> Iterator[str]:
    for link, situations in WRITTEN.items():
        for title, situation in situations.items():
            with at_situation(situation, link) as (daemon, _):
                yield situation_row(title, daemon)


def situation_row(title: str, daemon: Daemon) -> str:
    """The first line and the remedy of a gateway in this situation, as a row of the table."""
    document = snapshot(daemon)
    item = (*document["causes"], *document["axes"], *document["encoders"])[0]
    line = re.sub(r"\d\d:\d\d:\d\d", "14:02:11", f"{item['state']}: {item['reason']}")
    return f"| {title} | {line} | {item['remedy']} |"


def written_rows() -> dict[str, str]:
    """The rows in the document by situation."""
    head, rule, *rows = read_part(*_PLACE).splitlines()
    assert (head, rule) == _HEAD
    return {row.split(" | ")[0].removeprefix("| "): row for row in rows}


def write() -> None:
    """Put the table into the document."""
    write_part(*_PLACE, "\n".join([*_HEAD, *_rows()]) + "\n")
