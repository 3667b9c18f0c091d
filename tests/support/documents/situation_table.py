"""The table of situations in docs/operation.md: what the gateway reports in each of them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from tests.support.documents.device_situations import DEVICE_SITUATIONS
from tests.support.documents.parts import read_part, write_part
from tests.support.documents.plc_situations import CONTROLLER_SITUATIONS, PLC_SITUATIONS
from tests.support.documents.situations import SITUATIONS, at_situation

_PLACE = ("operation.md", "situations")
ON_BOTH_LINKS = SITUATIONS | DEVICE_SITUATIONS
BY_LINK = {"udp": ON_BOTH_LINKS | PLC_SITUATIONS, "profinet": ON_BOTH_LINKS | CONTROLLER_SITUATIONS}
"""All situations of each link, by what a technician finds."""


def situation_table() -> str:
    """The first line and the remedy that each situation gives, as a table."""
    return "\n".join(["| situation | first line | remedy |", "| --- | --- | --- |", *_rows()]) + "\n"


def _rows() -> Iterator[str]:
    for link, situations in (("udp", BY_LINK["udp"]), ("profinet", CONTROLLER_SITUATIONS)):
        for title, situation in situations.items():
            with at_situation(situation, link) as (daemon, _):
                yield _row(title, daemon)


def _row(title: str, daemon: Daemon) -> str:
    document = snapshot(daemon)
    item = (*document["causes"], *document["axes"], *document["encoders"])[0]
    line = re.sub(r"\d\d:\d\d:\d\d", "14:02:11", f"{item['state']}: {item['reason']}")
    return f"| {title} | {line} | {item['remedy']} |"


def written_table() -> str:
    """The table in the document."""
    return read_part(*_PLACE)


def write() -> None:
    """Put the table into the document."""
    write_part(*_PLACE, situation_table())
