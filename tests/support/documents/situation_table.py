"""The table of situations in docs/operation.md: what the gateway reports in each of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from tests.support.documents.device_situations import DEVICE_SITUATIONS, at_device_situation
from tests.support.documents.parts import read_part, write_part
from tests.support.documents.plc_situations import (
    CONTROLLER_SITUATIONS,
    PLC_SITUATIONS,
    at_controller_situation,
    at_plc_situation,
)
from tests.support.documents.situations import SITUATIONS, settle
from tests.support.gateways.daemon import Plc, axis, configuration, running

_PLACE = ("operation.md", "situations")


def situation_table() -> str:
    """The first line and the remedy that each situation gives, as a table."""
    return "\n".join(["| situation | first line | remedy |", "| --- | --- | --- |", *_rows()]) + "\n"


def _rows() -> Iterator[str]:
    for title, begin in SITUATIONS.items():
        with running(configuration(axis(1))) as daemon:
            plc = Plc(daemon, [1])
            plc.enable()
            begin(plc, daemon)
            settle(plc)
            yield _row(title, daemon)
    for title, situation in PLC_SITUATIONS.items():
        with at_plc_situation(situation) as (daemon, _):
            yield _row(title, daemon)
    for title, device in DEVICE_SITUATIONS.items():
        with at_device_situation(device) as (daemon, _):
            yield _row(title, daemon)
    with TemporaryDirectory() as folder:
        for title, found in CONTROLLER_SITUATIONS.items():
            with at_controller_situation(found, Path(folder) / "store.json") as site:
                yield _row(title, site.daemon)


def _row(title: str, daemon: Daemon) -> str:
    document = snapshot(daemon)
    item = (*document["axes"], *document["encoders"])[0]
    line = re.sub(r"\d\d:\d\d:\d\d", "14:02:11", f"{item['state']}: {item['reason']}")
    return f"| {title} | {line} | {item['remedy']} |"


def written_table() -> str:
    """The table in the document."""
    return read_part(*_PLACE)


def write() -> None:
    """Put the table into the document."""
    write_part(*_PLACE, situation_table())
